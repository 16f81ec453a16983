"""How far a joint may be off at the goal, as another planner asks for it in control_msgs/JointTolerance. Pure.

Joint vectors are in the robot's order: rad, or m for prismatic joints. In what a planner asks, 0 stands for the default and a
negative number for no bound; inside, no bound is infinity.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.robot.description import RobotModel


class GoalError(ConstructionTwinError):
    """A goal of another planner is invalid."""


class GoalJointsError(GoalError):
    """A goal names a joint that the robot does not have, leaves one out, or names one twice."""


@dataclass(frozen=True)
class Tolerances:
    """How far every joint may be off; infinity: no bound."""

    position: tuple[float, ...]

    @classmethod
    def default(cls, robot: RobotModel, revolute: float, prismatic: float) -> Tolerances:
        """Return one tolerance for all revolute joints [rad] and one for all prismatic ones [m]; 0: no bound."""
        return cls(tuple((prismatic if linear else revolute) or math.inf for linear in robot.linear))

    def overridden_by(self, robot: RobotModel, asked: Iterable[Any]) -> Tolerances:
        """Return these tolerances with what a goal asks for in their place: control_msgs/JointTolerance, joints in any order."""
        position = list(self.position)
        named: set[str] = set()
        for tolerance in asked:
            name, value = tolerance.name, tolerance.position
            if name not in robot.joint_names:
                known = ", ".join(robot.joint_names)
                raise GoalJointsError(f"goal_tolerance names the joint {name!r}; expected only {known}")
            if name in named:
                raise GoalError(f"goal_tolerance names {name} twice; expected once")
            named.add(name)
            if math.isnan(value):
                expected = "expected a number, 0 for the default, below 0 for no bound"
                raise GoalError(f"goal_tolerance: the position of {name} is nan; {expected}")
            if not (tolerance.velocity <= 0.0 and tolerance.acceleration <= 0.0):
                expected = "expected a position alone: at the goal both are at rest"
                raise GoalError(f"goal_tolerance bounds velocity or acceleration of {name}; {expected}")
            if value:
                position[robot.joint_names.index(name)] = value if value > 0.0 else math.inf
        return Tolerances(tuple(position))

    def violation(self, robot: RobotModel, errors: Sequence[float]) -> str:
        """Return which joint is off by more than it may, actual minus desired, with the values; "" when none is."""
        for name, linear, error, bound in zip(robot.joint_names, robot.linear, errors, self.position):
            # written so that a nan does not pass
            if not abs(error) <= bound:
                unit = "m" if linear else "rad"
                return Sentence(
                    "the position of {joint} is off by {error}; its tolerance is {bound}",
                    joint=name,
                    error=Quantity(abs(error), unit),
                    bound=Quantity(bound, unit),
                )
        return ""


def check_joint_names(robot: RobotModel, names: Sequence[str]) -> None:
    """Raise GoalJointsError unless a goal names each of the robot's joints once, in any order."""
    if sorted(names) != sorted(robot.joint_names):
        expected = f"expected each of {', '.join(robot.joint_names)} once"
        raise GoalJointsError(f"the goal names the joints {', '.join(names) or 'none'}; {expected}")

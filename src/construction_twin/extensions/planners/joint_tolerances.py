"""How far a joint may be off at the goal, as another planner asks for it in control_msgs/JointTolerance. Pure.

Joint vectors are in the robot's order: rad, or m for prismatic joints, per s and per s^2. In what a planner asks, 0 stands for the
default and a negative number for no bound; inside, no bound is infinity.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.robot.description import RobotModel

#: What a tolerance bounds, with what stands behind the joint's unit.
QUANTITIES = {Sentence("position"): "", Sentence("velocity"): "/s", Sentence("acceleration"): "/s^2"}


class GoalError(ConstructionTwinError):
    """A goal of another planner cannot be taken as it is."""


class GoalJointsError(GoalError):
    """A goal names a joint that the robot does not have, leaves one out, or names one twice."""


@dataclass(frozen=True)
class Tolerances:
    """How far every joint may be off, in the robot's joint order, each of length n; infinity: no bound."""

    position: tuple[float, ...]
    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]

    @classmethod
    def default(cls, robot: RobotModel, revolute: float, prismatic: float) -> Tolerances:
        """Return one position tolerance for all revolute joints [rad] and one for all prismatic ones [m]; 0: no bound."""
        position = tuple((prismatic if linear else revolute) or math.inf for linear in robot.linear)
        free = (math.inf,) * len(robot.linear)
        return cls(position, free, free)

    def overridden_by(self, robot: RobotModel, asked: Iterable[Any]) -> Tolerances:
        """Return these tolerances with what a goal asks for in their place: control_msgs/JointTolerance, joints in any order."""
        columns = {quantity: list(getattr(self, quantity)) for quantity in QUANTITIES}
        named: set[str] = set()
        for tolerance in asked:
            if tolerance.name not in robot.joint_names:
                known = ", ".join(robot.joint_names)
                raise GoalJointsError(f"goal_tolerance names the joint {tolerance.name!r}; expected only {known}")
            if tolerance.name in named:
                raise GoalError(f"goal_tolerance names {tolerance.name} twice; expected once")
            named.add(tolerance.name)
            index = robot.joint_names.index(tolerance.name)
            for quantity, column in columns.items():
                value = getattr(tolerance, quantity)
                if math.isnan(value):
                    expected = "expected a number, 0 for the default, below 0 for no bound"
                    raise GoalError(f"goal_tolerance: the {quantity} of {tolerance.name} is nan; {expected}")
                if value:
                    column[index] = value if value > 0.0 else math.inf
        return Tolerances(*(tuple(column) for column in columns.values()))

    def violation(
        self, robot: RobotModel, position: Sequence[float], velocity: Sequence[float], acceleration: Sequence[float]
    ) -> str:
        """Return which joint is off by more than it may, actual minus desired, with the values; "" when none is."""
        for (quantity, per), errors in zip(QUANTITIES.items(), (position, velocity, acceleration)):
            for index, (error, bound) in enumerate(zip(errors, getattr(self, quantity))):
                # written so that a nan does not pass
                if not abs(error) <= bound:
                    unit = ("m" if robot.linear[index] else "rad") + per
                    return Sentence(
                        "the {quantity} of {joint} is off by {error}; its tolerance is {bound}",
                        quantity=quantity,
                        joint=robot.joint_names[index],
                        error=Quantity(abs(error), unit),
                        bound=Quantity(bound, unit),
                    )
        return ""


def check_joint_names(robot: RobotModel, names: Sequence[str]) -> None:
    """Raise GoalJointsError unless a goal names each of the robot's joints once, in any order."""
    if sorted(names) != sorted(robot.joint_names):
        expected = f"expected each of {', '.join(robot.joint_names)} once"
        raise GoalJointsError(f"the goal names the joints {', '.join(names) or 'none'}; {expected}")

"""The dense re-check of plans of every origin: limits at every 4 ms sample; the scene at every sample and between them.

Between two samples each joint is taken to go evenly. The plan's own curve is beside that line by about (4 ms)^2 / 8 times the
acceleration per joint: on the KR 120 no point by more than 0.1 mm, the end of a bar of 4 m by 0.4 mm (docs/planning.md).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.planning.limit_usage import SampledUsage, range_excess, sampled_usage
from construction_twin.robot.description import RobotModel
from construction_twin.robot.motion_errors import PlanningError
from construction_twin.robot.plan import LimitUsage, PlanReport
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.collision_world import CollisionWorld


class CollisionError(PlanningError):
    """Two bodies that must not touch do: `between` a link or carried object and a link or object, at `time` in a motion [s]."""

    def __init__(self, between: tuple[str, str], where: str, time: float | None = None):
        first, second = self.between = between
        self.where, self.time = where, time
        super().__init__(self._sentence(first=first, second=second, where=where))

    def _sentence(self, **values: str) -> Sentence:
        return Sentence(
            "{first} touches {second} ({where}), or comes closer than the padding; expected no contact, "
            "choose another pose or change the scene",
            **values,
        )


class LimitError(PlanningError):
    """A motion breaks a limit of position, velocity, acceleration or jerk; of a position `limit` is the end of the range."""

    def __init__(self, where: str, joint: str, quantity: str, value: float, limit: float, linear: bool = False):
        self.where, self.joint, self.quantity, self.value, self.limit = where, joint, quantity, value, limit
        unit = ("m" if linear else "rad") + {"velocity": "/s", "acceleration": "/s^2", "jerk": "/s^3"}.get(quantity, "")
        super().__init__(
            Sentence(
                "{where}: {joint} has a {quantity} of {value}; its limit is {limit}; plan again",
                where=where,
                joint=joint,
                quantity=quantity,
                value=Quantity(value, unit),
                limit=Quantity(limit, unit),
            )
        )


#: Rounding allowed on a fraction of a limit.
ROUNDING = 1e-6
_QUANTITIES = ("velocity", "acceleration", "jerk")


def recheck(
    trajectory: Trajectory,
    robot: RobotModel,
    world: CollisionWorld,
    clock: Callable[[], float],
    sampled: SampledUsage | None = None,
) -> PlanReport:
    """Check and measure a trajectory: its limits at every 4 ms sample, its contacts and clearance also between two samples.

    `sampled`: The `sampled_usage` of this very trajectory. LimitError, CollisionError: at a sample, or between two.
    """
    began = clock()
    if sampled is None or sampled.trajectory is not trajectory:
        sampled = sampled_usage(trajectory, robot)
    usage = _check_usage(sampled, robot)
    # the 4 ms grid may end up to one cycle before the last waypoint, so the last waypoint is added
    moving = sampled.times < trajectory.duration
    times = np.append(sampled.times[moving], trajectory.duration)
    q = np.concatenate((sampled.positions[moving], trajectory.positions[-1:]))
    check_free(q, times, world)
    clearance, place = world.clearance_of(q, changing=True)
    clearance = dataclasses.replace(clearance, time=time_at(times, place))
    return PlanReport(clearance, usage, clock() - began)


def check_limits(trajectory: Trajectory, robot: RobotModel) -> LimitUsage:
    """Check every 4 ms sample of a trajectory against the robot's limits; LimitError for the first one outside."""
    return _check_usage(sampled_usage(trajectory, robot), robot)


def _check_usage(sampled: SampledUsage, robot: RobotModel) -> LimitUsage:
    _check_range(sampled, robot)
    for quantity in _QUANTITIES:
        fractions = getattr(sampled, quantity)
        beyond = np.argwhere(fractions > 1.0 + ROUNDING)
        if len(beyond):
            row, joint = beyond[0]
            limit = getattr(robot, quantity)[joint]
            when, found = _at(sampled.times[row]), float(fractions[row, joint] * limit)
            raise LimitError(when, robot.joint_names[joint], quantity, found, limit, robot.linear[joint])
    return sampled.largest()


def check_free(q: np.ndarray, times: np.ndarray, world: CollisionWorld) -> None:
    """Raise CollisionError for the first contact in the rows or between them, where each joint goes evenly to the next row.

    `times`: when each row is reached [s], for the message.
    """
    found = world.first_contact(q)
    if found is not None:
        place, contact = found
        seconds = time_at(times, place)
        raise CollisionError(contact.between, _at(seconds), seconds)


def time_at(times: np.ndarray, place: float) -> float:
    """Return the time at a place on a motion [s], given the times of its rows; 3.5 is half way from row 3 to row 4."""
    return float(np.interp(place, np.arange(len(times)), times))


def _check_range(sampled: SampledUsage, robot: RobotModel) -> None:
    excess = range_excess(sampled.positions, robot)
    if not excess.any():
        return
    row = int(np.argmax(np.any(excess > 0.0, axis=1)))
    joint = int(np.argmax(excess[row]))
    value = float(sampled.positions[row, joint])
    limit = robot.lower[joint] if value < robot.lower[joint] else robot.upper[joint]
    raise LimitError(_at(sampled.times[row]), robot.joint_names[joint], "position", value, limit, robot.linear[joint])


def _at(seconds: float) -> Sentence:
    return Sentence("at {seconds:.3f} s", seconds=float(seconds))

"""The dense re-check: every 4 ms sample of a trajectory against the robot's limits and the scene, whoever planned it.

What it measures is what a reviewer sees: closest clearance and where, largest fraction of each limit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Protocol

import numpy as np

from construction_twin.core.motion_errors import CollisionError, JointRangeError, LimitError
from construction_twin.planning.limit_usage import cycle_times, usage_over_time
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Clearance, LimitUsage, PlanReport
from construction_twin.robot.trajectory import Trajectory

#: Rounding allowed on a fraction of a limit.
ROUNDING = 1e-6
_QUANTITIES = ("velocity", "acceleration", "jerk")


class Contact(Protocol):
    """As `scene.world.Contact`."""

    between: tuple[str, str]


class World(Protocol):
    """What is asked of `scene.world.CollisionWorld`."""

    def all_free(self, qs: np.ndarray) -> int | None:
        """Return the first row in contact, or None."""

    def contact(self, q: np.ndarray) -> Contact | None:
        """Return a pair that touches, or None."""

    def clearance_of(self, qs: np.ndarray) -> tuple[Clearance, int]:
        """Return the smallest distance over all rows, and the row where it is."""


def recheck(trajectory: Trajectory, robot: RobotModel, world: World, clock: Callable[[], float]) -> PlanReport:
    """Check and measure every 4 ms sample of a trajectory.

    Parameters
    ----------
    trajectory : Trajectory
        In the robot's joint order.
    robot : RobotModel
    world : CollisionWorld
    clock : callable
        Returns seconds from any fixed origin; measures `PlanReport.recheck_time`.

    Returns
    -------
    report : PlanReport

    Raises
    ------
    LimitError
        If a sample is outside the range or a limit.
    CollisionError
        If a sample is in contact; `where` says when.
    """
    began = clock()
    fractions = check_limits(trajectory, robot)
    times = cycle_times(trajectory)
    # past its end the motion rests where the last sample in time is, up to one cycle short of the last waypoint
    times = np.append(times[times < trajectory.duration], trajectory.duration)
    q = trajectory.sample_many(times)[0]
    check_free(q, times, world)
    clearance, row = world.clearance_of(q)
    clearance = dataclasses.replace(clearance, time=float(times[row]))
    return PlanReport(clearance, fractions, clock() - began)


def check_limits(trajectory: Trajectory, robot: RobotModel) -> LimitUsage:
    """Check every 4 ms sample of a trajectory against the robot's limits.

    Parameters
    ----------
    trajectory : Trajectory
    robot : RobotModel

    Returns
    -------
    fractions : LimitUsage

    Raises
    ------
    LimitError
        For the first sample outside, naming time, joint, quantity, value and limit.
    """
    try:
        fractions = usage_over_time(trajectory, robot)
    except JointRangeError as error:
        raise _range_error(trajectory, robot) from error
    for quantity, fraction in zip(_QUANTITIES, fractions):
        beyond = np.argwhere(fraction > 1.0 + ROUNDING)
        if len(beyond):
            row, joint = beyond[0]
            limit = getattr(robot, quantity)[joint]
            when = f"at {cycle_times(trajectory)[row]:.3f} s"
            raise LimitError(when, robot.joint_names[joint], quantity, float(fraction[row, joint] * limit), limit)
    return LimitUsage(*(tuple(np.max(fraction, axis=0).tolist()) for fraction in fractions))


def check_free(q: np.ndarray, times: np.ndarray, world: World) -> None:
    """Check that no row is in contact.

    Parameters
    ----------
    q : array, shape (m, n)
    times : array, shape (m,)
        When each is reached [s], for the message.
    world : CollisionWorld

    Raises
    ------
    CollisionError
        For the first that is, with the pair and ``at ... s``.
    """
    row = world.all_free(q)
    if row is not None:
        raise CollisionError(world.contact(q[row]).between, f"at {times[row]:.3f} s")


def _range_error(trajectory: Trajectory, robot: RobotModel) -> LimitError:
    times = cycle_times(trajectory)
    q = trajectory.sample_many(times)[0]
    excess = np.maximum(np.array(robot.lower) - q, q - np.array(robot.upper))
    row = int(np.argmax(np.any(excess > 0.0, axis=1)))
    joint = int(np.argmax(excess[row]))
    value = float(q[row, joint])
    limit = robot.lower[joint] if value < robot.lower[joint] else robot.upper[joint]
    return LimitError(f"at {times[row]:.3f} s", robot.joint_names[joint], "position", value, limit)

"""The dense re-check: every 4 ms sample of a trajectory against the robot's limits and the scene, for plans of every origin.

What it measures is shown to the reviewer: the smallest clearance and where it is, and the largest use of each limit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Protocol

import numpy as np

from construction_twin.core.motion_errors import CollisionError, LimitError
from construction_twin.planning.limit_usage import SampledUsage, cycle_times, range_excess, sampled_usage
from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.robot.plan import Clearance, LimitUsage, PlanReport
from construction_twin.robot.trajectory import Trajectory

#: Rounding allowed on a fraction of a limit.
ROUNDING = 1e-6
_QUANTITIES = ("velocity", "acceleration", "jerk")


class Contact(Protocol):
    """As `scene.collision_world.Contact`."""

    @property
    def between(self) -> tuple[str, str]:
        """Names of the two bodies."""


class World(Protocol):
    """The part of `scene.collision_world.CollisionWorld` that planning uses."""

    def all_free(self, qs: np.ndarray) -> int | None:
        """Return the first row in contact, or None."""

    def contact(self, q: JointValues) -> Contact | None:
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
    usage = check_limits(trajectory, robot)
    times = cycle_times(trajectory)
    # the 4 ms grid may end up to one cycle before the last waypoint, so the last waypoint is added
    times = np.append(times[times < trajectory.duration], trajectory.duration)
    q = trajectory.sample_many(times)[0]
    check_free(q, times, world)
    clearance, row = world.clearance_of(q)
    clearance = dataclasses.replace(clearance, time=float(times[row]))
    return PlanReport(clearance, usage, clock() - began)


def check_limits(trajectory: Trajectory, robot: RobotModel) -> LimitUsage:
    """Check every 4 ms sample of a trajectory against the robot's limits.

    Parameters
    ----------
    trajectory : Trajectory
    robot : RobotModel

    Returns
    -------
    usage : LimitUsage

    Raises
    ------
    LimitError
        For the first sample outside, naming time, joint, quantity, value and limit.
    """
    sampled = sampled_usage(trajectory, robot)
    _check_range(sampled, robot)
    for quantity in _QUANTITIES:
        fractions = getattr(sampled, quantity)
        beyond = np.argwhere(fractions > 1.0 + ROUNDING)
        if len(beyond):
            row, joint = beyond[0]
            limit = getattr(robot, quantity)[joint]
            when, found = f"at {sampled.times[row]:.3f} s", float(fractions[row, joint] * limit)
            raise LimitError(when, robot.joint_names[joint], quantity, found, limit, robot.linear[joint])
    return sampled.largest()


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
        raise CollisionError(touching(world, q[row]), f"at {times[row]:.3f} s")


def touching(world: World, q: JointValues) -> tuple[str, str]:
    """Return the names of two bodies that touch, at joint values that `World.all_free` found in contact."""
    contact = world.contact(q)
    assert contact is not None, "all_free and contact disagree"
    return contact.between


def _check_range(sampled: SampledUsage, robot: RobotModel) -> None:
    excess = range_excess(sampled.positions, robot)
    if not excess.any():
        return
    row = int(np.argmax(np.any(excess > 0.0, axis=1)))
    joint = int(np.argmax(excess[row]))
    value = float(sampled.positions[row, joint])
    limit = robot.lower[joint] if value < robot.lower[joint] else robot.upper[joint]
    raise LimitError(
        f"at {sampled.times[row]:.3f} s", robot.joint_names[joint], "position", value, limit, robot.linear[joint]
    )

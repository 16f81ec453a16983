"""How much of the robot's limits a trajectory uses, at every 4 ms sample.

Joint vectors are in the order of `RobotModel.joint_names`, SI. Velocity, acceleration and jerk are taken twice, from the
quintics and from differences of the sampled positions (which is what the controller sees), and the larger counts; of the
jerk also what it is just before and after every waypoint, where it jumps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from construction_twin.core.motion_errors import JointRangeError
from construction_twin.core.units import CYCLE
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import LimitUsage
from construction_twin.robot.trajectory import Trajectory

#: Points closer than this are one, and ranges are met to this [rad] or [m], per joint.
SAME_POINT = 1e-9


@dataclass(frozen=True)
class LimitUse:
    """Largest fraction of each limit that a trajectory uses, over all joints and 4 ms samples; 1 is exactly at the
    limit."""

    velocity: float
    acceleration: float
    jerk: float


def limit_use(trajectory: Trajectory, robot: RobotModel) -> LimitUse:
    """Measure a trajectory at every controller cycle against the robot's limits, as `limit_usage` does.

    Returns
    -------
    use : LimitUse
        The largest of all joints.
    """
    fractions = limit_usage(trajectory, robot)
    return LimitUse(max(fractions.velocity), max(fractions.acceleration), max(fractions.jerk))


def limit_usage(trajectory: Trajectory, robot: RobotModel) -> LimitUsage:
    """Measure a trajectory at every controller cycle against the robot's limits.

    See above for what is measured.

    Parameters
    ----------
    trajectory : Trajectory
    robot : RobotModel

    Returns
    -------
    fractions : LimitUsage

    Raises
    ------
    JointRangeError
        If a sample is out of range by more than rounding.
    """
    velocity, acceleration, jerk = (np.max(rows, axis=0).tolist() for rows in usage_over_time(trajectory, robot))
    return LimitUsage(tuple(velocity), tuple(acceleration), tuple(jerk))


def cycle_times(trajectory: Trajectory) -> np.ndarray:
    """Return the times of a trajectory's 4 ms samples [s], from 0 until it rests.

    The two after its end belong to it: differences over them see the last step.
    """
    return np.arange(0.0, trajectory.duration + 2.0 * CYCLE, CYCLE)


def usage_over_time(trajectory: Trajectory, robot: RobotModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return each joint's fraction of velocity, acceleration and jerk limit at every 4 ms sample.

    Returns
    -------
    velocity, acceleration, jerk : array, shape (m, n)
        At `cycle_times`.

    Raises
    ------
    JointRangeError
        If a sample is out of range by more than rounding.
    """
    times = cycle_times(trajectory)
    samples = trajectory.sample_many(times)
    check_range(samples[0], robot)
    return _fractions(trajectory, times, samples, robot)


def measured_usage(trajectory: Trajectory, robot: RobotModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the same as `usage_over_time`, also for a trajectory out of range."""
    times = cycle_times(trajectory)
    return _fractions(trajectory, times, trajectory.sample_many(times), robot)


def range_excess(trajectory: Trajectory, robot: RobotModel) -> np.ndarray:
    """Return by how much each 4 ms sample is out of range [rad] or [m], shape (m, n); 0 within `SAME_POINT` of it."""
    q = trajectory.sample_many(cycle_times(trajectory))[0]
    excess = np.maximum(np.array(robot.lower) - q, q - np.array(robot.upper))
    return np.where(excess > SAME_POINT, excess, 0.0)


def _fractions(
    trajectory: Trajectory, times: np.ndarray, samples: tuple, robot: RobotModel
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    q, qd, qdd, qddd = samples
    velocity, acceleration, jerk = np.abs(qd), np.abs(qdd), np.abs(qddd)
    # a difference belongs to the sample it ends at, or to the middle one; before and after the motion the arm rests
    step = np.diff(q, axis=0)
    second_difference = np.diff(step, axis=0, prepend=0.0, append=0.0)
    third_difference = np.diff(second_difference, axis=0, prepend=0.0, append=0.0)
    np.maximum(velocity[1:], np.abs(step) / CYCLE, out=velocity[1:])
    np.maximum(acceleration, np.abs(second_difference) / CYCLE**2, out=acceleration)
    np.maximum(jerk, np.maximum(np.abs(third_difference[:-1]), np.abs(third_difference[1:])) / CYCLE**3, out=jerk)
    rows = np.minimum(np.searchsorted(times, trajectory.times), len(times) - 1)
    before, after = _knot_jerks(trajectory)
    # a knot counts for the sample after it; there may be several between two samples
    np.maximum.at(jerk, rows[:-1], after)
    np.maximum.at(jerk, rows[1:], before)
    return velocity / robot.velocity, acceleration / robot.acceleration, jerk / robot.jerk


def _knot_jerks(trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Return the size of the jerk just before each waypoint but the first, and just after each but the last.

    The jerk of the quintics jumps at the waypoints, and is largest there more often than between them.
    """
    h = np.diff(trajectory.times)[:, None]
    step = 60.0 * np.diff(trajectory.positions, axis=0)
    (v0, v1), (a0, a1) = ((rows[:-1], rows[1:]) for rows in (trajectory.velocities, trajectory.accelerations))
    after = (step - (36.0 * v0 + 24.0 * v1) * h - (9.0 * a0 - 3.0 * a1) * h**2) / h**3
    before = (step - (24.0 * v0 + 36.0 * v1) * h - (3.0 * a0 - 9.0 * a1) * h**2) / h**3
    return np.abs(before), np.abs(after)


def check_range(q: np.ndarray, robot: RobotModel) -> None:
    """Check that joint vectors are in range, to `SAME_POINT`.

    Parameters
    ----------
    q : array, shape (m, n)
    robot : RobotModel

    Raises
    ------
    JointRangeError
        For the first that is not.
    """
    outside = np.argwhere((q < np.array(robot.lower) - SAME_POINT) | (q > np.array(robot.upper) + SAME_POINT))
    if len(outside):
        row, joint = outside[0]
        raise JointRangeError(robot.joint_names[joint], float(q[row, joint]), robot.lower[joint], robot.upper[joint])

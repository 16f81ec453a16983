"""How much of the robot's limits a trajectory uses, at every 4 ms sample.

Velocity, acceleration and jerk are computed from the quintics, just before and after each waypoint included, and from differences
of the samples (what the controller sees); the larger value counts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from construction_twin.core.limits import OUTSIDE
from construction_twin.core.units import CYCLE
from construction_twin.robot.description import RobotModel
from construction_twin.robot.motion_errors import JointRangeError
from construction_twin.robot.plan import LimitUsage
from construction_twin.robot.trajectory import Trajectory

#: A time in a message is a whole number of these [s]. Off by one, a waypoint is beside the motion by its velocity times this, and
#: the first three derivatives of the curve through it have so many times as much, over that power of the time to the next waypoint;
#: so many at most, whether velocities and accelerations are given or not.
TIME_UNIT = 1e-9
BENDS = (2.0, 6.0, 60.0)
#: Points closer than this are one, and ranges are met to this [rad] or [m], per joint.
SAME_POINT = 1e-9


@dataclass(frozen=True, eq=False)
class SampledUsage:
    """A trajectory's use of the limits at `cycle_times`, as fractions of each joint's limit: arrays of shape (m, n)."""

    trajectory: Trajectory
    times: np.ndarray
    positions: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    jerk: np.ndarray

    def largest(self) -> LimitUsage:
        """Return the largest fraction of each joint's limits."""
        velocity, acceleration, jerk = (
            tuple(np.max(fractions, axis=0).tolist()) for fractions in (self.velocity, self.acceleration, self.jerk)
        )
        return LimitUsage(velocity, acceleration, jerk)


def cycle_times(trajectory: Trajectory) -> np.ndarray:
    """Return the times of a trajectory's 4 ms samples [s], with two after its end, whose differences contain the last step."""
    return np.arange(0.0, trajectory.duration + 2.0 * CYCLE, CYCLE)


def sampled_usage(trajectory: Trajectory, robot: RobotModel, given_times: bool = False) -> SampledUsage:
    """Return a trajectory's use of the limits at every 4 ms sample, ranges not checked.

    `given_times`: Leave out what the rounding of its times to `TIME_UNIT` can add: much of the jerk where waypoints are close (60
    rad/s^3 at 1 rad/s where they are 1 ms apart).
    """
    times = cycle_times(trajectory)
    q, *derivatives = trajectory.sample_many(times)
    curve = [np.abs(values) for values in derivatives]
    after, before, _ = segment_jerks(
        trajectory.times, trajectory.positions, trajectory.velocities, trajectory.accelerations
    )
    after, before = np.abs(after), np.abs(before)
    # a difference belongs to the sample it ends at, or to the middle one; before and after the motion the arm rests
    step = np.diff(q, axis=0, prepend=q[:1])
    second = np.diff(step, axis=0, append=0.0)
    third = np.abs(np.diff(second, axis=0, prepend=0.0, append=0.0))
    steps = [np.abs(step) / CYCLE, np.abs(second) / CYCLE**2, np.maximum(third[:-1], third[1:]) / CYCLE**3]
    if given_times:
        beside, bends = _rounding(trajectory)
        segments = np.clip(np.searchsorted(trajectory.times, times, side="right") - 1, 0, len(beside) - 1)
        for order, bend in enumerate(bends, 1):
            curve[order - 1] -= bend[segments]
            steps[order - 1] -= (2.0 / CYCLE) ** order * beside[segments]
        after, before = after - bends[-1], before - bends[-1]
    velocity, acceleration, jerk = map(np.maximum, curve, steps)
    # a waypoint is assigned to the sample after it; there may be several waypoints between two samples
    samples = np.minimum(np.searchsorted(times, trajectory.times), len(times) - 1)
    np.maximum.at(jerk, samples[:-1], after)
    np.maximum.at(jerk, samples[1:], before)
    fractions = velocity / robot.velocity, acceleration / robot.acceleration, jerk / robot.jerk
    return SampledUsage(trajectory, times, q, *fractions)


def _rounding(trajectory: Trajectory) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return how far the rounding of times puts waypoints beside the motion, and what its derivatives have of it, per segment."""
    spans = np.diff(trajectory.times)
    # velocities or accelerations that were not given come of the segments on both sides
    shortest = np.minimum(spans, np.minimum(np.append(spans[1:], np.inf), np.append(np.inf, spans[:-1])))[:, None]
    speeds = np.abs(trajectory.velocities)
    beside = TIME_UNIT * np.maximum(speeds[:-1], speeds[1:])
    return beside, [factor * beside / shortest**order for order, factor in enumerate(BENDS, 1)]


def range_excess(q: np.ndarray, robot: RobotModel) -> np.ndarray:
    """Return by how much the samples of a motion, shape (m, n), are out of range [rad] or [m]; 0 within `SAME_POINT`.

    Also 0 on the way in from a start up to `OUTSIDE` out of range.
    """
    excess = np.maximum(np.array(robot.lower) - q, q - np.array(robot.upper))
    allowed = np.minimum.accumulate(np.minimum(excess, np.where(robot.linear, OUTSIDE[1], OUTSIDE[0])), axis=0)
    return np.where(excess > np.maximum(allowed, 0.0) + SAME_POINT, excess, 0.0)


def segment_jerks(
    times: np.ndarray, positions: np.ndarray, velocities: np.ndarray, accelerations: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the jerk of the quintics just after and before each waypoint, and its largest size on each, shape (k - 1, n) each."""
    h = np.diff(times)[:, None]
    step = 60.0 * np.diff(positions, axis=0)
    v0, v1 = velocities[:-1] * h, velocities[1:] * h
    h2 = h * h
    a0, a1 = accelerations[:-1] * h2, accelerations[1:] * h2
    h3 = h2 * h
    after = (step - 36.0 * v0 - 24.0 * v1 - 9.0 * a0 + 3.0 * a1) / h3
    before = (step - 24.0 * v0 - 36.0 * v1 - 3.0 * a0 + 9.0 * a1) / h3
    # after + slope x + bend x^2 for x from 0 to 1, whose mean is the change of the acceleration over h
    bend = 3.0 * (after + before) - 6.0 * (a1 - a0) / h3
    slope = before - after - bend
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = -0.5 * slope / bend
    inner = np.where((turn > 0.0) & (turn < 1.0), np.abs(after + 0.5 * slope * turn), 0.0)
    return after, before, np.maximum(np.maximum(np.abs(after), np.abs(before)), inner)


def check_range(q: np.ndarray, robot: RobotModel) -> None:
    """Check the samples of a motion, shape (m, n), by `range_excess`; JointRangeError for the first value that is out of range."""
    outside = np.argwhere(range_excess(q, robot) > 0.0)
    if len(outside):
        row, joint = outside[0]
        where = robot.joint_names[joint], float(q[row, joint]), robot.lower[joint], robot.upper[joint]
        raise JointRangeError(*where, robot.linear[joint])

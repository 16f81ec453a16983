"""Time parameterisation: from a joint path to a trajectory inside the robot's limits, starting and ending at rest.

Joint vectors are in the order of `RobotModel.joint_names`, SI. How it works: a cubic spline through the path's points;
toppra finds the fastest motion s(t) along it; two sliding means over time make its acceleration continuous and zero at
both ends; the result is sampled at the waypoints; and what will be played, the quintics between them, is measured and
stretched in time until it is inside the limits. Does not know obstacles: between its points a curved path leaves the
straight line.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import PPoly
from toppra import SplineInterpolator
from toppra.algorithm import TOPPRA
from toppra.constraint import JointAccelerationConstraint, JointVelocityConstraint

from construction_twin.errors import DurationError, JointRangeError, PlanningError, TrajectoryError
from construction_twin.robot import RobotModel
from construction_twin.trajectory import Trajectory, whole_nanoseconds
from construction_twin.units import CYCLE

#: Share of the velocity and acceleration limits a plan uses. The rest is for what happens after planning and is checked
#: against the full limits: rounding to the wire's decimals adds up to 0.25 deg/s at 3 decimals (its share of the
#: acceleration is allowed for separately), and the gateway interpolates between setpoints on another clock's grid.
LIMIT_SHARE = 0.9
#: Spacing of the waypoints when the request does not count them [s], and the fewest then used.
WAYPOINT_SPACING = 0.02
MINIMUM_WAYPOINTS = 20
#: Shortest first smoothing window [s]; the second is half as long.
SHORTEST_WINDOW = 0.1
#: Points closer than this are one [rad], per joint.
SAME_POINT = 1e-9
#: Stages of toppra along the whole path.
STAGES = 200
#: Resolution of the factor by which a motion is slowed into the limits.
STRETCH_STEP = 1e-4
#: How often the distance of the path's points is halved to keep the spline through them in the joint range.
DENSIFY_ROUNDS = 6


def time_path(
    path: np.ndarray,
    robot: RobotModel,
    duration: float | None = None,
    speed_scale: float = 1.0,
    waypoints: int | None = None,
) -> Trajectory:
    """Time a joint path.

    The trajectory starts and ends at rest (velocities and accelerations exactly 0), exactly at the path's ends. At
    every 4 ms sample its velocities and accelerations are within `LIMIT_SHARE` times `speed_scale` of the robot's
    limits, its jerk within the robot's limit, its positions within the range.

    Parameters
    ----------
    path : array, shape (m, n)
        Points of the path [rad], at least two. Two make a straight line, more a cubic spline through all of them.
    robot : RobotModel
    duration : float, optional
        Duration of the motion [s], to the nanosecond. Default: as short as the limits allow.
    speed_scale : float, optional
        Share of the velocity and acceleration limits in (0, 1].
    waypoints : int, optional
        Number of waypoints, equally spaced in time, at least 2. With few of them the motion between two leaves the
        path. Default: one every `WAYPOINT_SPACING`, at least `MINIMUM_WAYPOINTS`.

    Returns
    -------
    trajectory : Trajectory

    Raises
    ------
    DurationError
        If `duration` is shorter than the limits allow.
    JointRangeError
        If the path leaves the range.
    TrajectoryError
        If the path ends where it starts, or its shape or a value does not make sense.
    PlanningError
        If another argument does not make sense, or the path cannot be timed.
    """
    _check_request(duration, speed_scale, waypoints)
    path = _check_path(path, robot)
    for _ in range(DENSIFY_ROUNDS):
        try:
            return _time_spline(path, robot, duration, speed_scale * LIMIT_SHARE, waypoints)
        except JointRangeError:
            # a cubic spline swings past its points by a share of their distance: halve the distance
            path = with_midpoints(path)
    return _time_spline(path, robot, duration, speed_scale * LIMIT_SHARE, waypoints)


@dataclass(frozen=True)
class LimitUse:
    """Largest share of each limit that a trajectory uses, over all joints and 4 ms samples; 1 is exactly at the
    limit."""

    velocity: float
    acceleration: float
    jerk: float


def limit_use(trajectory: Trajectory, robot: RobotModel) -> LimitUse:
    """Measure a trajectory at every controller cycle against the robot's limits.

    Velocity and acceleration are taken twice, from the quintics and from differences of the sampled positions (which is
    what gate and gateway check), and the larger counts.

    Parameters
    ----------
    trajectory : Trajectory
    robot : RobotModel

    Returns
    -------
    use : LimitUse

    Raises
    ------
    JointRangeError
        If a sample is out of range by more than rounding.
    """
    q, qd, qdd, qddd = trajectory.sample_many(np.arange(0.0, trajectory.duration + 2.0 * CYCLE, CYCLE))
    _check_samples_in_range(q, robot)
    step = np.diff(q, axis=0)
    bend = np.diff(step, axis=0)
    return LimitUse(
        velocity=max(_peak(qd, robot.velocity), _peak(step, robot.velocity) / CYCLE),
        acceleration=max(_peak(qdd, robot.acceleration), _peak(bend, robot.acceleration) / CYCLE**2),
        jerk=_peak(qddd, robot.jerk),
    )


def with_midpoints(path: np.ndarray) -> np.ndarray:
    """Halve every segment of a path, so that a curve through its points stays closer to the straight lines between
    them.

    Parameters
    ----------
    path : array, shape (m, n)

    Returns
    -------
    denser : array, shape (2 * m - 1, n)
    """
    denser = np.empty((2 * len(path) - 1, path.shape[1]))
    denser[::2] = path
    denser[1::2] = 0.5 * (path[:-1] + path[1:])
    return denser


@dataclass(frozen=True)
class _SmoothMotion:
    """Progress s along the path over time, from 0 to the path's length: piecewise polynomials for s, ds/dt and
    d2s/dt2."""

    duration: float
    derivatives: tuple[PPoly, PPoly, PPoly]

    @classmethod
    def along(cls, spline: SplineInterpolator, robot: RobotModel, share: float) -> _SmoothMotion:
        fastest = _fastest_progress(spline, robot, share)
        # toppra switches between full acceleration and full deceleration: the first window spreads that switch, twice
        # the acceleration, over enough time for the jerk limit; the second makes jerk itself continuous
        window = 2.0 * share * max(a / j for a, j in zip(robot.acceleration, robot.jerk))
        first = max(SHORTEST_WINDOW, window)
        return cls._smoothed(fastest, first, 0.5 * first)

    @classmethod
    def _smoothed(cls, progress: PPoly, first: float, second: float) -> _SmoothMotion:
        """Take the mean over two windows, one after the other.

        d2s/dt2 of the result is a difference of four values of s divided by the windows, hence quadratic between
        shifted knots: three samples give each piece exactly, and integrating it keeps s and its derivatives consistent.
        """
        end = progress.x[-1]
        knots = np.unique(np.concatenate([progress.x + shift for shift in (0.0, first, second, first + second)]))

        def acceleration(t: np.ndarray) -> np.ndarray:
            s0, s1, s2, s3 = (progress(np.clip(t - shift, 0.0, end)) for shift in (0.0, first, second, first + second))
            return ((s0 - s1) - (s2 - s3)) / (first * second)

        h = np.diff(knots)
        start, middle, stop = acceleration(knots[:-1]), acceleration(knots[:-1] + 0.5 * h), acceleration(knots[1:])
        curve = 2.0 * (start - 2.0 * middle + stop) / h**2
        slope = (4.0 * middle - 3.0 * start - stop) / h
        sdd = PPoly(np.stack((curve, slope, start)), knots)
        sd = sdd.antiderivative()
        return cls(float(knots[-1]), (sd.antiderivative(), sd, sdd))


class _Sampler:
    """Builds the trajectory that plays a motion `stretch` times slower."""

    def __init__(
        self, path: np.ndarray, spline: SplineInterpolator, motion: _SmoothMotion, robot: RobotModel, count: int
    ):
        self.path = path
        self.spline = spline
        self.motion = motion
        self.robot = robot
        self.count = count

    def __call__(self, stretch: float, duration: float | None = None) -> Trajectory:
        duration = stretch * self.motion.duration if duration is None else duration
        times = whole_nanoseconds(np.linspace(0.0, duration, self.count))
        s, sd, sdd = (derivative(times / stretch) for derivative in self.motion.derivatives)
        s = np.clip(s, 0.0, self.spline.path_interval[1])
        sd, sdd = (sd / stretch)[:, None], (sdd / stretch**2)[:, None]
        first, second = self.spline(s, 1), self.spline(s, 2)
        positions = self.spline(s)
        velocities = first * sd
        accelerations = second * sd**2 + first * sdd
        positions[0], positions[-1] = self.path[0], self.path[-1]
        velocities[[0, -1]] = 0.0
        accelerations[[0, -1]] = 0.0
        return Trajectory(self.robot.joint_names, times, positions, velocities, accelerations)


def _time_spline(
    path: np.ndarray, robot: RobotModel, duration: float | None, share: float, waypoints: int | None
) -> Trajectory:
    """Time the spline through a checked path; `JointRangeError` if the spline or what is played leaves the range."""
    spline = _spline(path, robot)
    motion = _SmoothMotion.along(spline, robot, share)
    build = _Sampler(path, spline, motion, robot, waypoints or _default_waypoints(duration or motion.duration))
    stretch = _sufficient_stretch(build, robot, share)
    minimum = stretch * motion.duration
    if duration is None:
        return build(stretch)
    if duration < minimum:
        # rounded up, so that the duration the message names can be asked for
        raise DurationError(duration, math.ceil(minimum * 1e3) / 1e3)
    return build(duration / motion.duration, duration)


def _sufficient_stretch(build: _Sampler, robot: RobotModel, share: float) -> float:
    """Return the smallest factor (at least 1, and to `STRETCH_STEP`) by which the motion must be slowed to meet the
    limits."""
    stretch = 1.0
    for _ in range(20):  # two are usual; the 4 ms samples fall elsewhere in the slower motion, which can cost one more
        use = limit_use(build(stretch), robot)
        factor = max(use.velocity / share, math.sqrt(use.acceleration / share), math.cbrt(use.jerk))
        if factor <= 1.0:
            return stretch
        stretch *= factor * (1.0 + STRETCH_STEP)
    raise PlanningError(f"the path cannot be slowed into the limits; {factor:.6f} times too fast remains")


def _fastest_progress(spline: SplineInterpolator, robot: RobotModel, share: float) -> PPoly:
    """Return s(t) of the fastest motion along the spline, piecewise quadratic, from toppra."""
    logging.getLogger("toppra").setLevel(logging.CRITICAL)  # what it reports here is judged by its result
    knots, points = spline.waypoints
    length = knots[-1]
    # toppra's tolerances are absolute: it gets the path at length 1, and time in units of sqrt(length), which leaves
    # the accelerations as they are
    unit_path = SplineInterpolator(knots / length, (points - points[0]) / length)
    velocity = share * np.array(robot.velocity) / math.sqrt(length)
    acceleration = share * np.array(robot.acceleration)
    constraints = [
        JointVelocityConstraint(np.column_stack((-velocity, velocity))),
        JointAccelerationConstraint(np.column_stack((-acceleration, acceleration))),
    ]
    stages = _stages(knots / length)
    _, speed, _ = TOPPRA(constraints, unit_path, gridpoints=stages).compute_parameterization(0.0, 0.0)
    if speed is None or not np.all(np.isfinite(speed)) or np.any(speed[:-1] + speed[1:] <= 0.0):
        raise PlanningError("the path cannot be timed within the limits; choose another goal or points further apart")
    s, speed = stages * length, speed * math.sqrt(length)
    ds = np.diff(s)
    dt = 2.0 * ds / (speed[:-1] + speed[1:])
    half_acceleration = 0.25 * (speed[1:] ** 2 - speed[:-1] ** 2) / ds
    return PPoly(np.stack((half_acceleration, speed[:-1], s[:-1])), np.concatenate(([0.0], np.cumsum(dt))))


def _stages(knots: np.ndarray) -> np.ndarray:
    """Return toppra's grid along the path: every knot of the spline, and enough stages between them."""
    per_segment = max(2, math.ceil(STAGES / (len(knots) - 1)))
    pieces = [np.linspace(a, b, per_segment, endpoint=False) for a, b in pairwise(knots)]
    return np.concatenate([*pieces, knots[-1:]])


def _spline(path: np.ndarray, robot: RobotModel) -> SplineInterpolator:
    # knots as far apart as the slowest joint needs at full speed: even progress along s is then about even in time
    knots = np.concatenate(([0.0], np.cumsum(np.max(np.abs(np.diff(path, axis=0)) / robot.velocity, axis=1))))
    spline = SplineInterpolator(knots, path)
    _check_samples_in_range(spline(_stages(knots)), robot)
    return spline


def _check_samples_in_range(q: np.ndarray, robot: RobotModel) -> None:
    outside = np.argwhere((q < np.array(robot.lower) - SAME_POINT) | (q > np.array(robot.upper) + SAME_POINT))
    if len(outside):
        row, joint = outside[0]
        raise JointRangeError(robot.joint_names[joint], float(q[row, joint]), robot.lower[joint], robot.upper[joint])


def _check_request(duration: float | None, speed_scale: float, waypoints: int | None) -> None:
    if duration is not None and not 0.0 < duration < math.inf:
        raise PlanningError(f"the requested duration is {duration} s; expected a positive number")
    if not 0.0 < speed_scale <= 1.0:
        raise PlanningError(f"the requested speed scale is {speed_scale}; expected a share of the limits in (0, 1]")
    if waypoints is not None and waypoints < 2:
        raise PlanningError(f"{waypoints} waypoints are requested; a motion needs at least 2")


def _check_path(path: np.ndarray, robot: RobotModel) -> np.ndarray:
    path = np.array(path, dtype=np.float64)
    joints = len(robot.joint_names)
    if path.ndim != 2 or path.shape[1] != joints or len(path) < 2:
        raise TrajectoryError(f"the path has shape {path.shape}; expected at least 2 points of {joints} joints")
    if not np.all(np.isfinite(path)):
        row, joint = np.argwhere(~np.isfinite(path))[0]
        name = robot.joint_names[joint]
        raise TrajectoryError(f"point {row} of the path: {name} is {path[row, joint]}, not a finite number")
    for point in path:
        robot.check_range(point)
    apart = np.max(np.abs(np.diff(path, axis=0)), axis=1) > SAME_POINT
    if not np.any(apart):
        raise TrajectoryError("the arm is already there: the path's points are all the same; nothing to plan")
    kept = path[np.concatenate(([True], apart))]
    kept[-1] = path[-1]
    return kept


def _default_waypoints(duration: float) -> int:
    return max(MINIMUM_WAYPOINTS, math.ceil(duration / WAYPOINT_SPACING) + 1)


def _peak(values: np.ndarray, limits: tuple[float, ...]) -> float:
    return float(np.max(np.abs(values) / limits))

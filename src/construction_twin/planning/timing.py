"""Timing of a joint path: a trajectory inside the limits, continuous in acceleration, at rest at both ends.

Joint vectors are in the order of `RobotModel.joint_names`, SI. The points of a path are joined by a smooth curve
(`curves`), whose time scaling s(t) is found (`time_scaling`) and sampled at the waypoints. The quintics between the waypoints are
then measured and slowed until they are within the limits. Obstacles are not known here: between its points a curved path
leaves the straight line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from construction_twin.core.motion_errors import DurationError, JointRangeError, PlanningError
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import CYCLE
from construction_twin.planning.curves import JointCurve, interpolated, monotone, rounded
from construction_twin.planning.limit_usage import check_range, largest_jerk, sampled_usage
from construction_twin.planning.request_limits import PlanBounds, check_path, check_request, distinct
from construction_twin.planning.time_scaling import (
    JERK_FRACTION,
    RestToRest,
    TimeScaling,
    TimeScalingLimits,
    TimeScalingSearch,
    straight_time_scaling,
)
from construction_twin.robot.description import RobotModel
from construction_twin.robot.trajectory import Trajectory, whole_nanoseconds

#: Fractions of the velocity and acceleration limits that a plan uses. The remainder covers what happens to the setpoints after
#: planning, where they are checked against the full limits: the gateway interpolates between setpoints on the grid of another
#: clock, and makes up for what a speed limit has put off by playing 1 % faster (`gateway.slew.CATCH_UP`), which is 2 % more
#: acceleration. It changes that rate no faster than the motion leaves room for. Rounding to the wire's decimals has allowances of
#: its own.
VELOCITY_FRACTION = 0.99
ACCELERATION_FRACTION = 0.97
#: Spacing of the waypoints if the request gives no number of waypoints [s], and their smallest number then.
WAYPOINT_SPACING = 0.02
MINIMUM_WAYPOINTS = 20
#: Resolution of the factor by which a motion is slowed into the limits.
STRETCH_STEP = 1e-4
#: How often a motion is slowed. Two rounds are usual; the 4 ms samples of the slower motion lie at other places, which can need
#: another round.
STRETCH_ROUNDS = 20
#: A motion that is more than this many times too fast somewhere is slowed there; a smaller excess is removed by slowing the
#: whole motion.
LOCAL_SLOWING = 1.02
LOCAL_ROUNDS = 3
#: The same for `time_curve`, where slowing the whole motion would also slow the parts that run at the tool's speed.
CURVE_SLOWING = 1.002
CURVE_ROUNDS = 8
#: The same where no part may be passed faster than asked: the rest of the excess slows the whole motion, by at most this factor.
PACE_SLOWING = 1.01
PACE_ROUNDS = 12
#: Samples of a motion for each point, to find when it passes them.
PASSING_SAMPLES = 200
LARGEST_REST = 4.0
#: Inner points of a path keep this distance from the ends of the range [rad] or [m]: the quintics between the waypoints
#: overshoot the curve by less. About half of the last decimal of the joint string.
EDGE = 1e-5


def time_path(
    path: np.ndarray,
    robot: RobotModel,
    duration: float | None = None,
    speed_scale: float = 1.0,
    acceleration_scale: float | None = None,
    waypoints: int | None = None,
    corner_fraction: float | None = None,
    bounds: PlanBounds = PlanBounds(),
    times: np.ndarray | None = None,
) -> Trajectory:
    """Time a joint path.

    The trajectory starts and ends at rest (velocities and accelerations exactly 0), exactly at the path's ends. At
    every 4 ms sample its velocities are within `VELOCITY_FRACTION` times `speed_scale`, its accelerations within
    `ACCELERATION_FRACTION` times `acceleration_scale` of the robot's limits, its jerk within the robot's limit, its positions
    within the range.

    Args:
        path: Shape (m, n). Points of the path [rad] ([m] for a prismatic joint), at least two. Two make a straight line.
        duration: Duration of the motion [s], to the nanosecond. Default: as short as the limits allow.
        speed_scale: Fraction of the velocity limits in (0, 1].
        acceleration_scale: Fraction of the acceleration limits in (0, 1]. Default: `speed_scale`.
        waypoints: Number of waypoints, equally spaced in time, at least 2. With few waypoints the motion between two of them leaves
            the path. Default: one every `WAYPOINT_SPACING`, at least `MINIMUM_WAYPOINTS`.
        corner_fraction: In (0, 1]: follow the straight lines between the points and round the corners over this fraction of the
            available length (`curves.rounded`); never out of range. Default: a curve through all points (`curves.interpolated`, or
            `curves.monotone` where that would leave the range).
        bounds: Largest duration and number of waypoints. Default: any.
        times: Shape (m,). Increasing [s]: from one point to the next the motion takes no less time than these do. Not with
            `corner_fraction`.

    Raises:
        DurationError: If `duration` is shorter than the limits allow.
        JointRangeError: If a point is out of range, or the motion between few waypoints leaves the range.
        PlanSizeError: If the motion would be larger than `bounds`.
        TrajectoryError: If the path ends where it starts, or its shape or a value is invalid.
        PlanningError: If another argument is invalid, or the path cannot be timed.
    """
    acceleration_scale = speed_scale if acceleration_scale is None else acceleration_scale
    check_request(duration, speed_scale, acceleration_scale, waypoints, corner_fraction)
    asked = None if times is None else _asked_times(np.asarray(times, dtype=float), distinct(np.asarray(path)))
    path = check_path(path, robot)
    fractions = VELOCITY_FRACTION * speed_scale, ACCELERATION_FRACTION * acceleration_scale
    request = _Request(robot, duration, *fractions, waypoints, bounds)
    pace, ends, inside = np.array(robot.velocity), path[[0, -1]], _off_the_edge(path, robot)
    if corner_fraction is not None:
        return request.run(rounded(inside, pace, corner_fraction), ends)
    # a cubic spline overshoots its points by a fraction of their distance, so closer points may keep it in range
    slow = (
        request
        if asked is None
        else replace(request, asked=asked, local_slowing=PACE_SLOWING, local_rounds=PACE_ROUNDS)
    )
    between = slow if asked is None else replace(slow, asked=with_midpoints(asked[:, None])[:, 0])
    for way, points in ((slow, path), (between, with_midpoints(path))):
        try:
            return way.run(interpolated(points, pace), ends)
        except JointRangeError:
            continue
    return slow.run(monotone(inside, pace), ends)


def time_curve(
    curve,
    robot: RobotModel,
    speed_scale: float = 1.0,
    acceleration_scale: float | None = None,
    top_speed: float = math.inf,
    spacing: float = WAYPOINT_SPACING,
    bounds: PlanBounds = PlanBounds(),
) -> TimedCurve:
    """Time a given smooth joint curve from rest to rest, as fast as the limits allow.

    Args:
        curve: JointCurve or alike. Has `length`, `knots` (where its pieces meet, with both ends) and ``curve(s, order)`` for orders
            0 to 2.
        speed_scale, acceleration_scale: As in `time_path`.
        top_speed: Largest ds/dt [unit of `length` per s], for a curve over the length of the tool's path the tool's speed.
        spacing: Time between waypoints [s]; with a shorter one the motion stays closer to the curve.
        bounds: As in `time_path`.

    Returns:
        Its duration is a whole number of 4 ms cycles, so that motions joined one after the other stay on one 4 ms grid.

    Raises:
        JointRangeError: If the curve leaves the range.
        PlanningError: If an argument is invalid, the motion would be too large, or the curve cannot be timed.
    """
    acceleration_scale = speed_scale if acceleration_scale is None else acceleration_scale
    check_request(None, speed_scale, acceleration_scale, None, None)
    if not (top_speed > 0.0 and 0.0 < spacing < math.inf):
        raise PlanningError(Sentence("motion.timing.speed", speed=str(top_speed), spacing=str(spacing)))
    fractions = VELOCITY_FRACTION * speed_scale, ACCELERATION_FRACTION * acceleration_scale
    request = _Request(robot, None, *fractions, None, bounds, spacing, CURVE_SLOWING, CURVE_ROUNDS, whole_cycles=True)
    return request.timed(curve, curve(np.array([0.0, curve.length])), top_speed)


def minimum_duration(start: np.ndarray, goal: np.ndarray, robot: RobotModel) -> float:
    """Return a lower bound of the duration of any motion between two poses from rest to rest, from the limits alone.

    Each joint alone moves within its full velocity, acceleration and jerk limits; the slowest joint gives the bound. No motion
    within the limits is faster; most take longer.

    Args:
        start, goal: Shape (n,)

    Returns:
        [s]; 0 where nothing moves.
    """
    distances = np.abs(np.asarray(goal, dtype=float) - start)
    limits = zip(distances.tolist(), robot.velocity, robot.acceleration, robot.jerk)
    return max(RestToRest.fastest(*joint).duration if joint[0] > 0.0 else 0.0 for joint in limits)


def with_midpoints(path: np.ndarray) -> np.ndarray:
    """Halve every segment of a path, so that a curve through its points stays closer to the straight lines between
    them.

    Args:
        path: Shape (m, n)

    Returns:
        Shape (2 * m - 1, n)
    """
    denser = np.empty((2 * len(path) - 1, path.shape[1]))
    denser[::2] = path
    denser[1::2] = 0.5 * (path[:-1] + path[1:])
    return denser


@dataclass(frozen=True, eq=False)
class TimedCurve:
    """A curve with a motion along it.

    Attributes:
        stretch: The trajectory is this many times slower than `scaling`.
    """

    trajectory: Trajectory
    scaling: TimeScaling
    stretch: float

    def parameter(self, times: np.ndarray) -> np.ndarray:
        """Return where on the curve the motion is.

        Args:
            times: Shape (m,). [s]

        Returns:
            Shape (m,). From 0 to the curve's length.
        """
        return self.scaling.derivatives[0](np.clip(times / self.stretch, 0.0, self.scaling.duration))


@dataclass(frozen=True)
class _Request:
    """How to time a curve. The fractions of the robot's limits already contain `VELOCITY_FRACTION` and `ACCELERATION_FRACTION`."""

    robot: RobotModel
    duration: float | None
    velocity_fraction: float
    acceleration_fraction: float
    waypoints: int | None
    bounds: PlanBounds
    spacing: float = WAYPOINT_SPACING
    local_slowing: float = LOCAL_SLOWING
    local_rounds: int = LOCAL_ROUNDS
    whole_cycles: bool = False
    #: Times of the curve's knots [s]: between two of them the motion takes no less time.
    asked: np.ndarray | None = None

    def run(self, curve: JointCurve, ends: np.ndarray) -> Trajectory:
        """Time a curve; raises `JointRangeError` if the curve or the trajectory leaves the range."""
        timed = self.timed(curve, ends)
        minimum = timed.trajectory.duration
        if self.duration is None:
            return timed.trajectory
        if self.duration < minimum:
            # rounded up, so that a request for the duration in the message succeeds
            raise DurationError(self.duration, math.ceil(minimum * 1e3) / 1e3)
        return self._build(curve, timed.scaling, self.duration / timed.scaling.duration, ends, self.duration)

    def timed(self, curve, ends: np.ndarray, top_speed: float = math.inf) -> TimedCurve:
        """Return the fastest motion along a curve."""
        limits = TimeScalingLimits.fractions(self.robot, self.velocity_fraction, self.acceleration_fraction)
        if getattr(curve, "straight", False):
            return self._slowed(curve, straight_time_scaling(curve, limits, top_speed), ends)
        check_range(curve(_between(curve.knots)), self.robot)
        search = TimeScalingSearch(curve, limits, top_speed)
        if self.asked is not None:
            search.slow_down(*_asked_speed(curve.knots, self.asked))
        scaling, early = search.find(), np.ones(1)
        for rounds_left in range(self.local_rounds, -1, -1):
            self.bounds.check(scaling.duration)
            times = np.linspace(0.0, scaling.duration, math.ceil(scaling.duration / self.spacing) + 1)
            fractions = _motion_usage(times, *_states(curve, scaling, times)[1:], self.robot)
            factor = self._too_fast(*fractions, JERK_FRACTION)
            if self.asked is not None:
                passed = _passing_times(scaling, curve.knots)
                early = np.diff(self.asked) / np.diff(passed)
                factor = np.maximum(factor, early[np.clip(np.searchsorted(passed, times) - 1, 0, len(early) - 1)])
            if not rounds_left or np.max(factor) <= self.local_slowing:
                break
            search.slow_down(*_slower(scaling, times, factor))
            scaling = search.find()
        rest = float(np.max(early))
        if rest > LARGEST_REST:
            row = int(np.argmax(early)) + 1
            raise PlanningError(Sentence("motion.timing.too_slow", row=row, factor=rest))
        least = float(np.max(self._too_fast(*fractions))) * (1.0 - STRETCH_STEP)
        return self._slowed(curve, scaling, ends, max(least, rest))

    def _slowed(self, curve, scaling: TimeScaling, ends: np.ndarray, least: float = 1.0) -> TimedCurve:
        """Slow a motion by the smallest factor (at least 1 and `least`, to `STRETCH_STEP`) that brings it into the
        limits.
        """
        stretch = max(1.0, least)
        for _ in range(STRETCH_ROUNDS):
            if self.whole_cycles:
                stretch = math.ceil(stretch * scaling.duration / CYCLE - 1e-6) * CYCLE / scaling.duration
            trajectory = self._build(curve, scaling, stretch, ends)
            sampled = sampled_usage(trajectory, self.robot)
            check_range(sampled.positions, self.robot)
            factor = float(np.max(self._too_fast(sampled.velocity, sampled.acceleration, sampled.jerk)))
            factor = max(factor, float(np.cbrt(largest_jerk(trajectory, self.robot))))
            if factor <= 1.0:
                return TimedCurve(trajectory, scaling, stretch)
            stretch *= factor * (1.0 + STRETCH_STEP)
        raise PlanningError(Sentence("motion.timing.too_fast", factor=factor))

    def _too_fast(
        self, velocity: np.ndarray, acceleration: np.ndarray, jerk: np.ndarray, jerk_fraction: float = 1.0
    ) -> np.ndarray:
        """Return the factor by which a motion must be slowed at each time to meet the limits, from its use of them."""
        return np.maximum(
            np.maximum(
                velocity.max(axis=1) / self.velocity_fraction,
                np.sqrt(acceleration.max(axis=1) / self.acceleration_fraction),
            ),
            np.cbrt(jerk.max(axis=1) / jerk_fraction),
        )

    def _build(
        self, curve, scaling: TimeScaling, stretch: float, ends: np.ndarray, duration: float | None = None
    ) -> Trajectory:
        """Return the trajectory of a time scaling, `stretch` times slower."""
        duration = stretch * scaling.duration if duration is None else duration
        self.bounds.check(duration)
        count = self.waypoints or max(MINIMUM_WAYPOINTS, math.ceil(duration / self.spacing) + 1)
        self.bounds.check(duration, count)
        times = whole_nanoseconds(np.linspace(0.0, duration, count))
        s, velocities, accelerations = _states(curve, scaling, times / stretch)
        velocities /= stretch
        accelerations /= stretch**2
        positions = curve(s)
        positions[0], positions[-1] = ends
        velocities[[0, -1]] = 0.0
        accelerations[[0, -1]] = 0.0
        return Trajectory(self.robot.joint_names, times, positions, velocities, accelerations)


def _states(curve, scaling: TimeScaling, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the curve parameter, the joints' velocities and their accelerations at some times."""
    s, sd, sdd = (derivative(times) for derivative in scaling.derivatives)
    s = np.clip(s, 0.0, curve.length)
    sd, sdd = sd[:, None], sdd[:, None]
    first = curve(s, 1)
    return s, first * sd, curve(s, 2) * sd**2 + first * sdd


def _motion_usage(
    times: np.ndarray, velocities: np.ndarray, accelerations: np.ndarray, robot: RobotModel
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return each joint's fraction of the limits at some times of a motion, shape (m, n) each; jerk by differences."""
    jerks = np.diff(accelerations, axis=0) / np.diff(times)[:, None]
    jerks = np.concatenate((jerks, jerks[-1:]))
    return (
        np.abs(velocities) / robot.velocity,
        np.abs(accelerations) / robot.acceleration,
        np.abs(jerks) / robot.jerk,
    )


def _slower(scaling: TimeScaling, times: np.ndarray, factor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest ds/dt over s that slows the present motion by the factors; inf where it is not too fast.

    Around a time that is too fast, the motion is slowed over the half-width of the smoothing on both sides, because the smoothing
    averages over it.
    """
    reach = math.ceil(scaling.blur / (times[1] - times[0]))
    padded = np.pad(factor, reach, constant_values=1.0)
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1).max(axis=1)
    s, speed = scaling.derivatives[0](times), scaling.derivatives[1](times)
    return s, np.where(around > 1.0, speed / around, math.inf)


def _asked_times(times: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Return the times of the points that are kept; a pause at one of them belongs to the way to the next."""
    asked = times[kept]
    asked[-1] = times[-1]
    return asked


def _asked_speed(knots: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean ds/dt between knots that are passed at these times, over s; at a knot the smaller one of both sides."""
    speed, margin = np.diff(knots) / np.diff(times), 1e-6 * np.diff(knots)
    at_knots = np.minimum(np.append(speed, np.inf), np.concatenate(([np.inf], speed)))
    inside = np.column_stack((knots[:-1], knots[:-1] + margin, knots[1:] - margin)).ravel()
    values = np.column_stack((at_knots[:-1], speed, speed)).ravel()
    return np.append(inside, knots[-1]), np.append(values, at_knots[-1])


def _passing_times(scaling: TimeScaling, knots: np.ndarray) -> np.ndarray:
    """Return when a motion passes the knots of its curve [s]."""
    times = np.linspace(0.0, scaling.duration, PASSING_SAMPLES * len(knots))
    passed = np.interp(knots, np.maximum.accumulate(scaling.derivatives[0](times)), times)
    passed[0], passed[-1] = 0.0, scaling.duration
    return passed


def _between(knots: np.ndarray) -> np.ndarray:
    """Return four points of each piece and the end."""
    return np.concatenate([(knots[:-1, None] + np.diff(knots)[:, None] * [0.0, 0.25, 0.5, 0.75]).ravel(), knots[-1:]])


def _off_the_edge(path: np.ndarray, robot: RobotModel) -> np.ndarray:
    """Return the path with its inner points at least `EDGE` inside the range."""
    inside = path.copy()
    inside[1:-1] = np.clip(path[1:-1], np.array(robot.lower) + EDGE, np.array(robot.upper) - EDGE)
    return inside

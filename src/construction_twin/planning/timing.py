"""Timing of a joint path: a trajectory inside the limits, continuous in acceleration, at rest at both ends.

A smooth curve joins the points (`curves`); its time scaling (`time_scaling`) is sampled at the waypoints, and the quintics between
them are slowed until they are within the limits. Obstacles are not known here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from construction_twin.core.sentences import Sentence
from construction_twin.core.units import CYCLE
from construction_twin.planning.curves import JointCurve, interpolated, monotone, parameters, rounded
from construction_twin.planning.limit_usage import SampledUsage, check_range, sampled_usage, segment_jerks
from construction_twin.planning.request_limits import PlanBounds, check_path, check_request, distinct
from construction_twin.planning.time_scaling import (
    TimeScaling,
    TimeScalingLimits,
    TimeScalingSearch,
    straight_time_scaling,
)
from construction_twin.robot.description import RobotModel
from construction_twin.robot.motion_errors import JointRangeError, PlanningError
from construction_twin.robot.trajectory import Trajectory, whole_nanoseconds


class DurationError(PlanningError):
    """The requested duration is shorter than the limits allow [s]."""

    def __init__(self, requested: float, minimum: float):
        self.requested, self.minimum = requested, minimum
        super().__init__(
            f"a duration of {requested:.3f} s breaks the joint limits; the shortest possible is {minimum:.3f} s"
        )


#: Fractions of the velocity and acceleration limits that a plan uses. The remainder covers what happens to the setpoints after
#: planning, where they are checked against the full limits: the gateway interpolates between setpoints on the grid of another
#: clock, and makes up for what a speed limit has put off by playing 0.8 % faster (`gateway.slew.CATCH_UP`), which is 1.6 % more
#: acceleration. It changes that rate no faster than the motion leaves room for. Rounding to the wire's decimals has allowances of
#: its own.
VELOCITY_FRACTION = 0.992
ACCELERATION_FRACTION = 0.98
#: Spacing of the waypoints if the request gives no number of waypoints [s], and their smallest number then.
WAYPOINT_SPACING = 0.02
MINIMUM_WAYPOINTS = 20
#: A motion that is slowed keeps its waypoints while there would be no more than so many times their number.
SPACING_KEPT = 1.1
#: A velocity or acceleration limit is met up to rounding.
WITHIN = 1.0 + 1e-8
#: Resolution of the factor by which a motion is slowed into the limits.
STRETCH_STEP = 1e-4
#: How often a motion is slowed. Two rounds are usual; the 4 ms samples of the slower motion lie at other places, which can need
#: another round.
STRETCH_ROUNDS = 20
#: A motion that is more than this many times too fast somewhere is slowed there; a smaller excess is removed by slowing the
#: whole motion.
LOCAL_SLOWING = 1.02
LOCAL_ROUNDS = 4
#: The same for `time_curve`, where slowing the whole motion would also slow the parts that run at the tool's speed.
CURVE_SLOWING = 1.002
CURVE_ROUNDS = 8
#: The same where no part may be passed faster than asked: the rest of the excess slows the whole motion, by at most this factor.
PACE_SLOWING = 1.01
PACE_ROUNDS = 12
#: Samples of a motion for each point, to find when it passes them; of many points no more than these.
PASSING_SAMPLES = 200
MOST_PASSING_SAMPLES = 40_000
LARGEST_REST = 4.0
#: No straight motion is shorter [s].
SHORTEST_MOTION = 0.04
#: Inner points of a path keep this distance from the ends of the range [rad] or [m]: the quintics between the waypoints
#: overshoot the curve by less. About half of the last decimal of the joint string.
EDGE = 1e-5


def timed_path(
    path: np.ndarray,
    robot: RobotModel,
    duration: float | None = None,
    speed_scale: float = 1.0,
    acceleration_scale: float | None = None,
    waypoints: int | None = None,
    corner_fraction: float | None = None,
    bounds: PlanBounds = PlanBounds(),
    times: np.ndarray | None = None,
) -> TimedPath:
    """Time a joint path, shape (m, n), from rest to rest exactly at its ends.

    At every 4 ms sample its velocities are within `VELOCITY_FRACTION` times `speed_scale`, its accelerations within
    `ACCELERATION_FRACTION` times `acceleration_scale` of the robot's limits, its jerk and positions within the limits.

    Args:
        duration: [s]; None: as short as the limits allow.
        acceleration_scale: None: `speed_scale`.
        waypoints: Their number, equally spaced in time; None: one every `WAYPOINT_SPACING`, at least `MINIMUM_WAYPOINTS`. Few leave
            the path.
        corner_fraction: In (0, 1]: follow the straight lines and round the corners (`curves.rounded`). None: a curve through all
            points (`curves.interpolated`, or `curves.monotone` where that would leave the range).
        times: Shape (m,). [s] From one point to the next the motion takes no less time than these do.

    Raises:
        JointRangeError: If a point is out of range, or the motion between few waypoints leaves the range.
        PlanningError: If an argument is invalid, the path cannot be timed, or the motion would be larger than `bounds`.
    """
    acceleration_scale = speed_scale if acceleration_scale is None else acceleration_scale
    check_request(duration, speed_scale, acceleration_scale, waypoints, corner_fraction)
    asked = None if times is None else _asked_times(np.asarray(times, dtype=float), distinct(np.asarray(path)))
    path = check_path(path, robot)
    fractions = VELOCITY_FRACTION * speed_scale, ACCELERATION_FRACTION * acceleration_scale
    request = _Request(robot, duration, *fractions, waypoints, bounds)
    pace, ends, inside = np.array(robot.velocity), path[[0, -1]], _inside_edge(path, robot)
    if asked is not None:
        at = parameters(path, pace)
        request = replace(request, asked=(at, asked), local_slowing=PACE_SLOWING, local_rounds=PACE_ROUNDS)
    if corner_fraction is not None:
        return request.run(rounded(inside, pace, corner_fraction), ends)
    # a cubic spline overshoots its points by a fraction of their distance, so closer points may keep it in range
    for points in (path, with_midpoints(path)):
        try:
            return request.run(interpolated(points, pace), ends)
        except JointRangeError:
            continue
    return request.run(monotone(inside, pace), ends)


def time_path(path: np.ndarray, robot: RobotModel, **asked: Any) -> Trajectory:
    """Return the trajectory of `timed_path`; arguments as there."""
    return timed_path(path, robot, **asked).trajectory


def time_curve(
    curve: JointCurve,
    robot: RobotModel,
    speed_scale: float = 1.0,
    acceleration_scale: float | None = None,
    top_speed: float = math.inf,
    spacing: float = WAYPOINT_SPACING,
    bounds: PlanBounds = PlanBounds(),
) -> TimedCurve:
    """Time a given smooth joint curve from rest to rest in whole 4 ms cycles, as fast as the limits allow.

    `top_speed`: Largest ds/dt, for a curve over the length of the tool's path the tool's speed. `spacing` of the waypoints [s]:
    shorter stays closer to the curve. JointRangeError where it leaves the range.
    """
    acceleration_scale = speed_scale if acceleration_scale is None else acceleration_scale
    check_request(None, speed_scale, acceleration_scale, None, None)
    if not (top_speed > 0.0 and 0.0 < spacing < math.inf):
        raise PlanningError(
            f"the requested top speed is {top_speed}, the spacing {spacing} s; expected positive numbers"
        )
    fractions = VELOCITY_FRACTION * speed_scale, ACCELERATION_FRACTION * acceleration_scale
    request = _Request(robot, None, *fractions, None, bounds, spacing, CURVE_SLOWING, CURVE_ROUNDS, whole_cycles=True)
    return request.timed(curve, curve(np.array([0.0, curve.length])), top_speed)


def with_midpoints(path: np.ndarray) -> np.ndarray:
    """Halve every segment of a path, shape (m, n): a curve through its points stays closer to the lines between them then."""
    denser = np.empty((2 * len(path) - 1, path.shape[1]))
    denser[::2] = path
    denser[1::2] = 0.5 * (path[:-1] + path[1:])
    return denser


@dataclass(frozen=True, eq=False)
class TimedPath:
    """A trajectory with its use of the limits, if measured, and when the points with times are passed [s]."""

    trajectory: Trajectory
    usage: SampledUsage | None
    passing_times: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class TimedCurve:
    """A curve with a motion along it, `stretch` times slower than `scaling`."""

    trajectory: Trajectory
    scaling: TimeScaling
    stretch: float
    usage: SampledUsage

    def parameter(self, times: np.ndarray) -> np.ndarray:
        """Return where on the curve the motion is, from 0 to its length, at times of shape (m,) [s]."""
        return self.scaling.pieces.states(np.clip(times / self.stretch, 0.0, self.scaling.duration))[0]


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
    #: Where on the curve points are, and their times [s]: between two of them the motion takes no less time.
    asked: tuple[np.ndarray, np.ndarray] | None = None

    def run(self, curve: JointCurve, ends: np.ndarray) -> TimedPath:
        """Time a curve; raises `JointRangeError` if the curve or the trajectory leaves the range."""
        timed = self.timed(curve, ends)
        minimum = timed.trajectory.duration
        if self.duration is None:
            return TimedPath(timed.trajectory, timed.usage, self._passing_times_asked(timed.scaling, timed.stretch))
        if self.duration < minimum:
            # rounded up, so that a request for the duration in the message succeeds
            raise DurationError(self.duration, math.ceil(minimum * 1e3) / 1e3)
        stretch = self.duration / timed.scaling.duration
        slower = self._sampled_motion(curve, timed.scaling, stretch, ends, self.duration)
        return TimedPath(slower.trajectory(self.robot), None, self._passing_times_asked(timed.scaling, stretch))

    def _passing_times_asked(self, scaling: TimeScaling, stretch: float) -> np.ndarray | None:
        return None if self.asked is None else stretch * _passing_times(scaling, self.asked[0])

    def timed(self, curve: JointCurve, ends: np.ndarray, top_speed: float = math.inf) -> TimedCurve:
        """Return the fastest motion along a curve."""
        limits = TimeScalingLimits.fractions(self.robot, self.velocity_fraction, self.acceleration_fraction)
        if curve.straight:
            scaling = straight_time_scaling(curve, limits, top_speed)
            return self._slowed(curve, scaling, ends, SHORTEST_MOTION / scaling.duration)
        check_range(curve(_between(curve.knots)), self.robot)
        search = TimeScalingSearch(curve, limits, top_speed)
        if self.asked is not None:
            search.slow_down(*_asked_speed(*self.asked))
        scaling, early = search.find(), np.ones(1)
        for rounds_left in range(self.local_rounds, -1, -1):
            self.bounds.check(scaling.duration)
            way = _SampledMotion.along(curve, scaling, self._times(scaling, scaling.duration))
            factor = way.too_fast(limits)
            if self.asked is not None:
                passed = _passing_times(scaling, self.asked[0])
                early = np.diff(self.asked[1]) / np.diff(passed)
                factor = np.maximum(factor, early[np.clip(np.searchsorted(passed, way.times) - 1, 0, len(early) - 1)])
            if not rounds_left or np.max(factor) <= self.local_slowing:
                break
            search.slow_down(*_slower(scaling, way, factor))
            scaling = search.find()
        rest = float(np.max(early))
        if rest > LARGEST_REST:
            row = int(np.argmax(early)) + 1
            raise PlanningError(
                Sentence(
                    "on the way to point {row} the path would be passed {factor:.1f} times faster than asked; give more points "
                    "there, or none with times",
                    row=row,
                    factor=rest,
                )
            )
        least = max(rest, float(np.max(factor)) * (1.0 + STRETCH_STEP))
        return self._slowed(curve, scaling, ends, least, len(way.times))

    def _slowed(
        self, curve: JointCurve, scaling: TimeScaling, ends: np.ndarray, least: float, count: int | None = None
    ) -> TimedCurve:
        """Slow a motion by the smallest factor (at least 1 and `least`, to `STRETCH_STEP`) that brings it into the limits.

        `count`: Of the waypoints that `least` was found with: with as many, it is enough for what is between the samples.
        """
        limits = TimeScalingLimits.fractions(self.robot, self.velocity_fraction, self.acceleration_fraction)
        stretch, known = max(1.0, least), count is not None
        for _ in range(STRETCH_ROUNDS):
            if self.whole_cycles:
                stretch = math.ceil(stretch * scaling.duration / CYCLE - 1e-6) * CYCLE / scaling.duration
            way = self._sampled_motion(curve, scaling, stretch, ends, count=count)
            factor = 1.0 if known and len(way.times) == count else float(np.max(way.too_fast(limits)))
            known = False
            if factor <= 1.0:
                trajectory = way.trajectory(self.robot)
                sampled = sampled_usage(trajectory, self.robot)
                check_range(sampled.positions, self.robot)
                factor = self._excess(sampled)
                if factor <= 1.0:
                    return TimedCurve(trajectory, scaling, stretch, sampled)
            stretch *= factor * (1.0 + STRETCH_STEP)
        raise PlanningError(
            Sentence("the path cannot be slowed into the limits; {factor:.6f} times too fast remains", factor=factor)
        )

    def _excess(self, sampled: SampledUsage) -> float:
        """Return the factor by which a motion must be slowed to meet the limits at its samples."""
        velocity = float(np.max(sampled.velocity)) / (WITHIN * self.velocity_fraction)
        acceleration = float(np.max(sampled.acceleration)) / (WITHIN * self.acceleration_fraction)
        return max(velocity, math.sqrt(acceleration), math.cbrt(float(np.max(sampled.jerk))))

    def _sampled_motion(
        self,
        curve: JointCurve,
        scaling: TimeScaling,
        stretch: float,
        ends: np.ndarray,
        duration: float | None = None,
        count: int | None = None,
    ) -> _SampledMotion:
        """Return the waypoints of a time scaling, `stretch` times slower, at rest at the ends; times to the nanosecond."""
        duration = stretch * scaling.duration if duration is None else duration
        self.bounds.check(duration)
        times = self._times(scaling, duration, count)
        times = whole_nanoseconds(times)
        way = _SampledMotion.along(curve, scaling, times / stretch)
        velocities, accelerations = way.velocities / stretch, way.accelerations / stretch**2
        way.positions[0], way.positions[-1] = ends
        velocities[[0, -1]] = accelerations[[0, -1]] = 0.0
        return replace(way, times=times, velocities=velocities, accelerations=accelerations)

    def _times(self, scaling: TimeScaling, duration: float, faster_count: int | None = None) -> np.ndarray:
        """Return the times of the waypoints of a motion that is as long as `duration` [s].

        `faster_count`: Number of waypoints of a motion that is little faster: the quintics of as many are the same, only slower.
        """
        count = self.waypoints or max(MINIMUM_WAYPOINTS, math.ceil(duration / self.spacing) + 1)
        if faster_count is not None and count <= SPACING_KEPT * faster_count:
            count = faster_count
        self.bounds.check(duration, count)
        if self.waypoints is not None or not scaling.phases:
            return np.linspace(0.0, duration, count)
        # every phase begins and ends at a waypoint: the quintics between are the motion itself, however far apart they are
        ends = scaling.pieces.knots[1:] * (duration / scaling.duration)
        left = count - np.arange(len(ends), 0, -1)
        rows = np.minimum(np.round(ends / duration * (count - 1)).astype(int), left)
        times, row, begin = [], 0, 0.0
        for last, end in zip(rows.tolist(), ends.tolist()):
            steps = max(1, last - row)
            times.append(np.linspace(begin, end, steps, endpoint=False))
            row, begin = row + steps, end
        return np.concatenate([*times, [duration]])


@dataclass(frozen=True, eq=False)
class _SampledMotion:
    """Waypoints of a motion along a curve: times [s], parameter of the curve and its derivative by time, and the joints' state."""

    times: np.ndarray
    s: np.ndarray
    speed: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    accelerations: np.ndarray

    @classmethod
    def along(cls, curve: JointCurve, scaling: TimeScaling, times: np.ndarray) -> _SampledMotion:
        """Return the states at some times [s]."""
        s, speed, change = scaling.pieces.states(times)
        s = np.minimum(np.maximum(s, 0.0), curve.length)
        positions, first, second = curve.states(s)
        column = speed[:, None]
        return cls(times, s, speed, positions, first * column, second * (column * column) + first * change[:, None])

    def too_fast(self, limits: TimeScalingLimits) -> np.ndarray:
        """Return the factor by which the motion must be slowed at each waypoint, and in the quintics beside it, shape (k,)."""
        velocity = np.max(np.abs(self.velocities) / (WITHIN * limits.velocity), axis=1)
        most = WITHIN * limits.acceleration
        acceleration = np.max(np.abs(self.accelerations) / most, axis=1)
        after, before, largest = segment_jerks(self.times, self.positions, self.velocities, self.accelerations)
        jerk = np.max(largest / limits.jerk, axis=1)
        # where the jerk turns round between two waypoints, the acceleration is largest there
        part = np.divide(after, after - before, out=np.zeros_like(after), where=after * before < 0.0)
        turn = 0.5 * part * after
        inner = np.max(np.abs(self.accelerations[:-1] + turn * np.diff(self.times)[:, None]) / most, axis=1)
        inside = np.maximum(np.cbrt(jerk), np.sqrt(inner))
        beside = np.maximum(np.append(inside, 0.0), np.append(0.0, inside))
        return np.maximum(np.maximum(velocity, np.sqrt(acceleration)), beside)

    def trajectory(self, robot: RobotModel) -> Trajectory:
        """Return the motion through the waypoints."""
        return Trajectory(robot.joint_names, self.times, self.positions, self.velocities, self.accelerations)


def _slower(scaling: TimeScaling, way: _SampledMotion, factor: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest ds/dt over s that slows the present motion by the factors; inf where it is not too fast.

    It is slowed over the half-width of the smoothing on both sides, because the smoothing averages over it.
    """
    reach = math.ceil(scaling.blur / (way.times[1] - way.times[0]))
    padded = np.pad(factor, reach, constant_values=1.0)
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1).max(axis=1)
    return way.s, np.where(around > 1.0, way.speed / around, math.inf)


def _asked_times(times: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the times of the points that are kept; a pause at one of them belongs to the way to the next."""
    asked = times[rows]
    asked[-1] = times[-1]
    return asked


def _asked_speed(at: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean ds/dt between points that are passed at these times, over s; at a point the smaller one of both sides."""
    speed, margin = np.diff(at) / np.diff(times), 1e-6 * np.diff(at)
    at_points = np.minimum(np.append(speed, np.inf), np.concatenate(([np.inf], speed)))
    inside = np.column_stack((at[:-1], at[:-1] + margin, at[1:] - margin)).ravel()
    values = np.column_stack((at_points[:-1], speed, speed)).ravel()
    return np.append(inside, at[-1]), np.append(values, at_points[-1])


def _passing_times(scaling: TimeScaling, at: np.ndarray) -> np.ndarray:
    """Return when a motion passes some places of its curve, the first and last of which are its ends [s]."""
    times = np.linspace(0.0, scaling.duration, max(4 * len(at), min(PASSING_SAMPLES * len(at), MOST_PASSING_SAMPLES)))
    passed = np.interp(at, np.maximum.accumulate(scaling.pieces.states(times)[0]), times)
    passed[0], passed[-1] = 0.0, scaling.duration
    return passed


def _between(knots: np.ndarray) -> np.ndarray:
    """Return four points of each piece and the end."""
    return np.concatenate([(knots[:-1, None] + np.diff(knots)[:, None] * [0.0, 0.25, 0.5, 0.75]).ravel(), knots[-1:]])


def _inside_edge(path: np.ndarray, robot: RobotModel) -> np.ndarray:
    """Return the path with its inner points at least `EDGE` inside the range."""
    inside = path.copy()
    inside[1:-1] = np.clip(path[1:-1], np.array(robot.lower) + EDGE, np.array(robot.upper) - EDGE)
    return inside

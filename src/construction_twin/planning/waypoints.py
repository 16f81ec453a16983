"""Joint waypoints made by another program: checked, never clamped, and converted to a trajectory.

Without times they are timed by `timing.time_path`; given times are kept, and refused if they break a limit. SI, but for the units
of a file in messages.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline

from construction_twin.core.limits import OUTSIDE
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import axis_name
from construction_twin.planning.limit_usage import range_excess, sampled_usage
from construction_twin.planning.request_limits import PlanBounds
from construction_twin.planning.timing import TimedPath, time_path, timed_path
from construction_twin.robot.description import JointValues, RobotModel
from construction_twin.robot.motion_errors import PlanningError, TrajectoryError
from construction_twin.robot.trajectory import Trajectory


class WaypointsError(PlanningError):
    """Waypoints from elsewhere cannot be used: a line of the file, or point from 0, `joint`, value and limit in SI, where known."""

    def __init__(
        self, message: str, row: int | None = None, joint: str = "", value: object = None, limit: float | None = None
    ):
        self.row, self.joint, self.value, self.limit = row, joint, value, limit
        super().__init__(message)


class WaypointTimesError(WaypointsError):
    """The times of waypoints ask for more than the arm may do; through the same points it could move at another pace."""


#: Largest difference of the first waypoint from the arm's pose, which then replaces the first waypoint.
START_TOLERANCE_RAD = math.radians(0.05)
START_TOLERANCE_M = 5e-4
#: Consecutive points no further apart, and at one time where they have times, are one [rad], [m]: the last of six decimals.
DOUBLED = 1.01e-6
#: Largest velocity and acceleration that count as rest at both ends [rad/s, rad/s^2 or m/s, m/s^2].
AT_REST = 1e-6
#: An end counts as rest that was told late when no joint is faster there than its largest acceleration makes it in this time [s].
#: Since 1.1.12 MoveIt's TOTG gives each point the velocity at the end of the step that the point lies in, and its steps are a tenth
#: of the 0.1 s between its points.
LATE_STEP = 0.01
#: Rounding allowed on a velocity that was computed with the joint's largest acceleration, read from a file of decimals.
LATE_ROUNDING = 1e-3
#: Between points whose velocity is at the limit, the curve through them is up to so much faster.
BETWEEN_POINTS = 1.1
#: Rounding allowed on a fraction of a limit.
ROUNDING = 1e-6


@dataclass(frozen=True)
class Unit:
    """The unit in which the sender gave a joint's values, used in messages to the sender: ``value * factor`` is SI."""

    name: str
    factor: float

    def text(self, value: float, per: str = "") -> str:
        """Return an SI value in this unit."""
        return f"{value / self.factor:.6g} {self.name}{per}"


@dataclass(frozen=True, eq=False)
class Waypoints:
    """Waypoints in the robot's joint order, not yet checked against its limits.

    `rows`: Number of each in messages: a line of the file, or the index of the point, as `row_name` says.
    """

    rows: tuple[int, ...]
    row_name: str
    units: tuple[Unit, ...]
    positions: np.ndarray
    times: np.ndarray | None = None
    velocities: np.ndarray | None = None
    accelerations: np.ndarray | None = None

    def way_to(self, index: int) -> Sentence:
        """Return how messages call the way to a waypoint, e.g. ``between point 3 and point 4``."""
        # of a single waypoint the other one is the present pose
        if self.rows[index - 1] == self.rows[index]:
            return Sentence("on the way to {place}", place=self.label(index))
        return Sentence("between {first} and {second}", first=self.label(index - 1), second=self.label(index))

    def label(self, index: int) -> str:
        """Return a waypoint's label in messages, e.g. ``line 7``."""
        row = self.rows[index]
        return f"line {row}" if self.row_name == "line" else f"point {row}"


def from_points(
    robot: RobotModel,
    joint_names: Sequence[str],
    positions: Sequence[Sequence[float]],
    velocities: Sequence[Sequence[float]] | None = None,
    accelerations: Sequence[Sequence[float]] | None = None,
    times: Sequence[float] | None = None,
) -> Waypoints:
    """Return the waypoints in a trajectory message. A single point is a goal: the motion to it begins at the present pose.

    Values per point in the order of `joint_names` (any) [rad] or [m]; derivatives None or all empty, times None or all 0: not
    given.
    """
    if sorted(joint_names) != sorted(robot.joint_names):
        found, joints = ", ".join(joint_names), ", ".join(robot.joint_names)
        if not found:
            raise WaypointsError(f"the joints are not named; expected each of {joints} once")
        raise WaypointsError(f"the joints are {found}; expected each of {joints} once")
    order = [list(joint_names).index(name) for name in robot.joint_names]
    timed = times is not None and any(time != 0.0 for time in times)
    units = tuple(Unit("m" if linear else "rad", 1.0) for linear in robot.linear)
    arrays: dict[str, np.ndarray | None] = {}
    for name, values in (("position", positions), ("velocity", velocities), ("acceleration", accelerations)):
        given = values is not None and (name == "position" or any(len(row) for row in values))
        arrays[name] = _point_array(name, values, len(positions), len(order))[:, order] if given else None
    position_array = arrays["position"]
    assert position_array is not None  # positions are always given
    if timed and times is not None and len(times) != len(positions):
        raise WaypointsError(f"{len(times)} times for {len(positions)} points; expected as many")
    waypoints = Waypoints(
        tuple(range(len(positions))),
        "point",
        units,
        position_array,
        np.array(times, dtype=float) if timed else None,
        arrays["velocity"] if timed else None,
        arrays["acceleration"] if timed else None,
    )
    check_finite(waypoints, robot)
    return waypoints


def check_finite(waypoints: Waypoints, robot: RobotModel) -> None:
    """Check that there is a waypoint, and that every value is a finite number; WaypointsError names row, joint and value."""
    if not len(waypoints.positions):
        raise WaypointsError("0 waypoints; a motion needs at least one, its goal")
    for name in ("positions", "velocities", "accelerations"):
        values = getattr(waypoints, name)
        wrong = np.argwhere(~np.isfinite(values)) if values is not None else np.empty((0, 2), dtype=int)
        if len(wrong):
            row, joint = wrong[0]
            value, joint_name = values[row, joint], robot.joint_names[joint]
            found = f"{waypoints.label(row)}: {joint_name} has {value} among the {name}; expected a finite number"
            raise WaypointsError(found, waypoints.rows[row], joint_name, value)
    if waypoints.times is not None and not np.all(np.isfinite(waypoints.times)):
        row = int(np.argmin(np.isfinite(waypoints.times)))
        value = waypoints.times[row]
        found = f"{waypoints.label(row)}: the time is {value}; expected a finite number"
        raise WaypointsError(found, waypoints.rows[row])


def plan_waypoints(
    waypoints: Waypoints,
    present: JointValues,
    robot: RobotModel,
    speed_scale: float = 1.0,
    acceleration_scale: float | None = None,
    bounds: PlanBounds = PlanBounds(),
) -> Trajectory:
    """Check waypoints against the robot's limits and make them a trajectory that begins exactly at the present pose, shape (n,).

    With times, the motion passes every waypoint at its time, counted from the first, smooth up to the acceleration (without
    velocities a quintic spline). The first waypoint is within `START_TOLERANCE_RAD` or `_M` of `present`. A single one is the goal
    of a straight motion; its time is how long that takes.

    Raises:
        WaypointsError: Naming row, joint, value and limit.
        PlanningError: If waypoints without times cannot be timed, or the motion would be larger than `bounds`.
    """
    waypoints = _from_here(waypoints, present, robot, bounds)
    positions = waypoints.positions
    if waypoints.times is None:
        return time_path(
            positions, robot, speed_scale=speed_scale, acceleration_scale=acceleration_scale, bounds=bounds
        )
    _check_times(waypoints, waypoints.times)
    bounds.check(float(waypoints.times[-1] - waypoints.times[0]))
    moves = _moving_end(waypoints, robot)
    if moves is not None:
        # what no other times would mend comes first
        _check_given_velocities(waypoints, robot)
        raise moves
    times = waypoints.times - waypoints.times[0]
    velocities, accelerations = _derivatives(times, positions, waypoints)
    try:
        trajectory = Trajectory(robot.joint_names, times, positions, velocities, accelerations)
    except TrajectoryError as error:
        raise WaypointsError(f"the times are too close together: {str(error)}") from error
    _check_limits(trajectory, waypoints, robot)
    return trajectory


def wrapped_note(waypoints: Waypoints, present: JointValues, robot: RobotModel) -> str:
    """Return which joint turns by more than half a turn from one point to the next, as wrapped angles make it; "": none."""
    turns = np.abs(np.diff(np.vstack([present, waypoints.positions]), axis=0))
    found = np.argwhere((turns > math.pi) & ~np.array(robot.linear))
    if not len(found):
        return ""
    row, joint = found[0]
    more = f", {len(found) - 1} more" if len(found) > 1 else ""
    turn, axis = math.degrees(turns[row, joint]), axis_name(robot.joint_names[joint])
    return f"{axis} turns by {turn:.0f} deg {waypoints.way_to(int(row))}{more}: wrapped angles?"


def asked_path(waypoints: Waypoints, present: JointValues, robot: RobotModel) -> Waypoints:
    """Return waypoints with times, checked but for what times can mend: from the present pose, at 0 s."""
    path = _from_here(waypoints, present, robot, PlanBounds())
    assert path.times is not None  # only with times
    _check_times(path, path.times)
    return replace(path, times=path.times - path.times[0])


def time_asked(
    path: Waypoints,
    robot: RobotModel,
    speed_scale: float,
    acceleration_scale: float | None = None,
    bounds: PlanBounds = PlanBounds(),
) -> TimedPath:
    """Time an `asked_path` through all of its points, in no less time from any of them to the next than it says."""
    assert path.times is not None  # only with times

    def timed(duration: float | None) -> TimedPath:
        scales = speed_scale, acceleration_scale
        return timed_path(path.positions, robot, duration, *scales, bounds=bounds, times=path.times)

    fastest, requested = timed(None), float(path.times[-1])
    return fastest if fastest.trajectory.duration >= requested else timed(requested)


def _point_array(name: str, values, points: int, joints: int) -> np.ndarray:
    if len(values) != points:
        raise WaypointsError(f"{len(values)} points have a {name}, {points} a position; expected as many")
    for row, point in enumerate(values):
        if len(point) != joints:
            found = f"point {row}: {len(point)} values of {name}; expected {joints}, one for each joint"
            raise WaypointsError(found, row)
    return np.array(values, dtype=float).reshape(points, joints)


def _check_ranges(waypoints: Waypoints, robot: RobotModel) -> None:
    lower, upper = np.array(robot.lower), np.array(robot.upper)
    # the first is the present pose
    outside = np.argwhere((waypoints.positions[1:] < lower) | (waypoints.positions[1:] > upper))
    if len(outside):
        row, joint = outside[0] + (1, 0)
        name, unit, value = robot.joint_names[joint], waypoints.units[joint], waypoints.positions[row, joint]
        limit = robot.lower[joint] if value < robot.lower[joint] else robot.upper[joint]
        span = f"{unit.text(robot.lower[joint])} to {unit.text(robot.upper[joint])}"
        found = f"{waypoints.label(row)}: {name} is {unit.text(value)}; its range is {span}"
        raise WaypointsError(found, waypoints.rows[row], name, float(value), limit)


def _from_here(waypoints: Waypoints, present: JointValues, robot: RobotModel, bounds: PlanBounds) -> Waypoints:
    """Return checked waypoints that begin exactly at the present pose; a single one is the goal of a motion from there."""
    bounds.check(0.0, len(waypoints.rows))
    robot.check_range(present, OUTSIDE)
    here = np.array(present, dtype=float)
    waypoints = _without_doubles(waypoints)
    if len(waypoints.positions) == 1:
        waypoints = _goal_from(waypoints, here)
    waypoints = replace(waypoints, positions=_from_present(waypoints, here, robot))
    _check_ranges(waypoints, robot)
    return waypoints


def _without_doubles(waypoints: Waypoints) -> Waypoints:
    """Return waypoints with consecutive ones that are `DOUBLED` joined to the first, at the end to the last."""
    positions, times = waypoints.positions, waypoints.times
    kept = [0]
    for row in range(1, len(positions)):
        if np.max(np.abs(positions[row] - positions[kept[-1]])) > DOUBLED or (
            times is not None and times[row] != times[kept[-1]]
        ):
            kept.append(row)
    kept[-1] = len(positions) - 1

    def joined(values: np.ndarray | None) -> np.ndarray | None:
        return None if values is None else values[kept]

    return replace(
        waypoints,
        rows=tuple(waypoints.rows[row] for row in kept),
        positions=positions[kept],
        times=joined(times),
        velocities=joined(waypoints.velocities),
        accelerations=joined(waypoints.accelerations),
    )


def _goal_from(goal: Waypoints, present: np.ndarray) -> Waypoints:
    """Return the two ends of a motion from rest at the present pose to a single waypoint."""

    def behind_rest(values: np.ndarray | None) -> np.ndarray | None:
        return None if values is None else np.vstack([np.zeros_like(present), values])

    return replace(
        goal,
        rows=goal.rows * 2,
        positions=np.vstack([present, goal.positions]),
        times=None if goal.times is None else np.array([0.0, float(goal.times[0])]),
        velocities=behind_rest(goal.velocities),
        accelerations=behind_rest(goal.accelerations),
    )


def _from_present(waypoints: Waypoints, present: np.ndarray, robot: RobotModel) -> np.ndarray:
    """Return the positions with the first one replaced by the arm's pose."""
    away = np.abs(waypoints.positions[0] - present)
    tolerance = np.where(robot.linear, START_TOLERANCE_M, START_TOLERANCE_RAD)
    if np.any(away > tolerance):
        joint = int(np.argmax(away / tolerance))
        name, unit, value = robot.joint_names[joint], waypoints.units[joint], waypoints.positions[0, joint]
        advice = "plan a motion to it first"
        if waypoints.times is not None and waypoints.times[0] > 0.0:
            # as other controllers understand it: from wherever the arm is to the first point, in its time
            advice = f"put the arm's pose before it, at 0 s, or {advice}"
        at = f"{name} is {unit.text(value)}, but the arm is at {unit.text(present[joint])}"
        found = f"{waypoints.label(0)}: {at}; expected within {unit.text(tolerance[joint])} of it: {advice}"
        raise WaypointsError(found, waypoints.rows[0], name, float(value), float(tolerance[joint]))
    positions = waypoints.positions.copy()
    positions[0] = present
    return positions


def _check_times(waypoints: Waypoints, times: np.ndarray) -> None:
    late = np.flatnonzero(np.diff(times) <= 0.0)
    if len(late):
        row = int(late[0]) + 1
        before, time = times[row - 1 : row + 1]
        found = f"{waypoints.label(row)}: its time {time:.9g} s is not after {before:.9g} s; times must increase"
        raise WaypointsError(found, waypoints.rows[row], "", float(time))


def _moving_end(waypoints: Waypoints, robot: RobotModel) -> WaypointTimesError | None:
    """Return why the times of a motion whose ends are nearly at rest must be replaced; WaypointsError where a joint moves there."""
    ends = [0, len(waypoints.rows) - 1]

    def fault_at(row: int, joint: int, values: np.ndarray, per: str, late: bool = False) -> tuple:
        value = float(values[row, joint])
        name, found = robot.joint_names[joint], waypoints.units[joint].text(value, per)
        if late:
            found = f"{found}, no more than {LATE_STEP * 1e3:g} ms of its acceleration"
        message = f"{waypoints.label(row)}: {name} moves there ({found}); the motion must begin and end at rest"
        return message, waypoints.rows[row], name, value, 0.0

    found: WaypointTimesError | None = None
    if waypoints.velocities is not None:
        speeds = np.abs(waypoints.velocities[ends])
        late = LATE_STEP * (1.0 + LATE_ROUNDING) * np.array(robot.acceleration)
        for end, joint in np.argwhere(speeds > np.maximum(late, AT_REST))[:1].tolist():
            raise WaypointsError(*fault_at(ends[end], joint, waypoints.velocities, "/s"))
        if np.any(speeds > AT_REST):
            end, joint = np.unravel_index(int(np.argmax(speeds)), speeds.shape)
            found = WaypointTimesError(*fault_at(ends[end], int(joint), waypoints.velocities, "/s", late=True))
    if found is None and waypoints.accelerations is not None:
        pushes = np.abs(waypoints.accelerations[ends])
        if np.any(pushes > AT_REST):
            end = int(np.argmax(np.any(pushes > AT_REST, axis=1)))
            found = WaypointTimesError(
                *fault_at(ends[end], int(np.argmax(pushes[end])), waypoints.accelerations, "/s^2")
            )
    return found


def _check_given_velocities(waypoints: Waypoints, robot: RobotModel) -> None:
    """Refuse times that need more than `BETWEEN_POINTS` times a joint's velocity, at a point or on average on the way to it."""
    times = waypoints.times
    assert times is not None  # only with times
    needed = np.abs(np.diff(waypoints.positions, axis=0)) / np.diff(times)[:, None]
    needed = np.vstack([np.zeros(needed.shape[1]), needed])
    if waypoints.velocities is not None:
        needed = np.maximum(needed, np.abs(waypoints.velocities))
    limits = np.array(robot.velocity)
    for row, joint in np.argwhere(needed > BETWEEN_POINTS * limits)[:1].tolist():
        unit, value = waypoints.units[joint], float(needed[row, joint])
        name, limit = robot.joint_names[joint], float(limits[joint])
        message = _too_fast(waypoints.label(row), name, "a velocity", unit, value, limit, "/s")
        raise WaypointsError(message, waypoints.rows[row], name, value, limit)


def _too_fast(place: str, joint: str, what: str, unit: Unit, value: float, limit: float, per: str) -> str:
    found, most = unit.text(value, per), unit.text(limit, per)
    return f"{place}: {joint} has {what} of {found}; its limit is {most}, give it more time"


def _derivatives(times: np.ndarray, positions: np.ndarray, waypoints: Waypoints) -> tuple[np.ndarray, np.ndarray]:
    """Return velocities and accelerations at the waypoints, as given or from a smooth curve through them; 0 at both ends."""
    if waypoints.velocities is None:
        rest = np.zeros(positions.shape[1])
        ends = [(1, rest), (2, rest)]
        spline = make_interp_spline(times, positions, k=5, bc_type=(ends, ends))
        velocities, accelerations = spline(times, 1), spline(times, 2)
    else:
        velocities = waypoints.velocities.copy()
        given = waypoints.accelerations
        accelerations = _fitted_accelerations(times, positions, velocities) if given is None else given.copy()
    velocities[[0, -1]] = 0.0
    accelerations[[0, -1]] = 0.0
    return velocities, accelerations


def _fitted_accelerations(times: np.ndarray, positions: np.ndarray, velocities: np.ndarray) -> np.ndarray:
    """Return accelerations that fit positions and velocities: the weighted mean of those of the cubics on both sides."""
    h = np.diff(times)[:, None]
    step, v0, v1 = np.diff(positions, axis=0), velocities[:-1], velocities[1:]
    first = (6.0 * step / h - 4.0 * v0 - 2.0 * v1) / h
    last = (2.0 * v0 + 4.0 * v1 - 6.0 * step / h) / h
    accelerations = np.zeros_like(positions)
    # the shorter of the two cubics gets the larger weight
    accelerations[1:-1] = (last[:-1] * h[1:] + first[1:] * h[:-1]) / (h[:-1] + h[1:])
    return accelerations


def _check_limits(trajectory: Trajectory, waypoints: Waypoints, robot: RobotModel) -> None:
    """Check every 4 ms sample; an error names the waypoint that the motion goes to at that time."""
    sampled = sampled_usage(trajectory, robot, given_times=True)

    def place(sample: int) -> tuple[int, str]:
        time = float(sampled.times[sample])
        row = int(np.clip(np.searchsorted(trajectory.times, time), 1, len(waypoints.rows) - 1))
        return row, f"{waypoints.label(row)} (on the path to it, {time:.3f} s after the start)"

    excess = range_excess(sampled.positions, robot)
    for sample, joint in np.argwhere(excess > 0.0)[:1].tolist():
        row, where = place(sample)
        value, name = float(excess[sample, joint]), robot.joint_names[joint]
        found = f"{where}: {name} overshoots its range by {waypoints.units[joint].text(value)}; give it more time there"
        raise WaypointTimesError(found, waypoints.rows[row], name, value, 0.0)
    for name, article, per in (("velocity", "a", "/s"), ("acceleration", "an", "/s^2"), ("jerk", "a", "/s^3")):
        fractions, limits = getattr(sampled, name), getattr(robot, name)
        for sample, joint in np.argwhere(fractions > 1.0 + ROUNDING)[:1].tolist():
            row, where = place(sample)
            unit, limit = waypoints.units[joint], limits[joint]
            value = float(fractions[sample, joint] * limit)
            message = _too_fast(where, robot.joint_names[joint], f"{article} {name}", unit, value, limit, per)
            # more velocity than the joint has was not meant for this arm, whatever the times
            much = name == "velocity" and float(fractions.max()) > BETWEEN_POINTS
            kind = WaypointsError if much else WaypointTimesError
            raise kind(message, waypoints.rows[row], robot.joint_names[joint], value, limit)

"""Motions along a tool path: straight lines, arcs and blends, followed within 0.1 mm and 0.05 deg.

Poses are ``base_T_tip``, joint vectors in the order of `RobotModel.joint_names`, SI. The arm stays on the branch it
starts on: Newton steps follow the path from pose to pose, so a flip or a whole turn cannot slip in. Where the branch ends
(joint limit, singularity, out of reach, contact), the path ends with an error that says where and why; it is never
jumped over. What is promised is measured: every 4 ms sample of the trajectory against the commanded path.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from construction_twin.core.motion_errors import CollisionError, FarWaypointError, JointRangeError, PlanningError
from construction_twin.core.units import CYCLE
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.solution import InverseKinematics
from construction_twin.planning.batch_kinematics import angles_between
from construction_twin.planning.curves import JointCurve
from construction_twin.planning.ik_branch import Branch
from construction_twin.planning.limit_usage import cycle_times
from construction_twin.planning.recheck import World
from construction_twin.planning.request_limits import PlanBounds
from construction_twin.planning.timing import WAYPOINT_SPACING, TimedCurve, time_curve
from construction_twin.planning.tool_path import Piece, ToolPath, ToolWaypoint
from construction_twin.robot.trajectory import Trajectory

#: Largest deviation of a 4 ms sample from the commanded path.
DEVIATION_M = 1e-4
DEVIATION_RAD = math.radians(0.05)
#: Fraction of the deviation that the joint curve may use; the rest is for the quintics of the trajectory.
CURVE_FRACTION = 0.2
#: How often the samples of a joint curve are made denser where it deviates.
REFINEMENTS = 10
#: Spacings of the trajectory's waypoints [s] that are tried until the deviation holds.
SPACINGS = (WAYPOINT_SPACING, WAYPOINT_SPACING / 2.0, CYCLE)
#: Fraction of the tool speed that is planned with; what the quintics add to it is far less than the rest.
SPEED_FRACTION = 0.9998
#: Within so many times the arm's reach a path that leaves the reach is followed as far as it can be; what is further away
#: is refused at once (a position in millimetres, an arc that is almost a line).
FAR = 2.0
#: How often the speed is lowered where the tool is still too fast.
SPEED_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class CartesianMotion:
    """A trajectory along a tool path, and what was measured on its 4 ms samples.

    Attributes
    ----------
    trajectory : Trajectory
    path : ToolPath
    deviation_m, deviation_rad : float
        Largest distance and angle from the commanded pose.
    top_speed : float
        Largest speed of the tool [m/s].
    """

    trajectory: Trajectory
    path: ToolPath
    deviation_m: float
    deviation_rad: float
    top_speed: float


def plan_cartesian(
    start: Sequence[float],
    waypoints: Sequence[ToolWaypoint],
    inverse: InverseKinematics,
    world: World | None = None,
    speed: float | None = None,
    speed_scale: float = 1.0,
    acceleration_scale: float | None = None,
    bounds: PlanBounds = PlanBounds(),
) -> CartesianMotion:
    """Plan a motion along a tool path.

    Parameters
    ----------
    start : sequence of float, length n
        Where the arm is; the path begins at its tool pose.
    waypoints : sequence of ToolWaypoint
    inverse : InverseKinematics
        Of the arm; asked only why a path ends.
    world : CollisionWorld, optional
        Every 4 ms sample must be free of contact in it. Default: nothing is checked.
    speed : float, optional
        Of the tool along the path [m/s]: never exceeded, and reached where the joint limits allow. Default: as fast as
        the limits allow.
    speed_scale, acceleration_scale : float, optional
        As in `timing.time_path`.
    bounds : PlanBounds, optional
        Largest duration and number of waypoints. Default: any.

    Returns
    -------
    motion : CartesianMotion

    Raises
    ------
    JointRangeError
        If `start` is out of range.
    CartesianPathError
        If the path cannot be followed to its end; where, and why.
    FarWaypointError
        If a waypoint, or an arc on the way to one, is more than `FAR` times as far away as the arm reaches.
    PlanSizeError
        If the path or the motion would be larger than `bounds`.
    PlanningError
        If the path or an argument does not make sense.
    """
    if speed is not None and not 0.0 < speed < math.inf:
        raise PlanningError(f"the requested tool speed is {speed} m/s; expected a positive number")
    chain = inverse.chain
    chain.robot.check_range(start)
    q = np.array(start, dtype=float)
    bounds.check(0.0, len(waypoints))
    path = _path_in_reach(chain, chain.forward(q), waypoints)
    bounds.check_tool_path(sum(piece.end - piece.begin for piece in path.pieces if not piece.turn), speed)
    branch = Branch(path, inverse, q)
    scales = speed_scale, acceleration_scale, bounds
    parts = []
    for piece in path.pieces:
        curve = _joint_curve(branch, piece, q)
        parts.append(_Part.make(branch, piece, curve, math.inf if piece.turn or speed is None else speed, scales))
        if world is not None:
            parts[-1].check_free(branch, world)
        q = parts[-1].timed.trajectory.positions[-1]
        made = [part.timed.trajectory for part in parts]
        bounds.check(sum(part.duration for part in made), sum(len(part.times) for part in made))
    return CartesianMotion(
        _joined(made),
        path,
        max(part.deviation_m for part in parts),
        max(part.deviation_rad for part in parts),
        max(part.top_speed for part in parts),
    )


def _path_in_reach(chain: Chain, start: Pose, waypoints: Sequence[ToolWaypoint]) -> ToolPath:
    """Return the path, unless it leads to places so far away that following it step by step would be in vain."""

    def demand(number: int, what: str, points: np.ndarray) -> None:
        with np.errstate(over="ignore"):
            distance = float(np.max(np.linalg.norm(points - chain.shoulder, axis=1)))
        if distance > FAR * chain.reach:  # not a number: refused by the path itself
            raise FarWaypointError(number, what, distance, chain.reach)

    for number, waypoint in enumerate(waypoints):
        demand(number, "its position", waypoint.pose.position[None])
        if waypoint.via is not None:
            demand(number, "the via point of its arc", waypoint.via[None])
    path = ToolPath(start, waypoints)
    for number, points in path.arcs():
        demand(number, "the arc that leads there", points)
    return path


@dataclass(frozen=True, eq=False)
class _Part:
    """The motion from one stop to the next, with its 4 ms samples."""

    piece: Piece
    timed: TimedCurve
    samples: np.ndarray
    deviation_m: float
    deviation_rad: float
    top_speed: float

    @classmethod
    def make(cls, branch: Branch, piece: Piece, curve: JointCurve, speed: float, scales: tuple) -> _Part:
        """Time a piece, with waypoints dense enough to keep it on the path and a speed low enough to keep the tool's."""
        top_speed = SPEED_FRACTION * speed
        for spacing in SPACINGS:
            for _ in range(SPEED_ROUNDS):
                part = cls._measured(branch, piece, _time(branch, piece, curve, top_speed, scales, spacing))
                if part.top_speed <= speed:
                    break
                # the joint curve is a little longer or shorter than the path it follows within the deviation
                top_speed *= SPEED_FRACTION * speed / part.top_speed
            if part.deviation_m <= DEVIATION_M and part.deviation_rad <= DEVIATION_RAD and part.top_speed <= speed:
                return part
        found = f"{part.deviation_m * 1e3:.4f} mm, {math.degrees(part.deviation_rad):.4f} deg, {part.top_speed:.4f} m/s"
        raise branch.end("deviation", piece.begin, f"the motion deviates by {found}; choose a lower speed")

    @classmethod
    def _measured(cls, branch: Branch, piece: Piece, timed: TimedCurve) -> _Part:
        times = cycle_times(timed.trajectory)
        q = timed.trajectory.sample_many(times)[0]
        positions, rotations = branch.rows.poses(q)
        goals, goal_rotations = branch.path.poses(piece.begin + timed.parameter(times))
        away = float(np.max(np.linalg.norm(goals - positions, axis=1)))
        turned = float(np.max(angles_between(rotations, goal_rotations)))
        speeds = np.linalg.norm(np.diff(positions, axis=0), axis=1) / CYCLE
        return cls(piece, timed, q, away, turned, float(np.max(speeds)))

    def check_free(self, branch: Branch, world: World) -> None:
        """Check every sample for contact."""
        row = world.all_free(self.samples)
        if row is None:
            return
        s = self.piece.begin + float(self.timed.parameter(np.array([max(row - 1, 0) * CYCLE]))[0])
        between = world.contact(self.samples[row]).between
        cause = CollisionError(between, f"{s:.4f} m along the path")
        raise branch.end("collision", s, f"{between[0]} would touch {between[1]}; move the path or the object", cause)


def _joint_curve(branch: Branch, piece: Piece, q: np.ndarray) -> JointCurve:
    """Return the joint curve over the piece's length that keeps to it within `CURVE_FRACTION` of the deviation."""
    s = np.concatenate(
        [np.linspace(a, b, cells, endpoint=False) for a, b, cells in zip(piece.knots, piece.knots[1:], piece.cells)]
        + [np.array([piece.end])]
    )
    rows = branch.walk(q, s)
    for _ in range(REFINEMENTS):
        spline = CubicSpline(s - piece.begin, rows)
        middle = 0.5 * (s[:-1] + s[1:])
        guess = spline(middle - piece.begin)
        targets = branch.path.poses(middle)
        error = branch.rows.errors(guess, *targets)
        away, turned = np.linalg.norm(error[:, :3], axis=1), np.linalg.norm(error[:, 3:], axis=1)
        between = branch.rows.newton(guess, *targets, steps=2)
        branch.check(between, rows[:-1], s[:-1], middle)
        deviates = (away > CURVE_FRACTION * DEVIATION_M) | (turned > CURVE_FRACTION * DEVIATION_RAD)
        if not np.any(deviates):
            return JointCurve(spline)
        order = np.argsort(np.concatenate((s, middle[deviates])), kind="stable")
        s = np.concatenate((s, middle[deviates]))[order]
        rows = np.concatenate((rows, between[deviates]))[order]
    at = float(middle[np.argmax(deviates)])
    found = f"the joints cannot follow within {DEVIATION_M * 1e3:.1f} mm there"
    raise branch.end("deviation", at, f"{found}; the path bends too sharply, give the corner a larger blend")


def _time(branch: Branch, piece: Piece, curve: JointCurve, speed: float, request: tuple, spacing: float) -> TimedCurve:
    *scales, bounds = request
    robot = branch.chain.robot
    try:
        return time_curve(curve, robot, *scales, top_speed=speed, spacing=spacing, bounds=bounds)
    except JointRangeError as error:
        # between samples that are all inside the range, but touch its edge
        raise branch.end("joint limit", piece.begin, f"{error}; move the path away from the limit", error) from error


def _joined(parts: Sequence[Trajectory]) -> Trajectory:
    """Put trajectories that start and end at rest one behind the other."""
    times, positions, velocities, accelerations = [], [], [], []
    begin = 0.0
    for number, part in enumerate(parts):
        rows = slice(1 if number else 0, None)
        times.append(begin + part.times[rows])
        positions.append(part.positions[rows])
        velocities.append(part.velocities[rows])
        accelerations.append(part.accelerations[rows])
        begin += part.duration
    arrays = (np.concatenate(values) for values in (times, positions, velocities, accelerations))
    return Trajectory(parts[0].joint_names, *arrays)

"""Motions along a tool path: straight lines, arcs and blends, followed within 0.1 mm and 0.05 deg.

The arm stays on the branch of the inverse kinematics that it starts on: Newton steps follow the path, so there is no flip and no
extra whole turn. Where the branch ends planning fails and says where and why. Every 4 ms sample is measured against the path.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.core.units import CYCLE
from construction_twin.kinematics.batch_kinematics import angles_between
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.solution import InverseKinematics
from construction_twin.planning.curves import JointCurve
from construction_twin.planning.ik_branch import BranchFollower
from construction_twin.planning.limit_usage import cycle_times
from construction_twin.planning.recheck import CollisionError
from construction_twin.planning.request_limits import PlanBounds
from construction_twin.planning.timing import WAYPOINT_SPACING, TimedCurve, time_curve
from construction_twin.planning.tool_path import Piece, ToolPath, ToolWaypoint
from construction_twin.planning.work_plan import joined
from construction_twin.robot.description import JointValues
from construction_twin.robot.motion_errors import JointRangeError, PlanningError
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.collision_world import CollisionWorld


class FarWaypointError(PlanningError):
    """A tool path leads so far beyond the arm's reach, both from its first turning joint [m], that it must be a mistake."""

    def __init__(self, waypoint: int, what: str, distance: float, reach: float):
        self.distance, self.reach = distance, reach
        away = f"{distance * 1e3:.0f}" if distance < 1e6 else f"{distance * 1e3:.6g}"
        super().__init__(
            f"waypoint {waypoint}: {what} is {away} mm from the arm, which reaches {reach * 1e3:.0f} mm; expected a place "
            "near the arm, in the frame of the request: are unit and frame right?"
        )


#: Largest deviation of a 4 ms sample from the commanded path.
DEVIATION_M = 1e-4
DEVIATION_RAD = math.radians(0.05)
#: Fraction of the deviation that the joint curve may use; the quintics of the trajectory may use the rest.
CURVE_FRACTION = 0.2
#: How often samples are added to a joint curve where it deviates.
REFINEMENTS = 10
#: Spacings of the trajectory's waypoints [s] that are tried until the deviation holds.
SPACINGS = (WAYPOINT_SPACING, WAYPOINT_SPACING / 2.0, CYCLE)
#: Fraction of the tool speed that is planned with; the quintics exceed it by far less than the remainder.
SPEED_FRACTION = 0.9998
#: A path that stays within this many times the arm's reach is followed as far as possible. A path that leads further away is
#: refused at once: typically a position in millimetres, or an arc that is almost a line.
FAR = 2.0
#: How often the speed is lowered if the tool is still too fast.
SPEED_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class CartesianMotion:
    """A trajectory along a tool path; on its 4 ms samples the largest deviation from the commanded pose, and speed [m/s]."""

    trajectory: Trajectory
    path: ToolPath
    deviation_m: float
    deviation_rad: float
    top_speed: float


def plan_cartesian(
    start: JointValues,
    waypoints: Sequence[ToolWaypoint],
    inverse: InverseKinematics,
    world: CollisionWorld | None = None,
    speed: float | None = None,
    speed_scale: float = 1.0,
    acceleration_scale: float | None = None,
    bounds: PlanBounds = PlanBounds(),
) -> CartesianMotion:
    """Plan a motion along a tool path that begins at the tool's pose.

    `world`: The motion must be free of contact in it, between its samples too; None: nothing is checked. `speed` of the tool along
    the path [m/s]: never exceeded, and reached where the joint limits allow; None: as fast as they allow.
    """
    if speed is not None and not 0.0 < speed < math.inf:
        found = Quantity(speed, "m/s")
        raise PlanningError(Sentence("the requested tool speed is {speed}; expected a positive number", speed=found))
    chain = inverse.chain
    chain.robot.check_range(start)
    q = np.array(start, dtype=float)
    bounds.check(0.0, len(waypoints))
    path = _path_in_reach(chain, chain.forward(q), waypoints)
    bounds.check_tool_path(sum(piece.end - piece.begin for piece in path.pieces if not piece.turn), speed)
    branch = BranchFollower(path, inverse, q)
    asked = {"speed_scale": speed_scale, "acceleration_scale": acceleration_scale, "bounds": bounds}
    parts = []
    for piece in path.pieces:
        curve = _joint_curve(branch, piece, q)
        parts.append(_Part.timed_from(branch, piece, curve, math.inf if piece.turn or speed is None else speed, asked))
        if world is not None:
            parts[-1].check_free(branch, world)
        q = parts[-1].timed.trajectory.positions[-1]
        trajectories = [part.timed.trajectory for part in parts]
        bounds.check(sum(part.duration for part in trajectories), sum(len(part.times) for part in trajectories))
    return CartesianMotion(
        joined(trajectories)[0],
        path,
        max(part.deviation_m for part in parts),
        max(part.deviation_rad for part in parts),
        max(part.top_speed for part in parts),
    )


def _path_in_reach(chain: Chain, start: Pose, waypoints: Sequence[ToolWaypoint]) -> ToolPath:
    """Return the path; refuse one that leads much further than the arm reaches, without following it step by step."""

    def require_in_reach(number: int, what: str, points: np.ndarray) -> None:
        with np.errstate(over="ignore"):
            distance = float(np.max(np.linalg.norm(points - chain.shoulder, axis=1)))
        if distance > FAR * chain.reach:  # not a number: refused by the path itself
            raise FarWaypointError(number, what, distance, chain.reach)

    for number, waypoint in enumerate(waypoints):
        require_in_reach(number, Sentence("its position"), waypoint.pose.position[None])
        if waypoint.via is not None:
            require_in_reach(number, Sentence("the via point of its arc"), waypoint.via[None])
    path = ToolPath(start, waypoints)
    for number, points in path.arcs():
        require_in_reach(number, "the arc that leads there", points)
    return path


@dataclass(frozen=True, eq=False)
class _Part:
    """The motion from one stop to the next, with its 4 ms samples and the measurements on them."""

    piece: Piece
    timed: TimedCurve
    samples: np.ndarray
    deviation_m: float
    deviation_rad: float
    top_speed: float

    @classmethod
    def timed_from(
        cls, branch: BranchFollower, piece: Piece, curve: JointCurve, speed: float, asked: dict[str, Any]
    ) -> _Part:
        """Time a piece as asked, with waypoints dense enough for the deviation and slow enough for the tool's speed."""
        top_speed = SPEED_FRACTION * speed
        for spacing in SPACINGS:
            for _ in range(SPEED_ROUNDS):
                part = cls._measured(branch, piece, _time(branch, piece, curve, top_speed, spacing, asked))
                if part.top_speed <= speed:
                    break
                # within the deviation, the tool's path along the joint curve may be slightly longer than the commanded one
                top_speed *= SPEED_FRACTION * speed / part.top_speed
            if part.deviation_m <= DEVIATION_M and part.deviation_rad <= DEVIATION_RAD and part.top_speed <= speed:
                return part
        found = Sentence(
            "the motion deviates by {away:.4}, {turned:.4}, {speed} mm/s; choose a lower speed",
            away=Quantity(part.deviation_m, "m"),
            turned=Quantity(part.deviation_rad, "rad"),
            speed=f"{part.top_speed * 1e3:.1f}",
        )
        raise branch.end_error("deviation", piece.begin, found)

    @classmethod
    def _measured(cls, branch: BranchFollower, piece: Piece, timed: TimedCurve) -> _Part:
        times = cycle_times(timed.trajectory)
        q = timed.trajectory.sample_many(times)[0]
        positions, rotations = branch.batch.poses(q)
        goals, goal_rotations = branch.path.poses(piece.begin + timed.parameter(times))
        away = float(np.max(np.linalg.norm(goals - positions, axis=1)))
        turned = float(np.max(angles_between(rotations, goal_rotations)))
        speeds = np.linalg.norm(np.diff(positions, axis=0), axis=1) / CYCLE
        return cls(piece, timed, q, away, turned, float(np.max(speeds)))

    def check_free(self, branch: BranchFollower, world: CollisionWorld) -> None:
        """Check every sample for contact, and the motion between them."""
        found = world.first_contact(self.samples)
        if found is None:
            return
        place, contact = found
        s = self.piece.begin + float(self.timed.parameter(np.array([max(math.ceil(place) - 1, 0) * CYCLE]))[0])
        between = contact.between
        cause = CollisionError(between, Sentence("{distance:.1} along the path", distance=Quantity(s, "m")))
        what = Sentence("{first} would touch {second}; move path or object", first=between[0], second=between[1])
        raise branch.end_error("collision", s, what, cause)


def _joint_curve(branch: BranchFollower, piece: Piece, q: np.ndarray) -> JointCurve:
    """Return the joint curve over the piece's length that follows it within `CURVE_FRACTION` of the deviation."""
    s = np.concatenate(
        [np.linspace(a, b, cells, endpoint=False) for a, b, cells in zip(piece.knots, piece.knots[1:], piece.cells)]
        + [np.array([piece.end])]
    )
    joints = branch.follow(q, s)
    for _ in range(REFINEMENTS):
        spline = CubicSpline(s - piece.begin, joints)
        middle = 0.5 * (s[:-1] + s[1:])
        guess = spline(middle - piece.begin)
        targets = branch.path.poses(middle)
        error = branch.batch.errors(guess, *targets)
        away, turned = np.linalg.norm(error[:, :3], axis=1), np.linalg.norm(error[:, 3:], axis=1)
        between = branch.batch.newton(guess, *targets, steps=2, pace=branch.pace)
        branch.check(between, joints[:-1], s[:-1], middle)
        deviates = (away > CURVE_FRACTION * DEVIATION_M) | (turned > CURVE_FRACTION * DEVIATION_RAD)
        if not np.any(deviates):
            return JointCurve(spline)
        order = np.argsort(np.concatenate((s, middle[deviates])), kind="stable")
        s = np.concatenate((s, middle[deviates]))[order]
        joints = np.concatenate((joints, between[deviates]))[order]
    most = Quantity(DEVIATION_M, "m")
    what = Sentence("the joints cannot follow within {most:.1} there; give the corner a larger blend", most=most)
    raise branch.end_error("deviation", float(middle[np.argmax(deviates)]), what)


def _time(
    branch: BranchFollower, piece: Piece, curve: JointCurve, speed: float, spacing: float, asked: dict[str, Any]
) -> TimedCurve:
    try:
        return time_curve(curve, branch.chain.robot, top_speed=speed, spacing=spacing, **asked)
    except JointRangeError as error:
        # all samples of the curve are in range, but the motion between two of them leaves it
        what = Sentence("{problem}; move the path away from the limit", problem=str(error))
        raise branch.end_error("joint limit", piece.begin, what, error) from error

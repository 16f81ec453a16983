"""The path that a tool is told to follow: straight lines and circular arcs through waypoints, with stops or blends at the corners.

Poses are ``base_T_tip``; lengths in metres along the path. Along a segment the orientation turns at a constant rate about
one axis (slerp). In a blend, position and orientation leave the incoming segment and join the outgoing one with continuous first
and second derivatives with respect to the path's length. Knows no arm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from construction_twin.core.motion_errors import PlanningError
from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.kinematics.chain import Pose
from construction_twin.planning.path_segments import Blend, Leg, Segment

#: Path length assigned to a turn on the spot [m/rad].
TURN_LENGTH = 0.1
#: Positions [m] and orientations [rad] closer than this are the same.
SAME_PLACE = 1e-7
#: Number of points of an arc that are tested for reach.
_ARC_POINTS = 17
#: If the directions before and after a waypoint differ by less, the tool does not stop there.
SMOOTH = 1e-6


@dataclass(frozen=True, eq=False)
class ToolWaypoint:
    """Where one segment of a tool path ends.

    Attributes:
        pose: Of the tip in the robot's base.
        via: Shape (3,). Any other point of the circular arc that leads here [m]; None: a straight line.
        blend: Radius of the rounded corner [m]: how far before and after the waypoint, along the path, the tool leaves the
            segments. 0: the tool stops here, unless the path goes on in the same direction. The last one always stops.
    """

    pose: Pose
    via: np.ndarray | None = None
    blend: float = 0.0


@dataclass(frozen=True)
class Piece:
    """The part of a tool path from one stop to the next.

    Attributes:
        begin, end: Along the path [m].
        turn: It is a turn on the spot, to which the tool's speed does not apply.
        knots: Where the segments meet, `begin` and `end` included.
        cells: Number of samples of each segment to start with.
    """

    begin: float
    end: float
    turn: bool
    knots: tuple[float, ...]
    cells: tuple[int, ...]


@dataclass(frozen=True)
class _Leg:
    """A whole segment, and the index of the waypoint that it leads to."""

    waypoint: int
    segment: Leg


@dataclass(frozen=True)
class _Mark:
    """The index of a waypoint, and of the segment that ends there (the blend, if there is one)."""

    waypoint: int
    segment: int


@dataclass(frozen=True)
class _Trimmed:
    """Segments with their blends, the indices of those after which the tool stops, and where the waypoints are."""

    segments: list[Segment]
    stops: list[int]
    marks: list[_Mark]


class ToolPath:
    """A checked tool path, of `length` [m] with turns on the spot counted by `TURN_LENGTH`.

    Raises:
        PlanningError: If no waypoint differs from the start, an arc has no circle, or a blend does not fit; names the waypoint.
    """

    def __init__(self, start: Pose, waypoints: Sequence[ToolWaypoint]):
        legs = _legs(start, waypoints)
        if not legs:
            raise PlanningError(Sentence("the tool is already there: no waypoint differs from the start"))
        trimmed = _trimmed(legs, waypoints)
        self._segments, self._marks = trimmed.segments, trimmed.marks
        self._ends = np.cumsum([segment.length for segment in self._segments])
        self._begins = np.concatenate(([0.0], self._ends[:-1]))
        self.length = float(self._ends[-1])
        self._waypoint_ends = [self._ends[mark.segment] for mark in self._marks]
        bounds = [0, *(index + 1 for index in trimmed.stops)]
        self.pieces = tuple(self._piece(first, last) for first, last in pairwise(bounds))

    def poses(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the commanded poses along the path, shape (m, 3) and (m, 3, 3), at places of shape (m,) [m]."""
        s = np.asarray(s, dtype=float)
        positions, rotations = np.empty((len(s), 3)), np.empty((len(s), 3, 3))
        numbers = np.minimum(np.searchsorted(self._ends, s), len(self._segments) - 1)
        for number in np.unique(numbers):
            inside = numbers == number
            at = np.clip(s[inside] - self._begins[number], 0.0, self._segments[number].length)
            positions[inside], turns = self._segments[number].at(at)
            rotations[inside] = turns.as_matrix()
        return positions, rotations

    def pose(self, s: float) -> Pose:
        """Return the commanded pose at one place [m]."""
        positions, rotations = self.poses(np.array([s]))
        return Pose(positions[0], rotations[0])

    def arcs(self) -> list[tuple[int, np.ndarray]]:
        """Return a few points of each arc, shape (m, 3) [m], with the number of the waypoint that the tool is going to."""
        places = (
            (begin, segment)
            for begin, segment in zip(self._begins, self._segments)
            if isinstance(segment, Leg) and segment.bends
        )
        along = np.linspace(0.0, 1.0, _ARC_POINTS)
        return [
            (self.waypoint_at(begin + 0.5 * segment.length), segment.at(segment.length * along)[0])
            for begin, segment in places
        ]

    def waypoint_at(self, s: float) -> int:
        """Return the number of the waypoint, from 0, that the tool is going to at `s` [m]."""
        return self._marks[self._next(s)].waypoint

    def waypoint_end(self, s: float) -> float:
        """Return the position along the path of the waypoint that the tool is going to at `s` [m]; the end of its blend, if any."""
        return float(self._waypoint_ends[self._next(s)])

    def _next(self, s: float) -> int:
        return min(int(np.searchsorted(self._waypoint_ends, s)), len(self._marks) - 1)

    def _piece(self, first: int, last: int) -> Piece:
        segments = self._segments[first:last]
        knots = (float(self._begins[first]), *(float(end) for end in self._ends[first:last]))
        cells = tuple(segment.cells for segment in segments)
        return Piece(knots[0], knots[-1], isinstance(segments[0], Leg) and segments[0].turns, knots, cells)


def _legs(start: Pose, waypoints: Sequence[ToolWaypoint]) -> list[_Leg]:
    """Return the segments before blending; a waypoint at the pose before it has none."""
    legs: list[_Leg] = []
    at = start
    for number, waypoint in enumerate(waypoints):
        if not (0.0 <= waypoint.blend < math.inf):
            blend = Quantity(waypoint.blend, "m")
            raise PlanningError(f"waypoint {number}: the blend is {blend}; expected 0 or a positive number")
        leg = _leg(number, at, waypoint)
        if leg is not None:
            legs.append(_Leg(number, leg))
            at = waypoint.pose
    return legs


def _leg(number: int, start: Pose, waypoint: ToolWaypoint) -> Leg | None:
    goal = waypoint.pose
    for values in (goal.position, goal.rotation, () if waypoint.via is None else waypoint.via):
        if not np.all(np.isfinite(values)):
            raise PlanningError(f"waypoint {number}: {np.asarray(values).tolist()} are not finite numbers")
    first = Rotation.from_matrix(start.rotation)
    turn = (Rotation.from_matrix(goal.rotation) * first.inv()).as_rotvec()
    if waypoint.via is not None:
        arc = Leg.arc(start.position, waypoint.via, goal.position, first, turn)
        if arc is None:
            found = "start, via point and end of its arc are on one line or the same"
            raise PlanningError(f"waypoint {number}: {found}; expected three points of a circle, or two arcs")
        return arc
    if np.linalg.norm(goal.position - start.position) > SAME_PLACE:
        return Leg.line(start.position, goal.position, first, turn)
    angle = float(np.linalg.norm(turn))
    return Leg.on_the_spot(goal.position, first, turn, TURN_LENGTH * angle) if angle > SAME_PLACE else None


def _trimmed(legs: list[_Leg], waypoints: Sequence[ToolWaypoint]) -> _Trimmed:
    """Cut the legs where they are blended, and insert the blends."""
    cuts = [0.0] * (len(legs) + 1)
    for index in range(len(legs) - 1):
        number, leg = legs[index].waypoint, legs[index].segment
        cuts[index + 1] = waypoints[number].blend
        if cuts[index + 1] and (leg.turns or legs[index + 1].segment.turns):
            raise PlanningError(f"waypoint {number}: a turn on the spot has no corner to blend; expected blend 0")
    for index, one in enumerate(legs):
        number, leg = one.waypoint, one.segment
        if cuts[index] + cuts[index + 1] > leg.length * (1.0 + 1e-9):
            length, needed = Quantity(leg.length, "m"), Quantity(cuts[index] + cuts[index + 1], "m")
            found = f"the segment to waypoint {number} is {length} long; its blends need {needed}, choose smaller ones"
            raise PlanningError(found)
    segments: list[Segment] = []
    stops: list[int] = []
    marks: list[_Mark] = []
    for index, one in enumerate(legs):
        number, leg = one.waypoint, one.segment
        trimmed = leg.part(cuts[index], leg.length - cuts[index + 1])
        if trimmed is not None:
            segments.append(trimmed)
        last = index == len(legs) - 1
        if cuts[index + 1]:
            blend = Blend.between(leg, legs[index + 1].segment, cuts[index + 1])
            if blend is None:
                raise PlanningError(f"waypoint {number}: the path turns back there; expected blend 0")
            segments.append(blend)
        marks.append(_Mark(number, len(segments) - 1))
        if last or (not cuts[index + 1] and not _goes_on(leg, legs[index + 1].segment)):
            stops.append(len(segments) - 1)
    return _Trimmed(segments, stops, marks)


def _goes_on(leg: Leg, following: Leg) -> bool:
    if leg.turns or following.turns:
        return False
    before, after = leg.direction(leg.length), following.direction(0.0)
    return all(float(np.max(np.abs(a - b))) < SMOOTH for a, b in zip(before, after))

"""The commanded path of a tool: lines and circular arcs through waypoints, with stops or blends at the corners.

Poses are ``base_T_tip``. Along a segment the orientation turns at a constant rate about one axis (slerp); a blend is continuous up
to the second derivative. Every segment gives a pose by its own length, from 0 [m]; its `direction` is the derivative: a unit
vector, and the angular velocity per metre in the base's directions.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import BPoly, CubicHermiteSpline
from scipy.spatial.transform import Rotation

from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.motion_errors import PlanningError

#: Path length assigned to a turn on the spot [m/rad].
TURN_LENGTH = 0.1
#: Positions [m] and orientations [rad] closer than this are the same.
SAME_PLACE = 1e-7
#: Largest spacing of the first samples of a segment, in metres and radians.
_CELL_M = 0.025
_CELL_RAD = 0.1
_FEWEST_CELLS = 4
_BLEND_CELLS = 10
#: Nodes of the integral for a blend's length, and the smallest speed in it; below that the path turns back.
_NODES = 257
_TURNING_BACK = 0.05
#: Sine of the angle between two chords below which three points have no circle.
_ON_A_LINE = 1e-6
#: Number of points of an arc that are tested for reach.
_ARC_POINTS = 17
#: If the directions before and after a waypoint differ by less, the tool does not stop there.
SMOOTH = 1e-6


@dataclass(frozen=True, eq=False)
class ToolWaypoint:
    """Where one segment of a tool path ends: a pose of the tip in the robot's base.

    Attributes:
        via: Shape (3,). Another point of the circular arc that leads here [m]; None: a straight line.
        blend: Radius of the rounded corner along the path [m]; 0: the tool stops here, unless the path goes on in the same
            direction.
    """

    pose: Pose
    via: np.ndarray | None = None
    blend: float = 0.0


@dataclass(frozen=True)
class Piece:
    """The part of a tool path from one stop to the next, `begin` to `end` [m].

    Attributes:
        turn: It is a turn on the spot, to which the tool's speed does not apply.
        knots: Where the segments meet, `begin` and `end` included.
        cells: Number of samples of each segment to start with.
    """

    begin: float
    end: float
    turn: bool
    knots: tuple[float, ...]
    cells: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Leg:
    """A straight line, an arc or a turn on the spot, with a constant angular velocity: rotation ``exp(spin s) first``.

    Attributes:
        tangent: Unit vector along it at `origin`; 0: a turn on the spot, parametrised by its length.
        bend: Its curvature there, towards the centre [1/m]; 0: straight.
        spin: [rad/m]
    """

    origin: np.ndarray
    tangent: np.ndarray
    bend: np.ndarray
    first: Rotation
    spin: np.ndarray
    length: float

    @classmethod
    def line(cls, start: np.ndarray, goal: np.ndarray, first: Rotation, turn: np.ndarray) -> Leg:
        """Return the line between two different points; `turn` is the rotation vector of the whole line."""
        length = float(np.linalg.norm(np.asarray(goal) - start))
        tangent = (np.asarray(goal) - start) / length
        return cls(np.array(start), tangent, np.zeros(3), first, turn / length, length)

    @classmethod
    def on_the_spot(cls, position: np.ndarray, first: Rotation, turn: np.ndarray, length: float) -> Leg:
        """Return the turn by a rotation vector."""
        return cls(np.array(position), np.zeros(3), np.zeros(3), first, turn / length, length)

    @classmethod
    def arc(cls, start: np.ndarray, via: np.ndarray, goal: np.ndarray, first: Rotation, turn: np.ndarray) -> Leg | None:
        """Return the arc from `start` through `via` to `goal`; None if no circle passes through the three."""
        to_via, to_goal = np.asarray(via) - start, np.asarray(goal) - start
        normal = np.cross(to_via, to_goal)
        area = float(np.linalg.norm(normal))
        sizes = float(np.linalg.norm(to_via)) * float(np.linalg.norm(to_goal))
        if not area > _ON_A_LINE * sizes or np.linalg.norm(to_goal - to_via) == 0.0:
            return None
        centre = np.cross(to_via @ to_via * to_goal - to_goal @ to_goal * to_via, normal) / (2.0 * area**2)
        radius = float(np.linalg.norm(centre))
        tangent = np.cross(centre / radius, normal / area)
        angle = math.atan2((to_goal - centre) @ tangent, -(to_goal - centre) @ centre / radius) % (2.0 * math.pi)
        length = radius * angle
        return cls(np.array(start), tangent, centre / radius**2, first, turn / length, length)

    @property
    def turns(self) -> bool:
        """Whether it is a turn on the spot."""
        return not self.tangent.any()

    @property
    def bends(self) -> bool:
        """Whether it is an arc."""
        return bool(self.bend.any())

    @property
    def cells(self) -> int:
        """Number of samples to start with."""
        angle = float(np.linalg.norm(self.bend) + np.linalg.norm(self.spin)) * self.length
        return _cells(0.0 if self.turns else self.length, angle)

    def at(self, s: np.ndarray) -> tuple[np.ndarray, Rotation]:
        """Return positions, shape (m, 3), and rotations at places of shape (m,)."""
        curvature, s = float(np.linalg.norm(self.bend)), s[:, None]
        if curvature:
            ahead, aside = np.sin(curvature * s) / curvature, (1.0 - np.cos(curvature * s)) / curvature**2
            positions = self.origin + ahead * self.tangent + aside * self.bend
        else:
            positions = self.origin + s * self.tangent
        return positions, Rotation.from_rotvec(s * self.spin) * self.first

    def direction(self, s: float) -> tuple[np.ndarray, np.ndarray]:
        """Return unit tangent and angular velocity per metre, shape (3,) each."""
        curvature = float(np.linalg.norm(self.bend))
        if not curvature:
            return self.tangent, self.spin
        angle = curvature * s
        return math.cos(angle) * self.tangent + math.sin(angle) / curvature * self.bend, self.spin

    def curvature(self, s: float) -> np.ndarray:
        """Return the second derivative of the position over length, shape (3,) [1/m]."""
        curvature = float(np.linalg.norm(self.bend))
        return math.cos(curvature * s) * self.bend - curvature * math.sin(curvature * s) * self.tangent

    def part(self, begin: float, end: float) -> Leg | None:
        """Return the part from `begin` to `end`; None if its length is zero."""
        if end - begin <= 1e-9 * self.length:
            return None
        origin, first = self.at(np.array([begin]))
        return Leg(origin[0], self.direction(begin)[0], self.curvature(begin), first[0], self.spin, end - begin)


@dataclass(frozen=True, eq=False)
class Blend:
    """A rounded corner: a quintic for position and rotation vector (against `corner`) over a parameter 0 to 1, which
    `parameter` gives over length. It meets both sides in value, first and second derivative over length.
    """

    curve: BPoly
    parameter: CubicHermiteSpline
    corner: Rotation
    length: float

    @classmethod
    def between(cls, before: Leg, after: Leg, cut: float) -> Blend | None:
        """Blend a corner over the last and first `cut` metres of both segments; None where the path turns back."""
        begin = before.length - cut
        positions, _ = before.at(np.array([begin]))
        goals, _ = after.at(np.array([cut]))
        scale = 2.0 * cut  # on a straight path, the parameter is then the fraction of the length
        ends = []
        for position, segment, s, sign in ((positions[0], before, begin, -1.0), (goals[0], after, cut, 1.0)):
            tangent, spin = segment.direction(s)
            value = np.concatenate((position, sign * cut * spin))
            slope = scale * np.concatenate((tangent, spin))
            curvature = scale**2 * np.concatenate((segment.curvature(s), np.zeros(3)))
            ends.append([value, slope, curvature])
        curve = BPoly.from_derivatives([0.0, 1.0], ends)
        u = np.linspace(0.0, 1.0, _NODES)
        speed = np.linalg.norm(curve(u, 1)[:, :3], axis=1)
        if np.min(speed) < _TURNING_BACK * scale:
            return None
        corner = after.at(np.zeros(1))[1][0]
        lengths = np.concatenate(([0.0], np.cumsum(_cell_lengths(curve, u))))
        return cls(curve, CubicHermiteSpline(lengths, u, 1.0 / speed), corner, float(lengths[-1]))

    @property
    def cells(self) -> int:
        """Number of samples to start with."""
        turn = float(np.linalg.norm(self.curve(1.0)[3:] - self.curve(0.0)[3:]))
        return max(_BLEND_CELLS, _cells(self.length, turn))

    def at(self, s: np.ndarray) -> tuple[np.ndarray, Rotation]:
        """Return positions, shape (m, 3), and rotations at places of shape (m,)."""
        values = self.curve(np.clip(self.parameter(s), 0.0, 1.0))
        return values[:, :3], Rotation.from_rotvec(values[:, 3:]) * self.corner


Segment = Leg | Blend


def _cell_lengths(curve: BPoly, u: np.ndarray) -> np.ndarray:
    """Return the length of the curve's positions between neighbouring parameters (Gauss, five points)."""
    nodes, weights = np.polynomial.legendre.leggauss(5)
    half = 0.5 * np.diff(u)
    at = 0.5 * (u[:-1] + u[1:])[:, None] + half[:, None] * nodes
    speed = np.linalg.norm(curve(at.ravel(), 1)[:, :3], axis=1).reshape(at.shape)
    return half * (speed @ weights)


def _cells(length: float, angle: float) -> int:
    return max(_FEWEST_CELLS, math.ceil(length / _CELL_M), math.ceil(angle / _CELL_RAD))


class ToolPath:
    """A checked tool path, `length` [m] long with turns by `TURN_LENGTH`; PlanningError names a wrong waypoint."""

    def __init__(self, start: Pose, waypoints: Sequence[ToolWaypoint]):
        legs = _legs(start, waypoints)
        if not legs:
            raise PlanningError(Sentence("the tool is already there: no waypoint differs from the start"))
        self._segments, stops, marks = _trimmed(legs, waypoints)
        self._numbers = [number for number, _ in marks]
        self._ends = np.cumsum([segment.length for segment in self._segments])
        self._begins = np.concatenate(([0.0], self._ends[:-1]))
        self.length = float(self._ends[-1])
        self._waypoint_ends = [self._ends[last] for _, last in marks]
        bounds = [0, *(index + 1 for index in stops)]
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
        return self._numbers[self._next(s)]

    def waypoint_end(self, s: float) -> float:
        """Return the position along the path of the waypoint that the tool is going to at `s` [m]; the end of its blend, if any."""
        return float(self._waypoint_ends[self._next(s)])

    def _next(self, s: float) -> int:
        return min(int(np.searchsorted(self._waypoint_ends, s)), len(self._numbers) - 1)

    def _piece(self, first: int, last: int) -> Piece:
        segments = self._segments[first:last]
        knots = (float(self._begins[first]), *(float(end) for end in self._ends[first:last]))
        cells = tuple(segment.cells for segment in segments)
        return Piece(knots[0], knots[-1], isinstance(segments[0], Leg) and segments[0].turns, knots, cells)


def _legs(start: Pose, waypoints: Sequence[ToolWaypoint]) -> list[tuple[int, Leg]]:
    """Return the segments before blending, by the index of their waypoint; one at the pose before it has none."""
    legs: list[tuple[int, Leg]] = []
    at = start
    for number, waypoint in enumerate(waypoints):
        if not (0.0 <= waypoint.blend < math.inf):
            blend = Quantity(waypoint.blend, "m")
            raise PlanningError(f"waypoint {number}: the blend is {blend}; expected 0 or a positive number")
        leg = _leg(number, at, waypoint)
        if leg is not None:
            legs.append((number, leg))
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


def _trimmed(
    legs: list[tuple[int, Leg]], waypoints: Sequence[ToolWaypoint]
) -> tuple[list[Segment], list[int], list[tuple[int, int]]]:
    """Return the legs, cut and blended, the indices of those after which the tool stops, and of each waypoint's last one."""
    cuts = [0.0] * (len(legs) + 1)
    for index, ((number, leg), (_, following)) in enumerate(pairwise(legs)):
        cuts[index + 1] = waypoints[number].blend
        if cuts[index + 1] and (leg.turns or following.turns):
            raise PlanningError(f"waypoint {number}: a turn on the spot has no corner to blend; expected blend 0")
    for index, (number, leg) in enumerate(legs):
        if cuts[index] + cuts[index + 1] > leg.length * (1.0 + 1e-9):
            length, needed = Quantity(leg.length, "m"), Quantity(cuts[index] + cuts[index + 1], "m")
            found = f"the segment to waypoint {number} is {length} long; its blends need {needed}, choose smaller ones"
            raise PlanningError(found)
    segments: list[Segment] = []
    stops: list[int] = []
    marks: list[tuple[int, int]] = []
    for index, (number, leg) in enumerate(legs):
        trimmed = leg.part(cuts[index], leg.length - cuts[index + 1])
        if trimmed is not None:
            segments.append(trimmed)
        last = index == len(legs) - 1
        if cuts[index + 1]:
            blend = Blend.between(leg, legs[index + 1][1], cuts[index + 1])
            if blend is None:
                raise PlanningError(f"waypoint {number}: the path turns back there; expected blend 0")
            segments.append(blend)
        marks.append((number, len(segments) - 1))
        if last or (not cuts[index + 1] and not _is_smooth(leg, legs[index + 1][1])):
            stops.append(len(segments) - 1)
    return segments, stops, marks


def _is_smooth(leg: Leg, following: Leg) -> bool:
    if leg.turns or following.turns:
        return False
    before, after = leg.direction(leg.length), following.direction(0.0)
    return all(float(np.max(np.abs(a - b))) < SMOOTH for a, b in zip(before, after))

"""The segments of a tool path: straight line, circular arc, turn on the spot, and blend between two segments.

Every segment gives a pose as a function of its own arc length [m], from 0. `direction` is the derivative of the pose with
respect to length: a unit vector, and the angular velocity per metre in the base's directions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BPoly, CubicHermiteSpline
from scipy.spatial.transform import Rotation

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


@dataclass(frozen=True, eq=False)
class Leg:
    """A straight line, an arc or a turn on the spot, with a constant angular velocity: rotation ``exp(spin s) first``.

    Attributes:
        origin: Where it begins [m].
        tangent: Unit vector along it there; 0: a turn on the spot, whose length only parametrises the turn.
        bend: Its curvature there, towards the centre [1/m]; 0: straight.
        spin: [rad/m]
        length: [m]
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

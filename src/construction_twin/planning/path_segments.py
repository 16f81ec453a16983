"""The segments of a tool path: straight line, circular arc, turn on the spot, and blend between two segments.

Every segment gives a pose as a function of its own arc length [m], from 0. `direction` is the derivative of the pose with
respect to length: a unit vector, and the angular velocity per metre in the base's directions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

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


class Segment(Protocol):
    """What a tool path is made of."""

    @property
    def length(self) -> float:
        """[m]"""

    @property
    def cells(self) -> int:
        """Number of samples to start with."""

    def at(self, s: np.ndarray) -> tuple[np.ndarray, Rotation]:
        """Return positions, shape (m, 3), and rotations at places of shape (m,)."""


class Leg(Segment, Protocol):
    """A segment before blending, which can be cut and joined to a blend."""

    def direction(self, s: float) -> tuple[np.ndarray, np.ndarray]:
        """Return unit tangent and angular velocity per metre, shape (3,) each."""

    def curvature(self, s: float) -> np.ndarray:
        """Return the second derivative of the position over length, shape (3,) [1/m]."""

    def part(self, begin: float, end: float) -> Leg | None:
        """Return the part from `begin` to `end`; None if its length is zero."""


@dataclass(frozen=True, eq=False)
class StraightLine:
    """A straight line with a constant angular velocity.

    It runs from `origin` along the unit vector `tangent`, rotation ``exp(spin s) first``.
    """

    origin: np.ndarray
    tangent: np.ndarray
    first: Rotation
    spin: np.ndarray
    length: float

    @classmethod
    def between(cls, start: np.ndarray, goal: np.ndarray, first: Rotation, turn: np.ndarray) -> StraightLine:
        """Return the line between two different points; `turn` is the rotation vector of the whole line."""
        length = float(np.linalg.norm(np.asarray(goal) - start))
        return cls(np.array(start), (np.asarray(goal) - start) / length, first, turn / length, length)

    @property
    def cells(self) -> int:
        """See `Segment`."""
        return _cells(self.length, float(np.linalg.norm(self.spin)) * self.length)

    def at(self, s: np.ndarray) -> tuple[np.ndarray, Rotation]:
        """See `Segment`."""
        return self.origin + s[:, None] * self.tangent, Rotation.from_rotvec(s[:, None] * self.spin) * self.first

    def direction(self, s: float) -> tuple[np.ndarray, np.ndarray]:
        """See `Segment`."""
        return self.tangent, self.spin

    def curvature(self, s: float) -> np.ndarray:
        """See `Segment`."""
        return np.zeros(3)

    def part(self, begin: float, end: float) -> StraightLine | None:
        """See `Segment`."""
        if end - begin <= 1e-9 * self.length:
            return None
        origin, first = self.at(np.array([begin]))
        return StraightLine(origin[0], self.tangent, first[0], self.spin, end - begin)


@dataclass(frozen=True, eq=False)
class ArcLine:
    """A circular arc with a constant angular velocity: ``centre + radius (cos(s / radius) out + sin(s / radius) along)``."""

    centre: np.ndarray
    radius: float
    out: np.ndarray
    along: np.ndarray
    first: Rotation
    spin: np.ndarray
    length: float

    @classmethod
    def through(
        cls, start: np.ndarray, via: np.ndarray, goal: np.ndarray, first: Rotation, turn: np.ndarray
    ) -> ArcLine | None:
        """Return the arc from `start` through `via` to `goal`; None if no circle passes through the three."""
        to_via, to_goal = np.asarray(via) - start, np.asarray(goal) - start
        normal = np.cross(to_via, to_goal)
        area = float(np.linalg.norm(normal))
        sizes = float(np.linalg.norm(to_via)) * float(np.linalg.norm(to_goal))
        if not area > _ON_A_LINE * sizes or np.linalg.norm(to_goal - to_via) == 0.0:
            return None
        offset = np.cross(to_via @ to_via * to_goal - to_goal @ to_goal * to_via, normal) / (2.0 * area**2)
        radius = float(np.linalg.norm(offset))
        out = -offset / radius
        along = np.cross(normal / area, out)
        angle = math.atan2((to_goal - offset) @ along, (to_goal - offset) @ out) % (2.0 * math.pi)
        length = radius * angle
        return cls(np.asarray(start) + offset, radius, out, along, first, turn / length, length)

    @property
    def cells(self) -> int:
        """See `Segment`."""
        angle = self.length / self.radius + float(np.linalg.norm(self.spin)) * self.length
        return _cells(self.length, angle)

    def at(self, s: np.ndarray) -> tuple[np.ndarray, Rotation]:
        """See `Segment`."""
        angle = (s / self.radius)[:, None]
        positions = self.centre + self.radius * (np.cos(angle) * self.out + np.sin(angle) * self.along)
        return positions, Rotation.from_rotvec(s[:, None] * self.spin) * self.first

    def direction(self, s: float) -> tuple[np.ndarray, np.ndarray]:
        """See `Segment`."""
        angle = s / self.radius
        return math.cos(angle) * self.along - math.sin(angle) * self.out, self.spin

    def curvature(self, s: float) -> np.ndarray:
        """See `Segment`."""
        angle = s / self.radius
        return -(math.cos(angle) * self.out + math.sin(angle) * self.along) / self.radius

    def part(self, begin: float, end: float) -> ArcLine | None:
        """See `Segment`."""
        if end - begin <= 1e-9 * self.length:
            return None
        angle = begin / self.radius
        out = math.cos(angle) * self.out + math.sin(angle) * self.along
        first = self.at(np.array([begin]))[1][0]
        return ArcLine(self.centre, self.radius, out, self.direction(begin)[0], first, self.spin, end - begin)


@dataclass(frozen=True, eq=False)
class Turn:
    """A turn on the spot by the rotation vector `turn`; its length only parametrises the turn."""

    position: np.ndarray
    first: Rotation
    turn: np.ndarray
    length: float

    @property
    def cells(self) -> int:
        """See `Segment`."""
        return _cells(0.0, float(np.linalg.norm(self.turn)))

    def at(self, s: np.ndarray) -> tuple[np.ndarray, Rotation]:
        """See `Segment`."""
        turns = Rotation.from_rotvec((s / self.length)[:, None] * self.turn)
        return np.tile(self.position, (len(s), 1)), turns * self.first

    def direction(self, s: float) -> tuple[np.ndarray, np.ndarray]:
        """See `Segment`."""
        return np.zeros(3), self.turn / self.length

    def curvature(self, s: float) -> np.ndarray:
        """See `Segment`."""
        return np.zeros(3)

    def part(self, begin: float, end: float) -> Turn | None:
        """See `Segment`."""
        return self


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
        """Blend the corner between two segments over the last and first `cut` metres of them; None where the path
        turns back.
        """
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
        """See `Segment`."""
        turn = float(np.linalg.norm(self.curve(1.0)[3:] - self.curve(0.0)[3:]))
        return max(_BLEND_CELLS, _cells(self.length, turn))

    def at(self, s: np.ndarray) -> tuple[np.ndarray, Rotation]:
        """See `Segment`."""
        values = self.curve(np.clip(self.parameter(s), 0.0, 1.0))
        return values[:, :3], Rotation.from_rotvec(values[:, 3:]) * self.corner


def _cell_lengths(curve: BPoly, u: np.ndarray) -> np.ndarray:
    """Return the length of the curve's positions between neighbouring parameters (Gauss, five points)."""
    nodes, weights = np.polynomial.legendre.leggauss(5)
    half = 0.5 * np.diff(u)
    at = 0.5 * (u[:-1] + u[1:])[:, None] + half[:, None] * nodes
    speed = np.linalg.norm(curve(at.ravel(), 1)[:, :3], axis=1).reshape(at.shape)
    return half * (speed @ weights)


def _cells(length: float, angle: float) -> int:
    return max(_FEWEST_CELLS, math.ceil(length / _CELL_M), math.ceil(angle / _CELL_RAD))

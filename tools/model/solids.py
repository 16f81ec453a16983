"""Solids that machine parts are made of: turned, cast, bolted. Metres; every solid is closed, its normals point outward.

Built on manifold3d, whose boolean operations keep solids closed. Same numbers in, same solid out.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from manifold3d import CrossSection, Manifold

Point = tuple[float, float, float]

#: Segments of a full circle, and steps of a rounded edge.
SEGMENTS, EDGE_STEPS = 48, 2
#: Rotation [deg, fixed axes x y z] that turns +z into each axis.
_TURN = {"x": (0.0, 90.0, 0.0), "-x": (0.0, -90.0, 0.0), "y": (-90.0, 0.0, 0.0), "-y": (90.0, 0.0, 0.0),
         "z": (0.0, 0.0, 0.0), "-z": (180.0, 0.0, 0.0)}  # fmt: skip


def turned(
    profile: Sequence[tuple[float, float]], axis: str, at: Point = (0, 0, 0), segments: int = SEGMENTS
) -> Manifold:
    """Return the solid that a profile makes when it turns about an axis.

    Args:
        profile: Radius and height along the axis of each corner [m]; closed along the axis.
        axis: ``x``, ``y``, ``z``, or with a minus.
        at: Length 3. Where height 0 lies.
    """
    corners = [(0.0, profile[0][1]), *profile, (0.0, profile[-1][1])]
    section = CrossSection([np.array(corners)])
    if section.area() <= 0.0:
        section = CrossSection([np.array(corners[::-1])])
    return Manifold.revolve(section, segments).rotate(_TURN[axis]).translate(at)


def rounded(radius: float, low: float, high: float, edge: float) -> list[tuple[float, float]]:
    """Return the profile of a cylinder from `low` to `high` with rounded edges."""
    quarter = [math.pi / 2 * step / EDGE_STEPS for step in range(EDGE_STEPS + 1)]
    lower = [(radius - edge * (1 - math.sin(angle)), low + edge * (1 - math.cos(angle))) for angle in quarter]
    upper = [(radius - edge * (1 - math.cos(angle)), high - edge * (1 - math.sin(angle))) for angle in quarter]
    return lower + upper


def rod(
    radius: float,
    axis: str,
    low: float,
    high: float,
    at: Point = (0, 0, 0),
    edge: float = 0.006,
    segments: int = SEGMENTS,
) -> Manifold:
    """Return a cylinder with rounded edges; it runs from `low` to `high` along the axis through `at`."""
    return turned(rounded(radius, low, high, edge), axis, at, segments)


def ring(
    outer: float, inner: float, axis: str, low: float, high: float, at: Point = (0, 0, 0), edge: float = 0.003
) -> Manifold:
    """Return a rod with a hole through it."""
    return rod(outer, axis, low, high, at, edge) - rod(inner, axis, low - 0.01, high + 0.01, at, 0.0)


def block(low: Point, high: Point, edge: float = 0.012, segments: int = 12) -> Manifold:
    """Return a box between two corners, its edges rounded."""
    ball = Manifold.sphere(edge, segments)
    corners = [tuple((low[i] + edge, high[i] - edge)[bit >> i & 1] for i in range(3)) for bit in range(8)]
    return Manifold.batch_hull([ball.translate(corner) for corner in corners])


def joined(solids: Iterable[Manifold]) -> Manifold:
    """Return the union."""
    total = Manifold()
    for solid in solids:
        total = total + solid
    return total


def skin(*solids: Manifold) -> Manifold:
    """Return the convex body around solids: a casting that runs from one to the other."""
    return Manifold.batch_hull(list(solids))


def chain(solids: Sequence[Manifold]) -> Manifold:
    """Return a casting that runs through solids one after the other."""
    return joined(skin(*pair) for pair in zip(solids, solids[1:]))


def tube(points: Sequence[Point], radius: float, segments: int = 10) -> Manifold:
    """Return a hose through points."""
    ball = Manifold.sphere(radius, segments)
    return chain([ball.translate(point) for point in points])


def hose(points: Sequence[Point], radius: float, steps: int = 6) -> Manifold:
    """Return a hose that bends smoothly through points (Catmull-Rom)."""
    given = np.array([points[0], *points, points[-1]], dtype=float)
    way = []
    for a, b, c, d in zip(given, given[1:], given[2:], given[3:]):
        for t in np.linspace(0.0, 1.0, steps, endpoint=False):
            way.append(
                0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3)
            )
    return tube([tuple(point) for point in [*way, given[-1]]], radius)


def bolts(
    count: int,
    pitch_radius: float,
    size: float,
    axis: str,
    height: float,
    at: Point = (0, 0, 0),
    first_deg: float = 0.0,
) -> Manifold:
    """Return a ring of hexagon heads that stand `height` above the plane through `at`.

    Args:
        pitch_radius: [m]
        size: Across corners [m].
        axis: The heads' direction.
        height: [m]
        at: Length 3
        first_deg: Angle of the first one [deg].
    """
    head = Manifold.cylinder(2 * height, size / 2, size / 2 - 0.1 * size, 6).translate((pitch_radius, 0, -height))
    angles = (first_deg + 360.0 / count * number for number in range(count))
    return joined(head.rotate((0, 0, angle)) for angle in angles).rotate(_TURN[axis]).translate(at)


def holes(
    count: int,
    pitch_radius: float,
    radius: float,
    axis: str,
    depth: float,
    at: Point = (0, 0, 0),
    first_deg: float = 0.0,
) -> Manifold:
    """Return a ring of bores to subtract, `depth` deep from the plane through `at`, against the axis."""
    bore = Manifold.cylinder(depth + 0.01, radius, radius, 12).translate((pitch_radius, 0, -depth))
    angles = (first_deg + 360.0 / count * number for number in range(count))
    return joined(bore.rotate((0, 0, angle)) for angle in angles).rotate(_TURN[axis]).translate(at)


def motor(radius: float, axis: str, low: float, high: float, at: Point) -> Manifold:
    """Return a servo motor: flange, body with a groove, brake cap, and its two plugs; it ends at `high`."""
    length = high - low
    square = 0.92 * radius
    body = turned(
        [
            *rounded(radius, 0.0, 0.08 * length, 0.002),
            (square, 0.08 * length), (square, 0.62 * length),
            (square - 0.006, 0.62 * length), (square - 0.006, 0.66 * length),
            (square, 0.66 * length), (square, 0.95 * length),
            (square - 0.05 * length, length),
        ],
        "z", segments=32,
    )  # fmt: skip
    plug = rod(0.24 * radius, "x", 0.0, 1.1 * radius, (0, 0, 0), 0.0, 12)
    plugs = plug.translate((0, 0, 0.78 * length)) + plug.translate((0, 0, 0.5 * length))
    ribs = joined(
        Manifold.cube((0.02, 0.014, 0.46 * length), True).translate((0, square, 0.35 * length)).rotate((0, 0, angle))
        for angle in range(45, 360, 45)
    )
    return (body + plugs + ribs).translate((0, 0, low)).rotate(_TURN[axis]).translate(at)

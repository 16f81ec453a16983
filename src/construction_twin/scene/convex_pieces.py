"""A body that is not convex as convex pieces, for planner, simulation and elements alike. Metres.

A body of flat faces is cut exactly by planes of its own faces (`convex_cells`), any other is held by hulls of its parts
(`convex_cover`). That pieces hold a closed body is calculated (the body without them has no volume), of one that is not closed
tested at points; how far they reach beyond it is measured at points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import coal
import manifold3d
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from construction_twin.scene.solids import hull_solid, mesh_of, parts, solid, triangle_area, union
from construction_twin.scene.triangle_mesh import surface

#: What lies further outside of all pieces is not held [m]; also the thickness below which a leftover is rounding.
HELD = 1e-6
#: By how much pieces are made larger or smaller before they are compared with the body [m].
_APART = 1e-7
#: Points on each triangle at which a body that is not closed is tested: corners of a grid.
_GRID = 6
#: Points at which what the pieces have more is measured: on its surface, most of them; inside of it along each axis.
_MOST_POINTS, _INSIDE = 4000, 14


def lost(
    vertices: np.ndarray, triangles: np.ndarray, body: manifold3d.Manifold | None, pieces: Sequence[np.ndarray]
) -> float:
    """Return how far a body reaches beyond the pieces [m]; 0: they hold it within 1e-6 m.

    Args:
        body: The same as a closed body, if it is one.
        pieces: Corners of each, shape (k, 3).
    """
    outside = farthest_outside(points_on(vertices, triangles), pieces)
    if body is not None:
        rest = body - union(hull_solid(resized(points, _APART)) for points in pieces)
        # a sheet of that thickness over the whole surface is what rounding may leave
        if rest.volume() > HELD * triangle_area(vertices, triangles):
            outside = max(outside, farthest_outside(mesh_of(rest)[0], pieces), 2.0 * HELD)
    return outside if outside > HELD else 0.0


def extra_volume(body: manifold3d.Manifold, pieces: Sequence[np.ndarray]) -> float:
    """Return by how much more volume pieces without overlaps have than a closed body [m^3]; 0: the same, but for rounding."""
    difference = sum(hull_solid(points).volume() for points in pieces) - body.volume()
    return difference if abs(difference) > HELD * body.surface_area() else 0.0


def points_on(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the corners of triangles and points on their edges and faces, shape (n, 3); large meshes: corners and middles."""
    corners = vertices[triangles]
    steps = _GRID if len(triangles) <= 2000 else 1
    weights = [(a, b, steps - a - b) for a in range(steps + 1) for b in range(steps + 1 - a)]
    inner = np.einsum("wc,tcx->twx", np.array(weights) / steps, corners).reshape(-1, 3)
    return np.concatenate([vertices[np.unique(triangles)], inner, corners.mean(axis=1)])


def farthest_outside(points: np.ndarray, pieces: Sequence[np.ndarray]) -> float:
    """Return how far the worst of some points lies outside of the piece that it lies least outside of: at most its distance [m]."""
    least = np.full(len(points), np.inf)
    for planes in (ConvexHull(corners).equations for corners in pieces):
        least = np.minimum(least, (points @ planes[:, :3].T + planes[:, 3]).max(axis=1))
    return float(np.maximum(least, 0.0).max(initial=0.0))


def excess(body: manifold3d.Manifold, pieces: Sequence[np.ndarray]) -> float:
    """Return the largest distance from a closed body of what its pieces have more [m]; a cavity that they fill counts."""
    vertices, triangles = mesh_of(body)
    rounding = HELD * triangle_area(vertices, triangles)
    found = [hull_solid(resized(points, -_APART)) - body for points in pieces]
    more = [rest for rest in found if rest.volume() > rounding / len(pieces)]
    return max((_reach(rest, vertices, triangles) for rest in more), default=0.0)


def resized(points: np.ndarray, by: float) -> np.ndarray:
    """Return corners whose extents along their own main axes are larger by twice a distance, or smaller where it is negative [m].

    manifold3d may give a wrong difference of bodies whose faces lie in one plane but for the last digits (3.5.4: a convex part of a
    body minus the body was the whole part); so the pieces are compared a little larger, or smaller, than they are.
    """
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    axes = np.linalg.svd(points - middle, full_matrices=False)[2]
    local = (points - middle) @ axes.T
    extents = np.ptp(local, axis=0)
    return middle + (local * (1.0 + 2.0 * by / np.maximum(extents, 4.0 * abs(by)))) @ axes


def _reach(more: manifold3d.Manifold, vertices: np.ndarray, triangles: np.ndarray) -> float:
    """Return the largest distance of a body's points from a mesh [m]."""
    points = mesh_of(more)[0]
    size = float(np.ptp(points, axis=0).max())
    length = size / 20.0
    if more.surface_area() / length**2 < _MOST_POINTS:
        points = mesh_of(more.refine_to_length(length))[0]
    points = np.concatenate([points[:: max(len(points) // _MOST_POINTS, 1)], _inside(more)])
    return float(distances(points, vertices, triangles).max(initial=0.0))


def _inside(body: manifold3d.Manifold) -> np.ndarray:
    """Return points of a grid that lie in a body, shape (n, 3)."""
    vertices, triangles = mesh_of(body)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    x, y, z = (np.linspace(a, b, _INSIDE + 2)[1:-1] for a, b in zip(low, high))
    found = []
    for column in [(float(one), float(other)) for one in x for other in y]:
        # along a line of the grid: inside after an odd number of faces
        hits = body.ray_cast((*column, float(low[2]) - 1.0), (*column, float(high[2]) + 1.0))
        if hits:
            heights = np.array([hit.position[2] for hit in hits])
            inside = z[(heights[None, :] < z[:, None]).sum(axis=1) % 2 == 1]
            found.append(np.column_stack([np.tile(column, (len(inside), 1)), inside]))
    return np.concatenate(found) if found else np.empty((0, 3))


def distances(points: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the distance of each point from triangles, shape (n,) [m]."""
    mesh = surface(vertices, triangles)
    radius = 1e-9
    point, here = coal.Sphere(radius), coal.Transform3s.Identity()
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    found = np.empty(len(points))
    for row, position in enumerate(points):
        result.clear()
        place = coal.Transform3s(np.eye(3), position)
        found[row] = max(coal.distance(point, place, mesh, here, request, result), 0.0) + radius
    return found


#: Distance from a plane within which a point lies on it [m].
_ON = 1e-8
#: A part is convex when its hull has no more volume than this fraction.
_SAME = 1e-9


def convex_cells(body: manifold3d.Manifold, most: int) -> list[np.ndarray] | None:
    """Return the corners of convex bodies that fill a closed body without overlaps; None: there would be more than `most`."""
    waiting = [body]
    kept: list[np.ndarray] = []
    while waiting:
        part = waiting.pop()
        corners, triangles = mesh_of(part)
        if part.volume() <= _ON * part.surface_area():
            continue
        hull = part.hull()
        if hull.volume() - part.volume() <= _SAME * hull.volume():
            kept.append(mesh_of(hull)[0])
            continue
        plane = _largest_within(corners, triangles)
        if plane is None or len(kept) + len(waiting) > 8 * most:
            return None
        waiting += part.split_by_plane(tuple(plane[:3]), float(plane[3]))
    cells = _joined(kept)
    return sorted(cells, key=lambda cell: np.round(cell.min(axis=0), 6).tolist()) if 0 < len(cells) <= most else None


def _largest_within(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray | None:
    """Return normal and offset of the plane with most area of faces, of those that have the body on both sides."""
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    found, most = None, 0.0
    left = areas > 0
    for row in np.argsort(-np.round(areas, 12), kind="stable"):
        if not left[row]:
            continue
        normal = normals[row] / areas[row]
        heights = (vertices - corners[row, 0]) @ normal
        mine = left & (np.abs(heights[triangles]).max(axis=1) <= _ON)
        left &= ~mine
        left[row] = False
        area = round(float(areas[mine].sum()), 9)
        if heights.max() > _ON and heights.min() < -_ON and area > most:
            found, most = np.array((*normal, normal @ corners[row, 0])), area
    return found


def _joined(cells: list[np.ndarray]) -> list[np.ndarray]:
    """Join two bodies whose union is convex, until there are none."""
    alive = dict(enumerate(cells))
    volumes = {number: float(ConvexHull(cell).volume) for number, cell in alive.items()}
    queue = [(one, other) for one in alive for other in alive if one < other]
    while queue:
        left: list[tuple[int, int]] = []
        for one, other in queue:
            if one not in alive or other not in alive or not _near(alive[one], alive[other]):
                continue
            hull = ConvexHull(np.concatenate([alive[one], alive[other]]))
            volume = volumes[one] + volumes[other]
            if hull.volume - volume > _SAME * volume:
                continue
            number = max(volumes) + 1
            del alive[one], alive[other]
            left += [(near, number) for near in alive]
            alive[number], volumes[number] = hull.points[hull.vertices], float(hull.volume)
        queue = left
    return list(alive.values())


def _near(one: np.ndarray, other: np.ndarray) -> bool:
    return bool(
        (one.min(axis=0) <= other.max(axis=0) + _ON).all() and (other.min(axis=0) <= one.max(axis=0) + _ON).all()
    )


#: Of planes that are compared by points alone, how many are tried.
_TRIED = 6
#: Most faces at which a hull's reach is measured; most corners on a side, and of a cut, by which planes are compared.
_FACES, _CORNERS, _CUT = 600, 300, 100
#: A part of less thickness is nothing [m].
_THIN = 1e-8
#: Main axes whose moments differ by less than this fraction are those of a body that has none there: rounding would choose them.
_ALIKE = 1e-3

#: A plane: its normal, shape (3,), and its distance from the origin along it.
_Plane = tuple[np.ndarray, float]


class _Part:
    """A part of the body, and how far its hull reaches beyond it."""

    def __init__(self, body: manifold3d.Manifold):
        self.body = body
        self.vertices, self.triangles = mesh_of(body)
        hull = ConvexHull(self.vertices)
        self.corners = hull.points[hull.vertices]
        corners = self.vertices[self.triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas = np.linalg.norm(normals, axis=1)
        real = np.flatnonzero(areas > 0.0)
        real = real[:: -(-len(real) // _FACES)]
        self._areas, self._normals = areas[real], normals[real] / areas[real, None]
        self._middles = corners[real].mean(axis=1)
        # outwards from the middle of a face to where the hull ends; on a face of the hull itself, and of a cut, that is nothing
        slopes = self._normals @ hull.equations[:, :3].T
        heights = np.maximum(-(self._middles @ hull.equations[:, :3].T + hull.equations[:, 3]), 0.0)
        ways = np.where(slopes > 1e-6, heights / np.maximum(slopes, 1e-6), np.inf).min(axis=1)
        self._worst = int(ways.argmax())
        self.reach = float(ways[self._worst])

    def best_cut(self) -> list[_Part]:
        """Return what the best plane leaves of this part: the plane of its worst face, or one across an axis."""
        normal, middle = self._normals[self._worst], self._middles[self._worst]
        across = []
        for axis in (*np.eye(3), *self._main_axes()):
            heights = self.vertices @ axis
            low, high = float(heights.min()), float(heights.max())
            across += [(axis, low + part * (high - low)) for part in (0.25, 0.5, 0.75)]
            across.append((axis, float(axis @ middle)))
        edges = np.unique(np.sort(self.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
        across.sort(key=lambda plane: round(self._volume_by_points(plane, edges), 9))
        found: list[manifold3d.Manifold] = []
        least = np.inf
        for plane in ((normal, float(normal @ middle)), *across[:_TRIED]):
            sides = [one for side in self.body.split_by_plane(tuple(plane[0]), plane[1]) for one in _bodies(side)]
            volume = round(sum(one.hull().volume() for one in sides), 12)
            if len(sides) > 1 and volume < least:
                found, least = sides, volume
        return [_Part(one) for one in found]

    def _main_axes(self) -> list[np.ndarray]:
        """Return the axes along which the faces are spread most and least, where rounding does not decide which they are."""
        weights = self._areas / self._areas.sum()
        away = self._middles - weights @ self._middles
        moments, axes = np.linalg.eigh((away * weights[:, None]).T @ away)
        apart = np.abs(moments[:, None] - moments[None]) + np.diag([np.inf] * 3)
        return [axes[:, one] for one in range(3) if apart[one].min() > _ALIKE * moments[2]]

    def _volume_by_points(self, plane: _Plane, edges: np.ndarray) -> float:
        """Return about which volume the hulls of both sides of a plane have together [m^3]; infinite where one is empty."""
        heights = self.vertices @ plane[0] - plane[1]
        first, second = heights[edges[:, 0]], heights[edges[:, 1]]
        crossing = (first < 0.0) != (second < 0.0)
        share = (first[crossing] / (first[crossing] - second[crossing]))[:, None]
        ends = self.vertices[edges[crossing]]
        cut = ends[:, 0] * (1.0 - share) + ends[:, 1] * share
        cut = cut[:: max(-(-len(cut) // _CUT), 1)]
        volume = 0.0
        for side in (heights > 0.0, heights < 0.0):
            corners = self.vertices[side]
            corners = corners[:: max(-(-len(corners) // _CORNERS), 1)]
            try:
                volume += float(ConvexHull(np.concatenate([corners, cut])).volume)
            except (QhullError, ValueError):
                # nothing on that side, or nothing with a volume
                return np.inf
        return volume


def convex_cover(body: manifold3d.Manifold, most: int, aim: float) -> list[np.ndarray] | None:
    """Return the corners of convex pieces that hold a closed body; the same body gives the same ones.

    Each piece is the hull of a part: so they hold the body whatever the planes. Cut is always the part whose hull reaches furthest
    beyond it, by the plane after which the hulls have the least volume.

    Args:
        aim: Pieces that reach no further beyond the body, as measured at its faces, are not divided [m].

    Returns:
        Each of shape (k, 3). None: the parts that the body was cut into have not its volume.
    """
    parts = [_Part(one) for one in _bodies(body)]
    whole = list(parts)
    while whole and len(parts) < most:
        worst = max(whole, key=lambda part: part.reach)
        if worst.reach <= aim:
            break
        cut = worst.best_cut()
        whole.remove(worst)
        if not cut or len(parts) - 1 + len(cut) > most:
            # what no plane divides, or into too many, stays as it is
            continue
        parts.remove(worst)
        parts += cut
        whole += cut
    missing = body.volume() - sum(part.body.volume() for part in parts)
    if not 0 < len(parts) <= most or abs(missing) > len(parts) * _THIN * body.surface_area():
        return None
    return sorted((part.corners for part in parts), key=lambda corners: np.round(corners.min(axis=0), 6).tolist())


def _bodies(side: manifold3d.Manifold) -> list[manifold3d.Manifold]:
    """Return the connected bodies of what is on a side of a plane, without what is too thin to be one."""
    found = [one for one in side.decompose() if abs(one.volume()) > _THIN * one.surface_area()]
    # the wall of a cavity is a body of its own for `decompose`, turned inside out
    return [side] if any(one.volume() < 0.0 for one in found) else found


#: Most pieces that fill a mesh exactly; triangles beyond which that is not tried: those of curved faces would each be a cut.
_MOST, _MOST_TRIANGLES = 32, 300
#: Most pieces that hold a mesh; triangles beyond which it is not divided at all: it would take more than a few seconds.
_MOST_HOLDING, _MOST_COVERED = 64, 5000
#: A piece that reaches no further beyond the mesh is not divided: [m], and as a fraction of the mesh's size.
_AIM, _AIM_SHARE = 0.001, 0.005
#: Meshes of which the pieces are kept.
_KEPT = 64


@dataclass(frozen=True, eq=False)
class Pieces:
    """Convex pieces that together hold all of a mesh.

    Attributes:
        corners: Of each piece, shape (k, 3) [m].
        reach: How far they reach beyond the mesh, measured at points [m].
        whole: What the mesh encloses as vertices, shape (v, 3) [m], and triangles, shape (t, 3), counterclockwise seen from
            outside; None: the pieces are exactly that, without overlaps.
    """

    corners: tuple[np.ndarray, ...]
    reach: float = 0.0
    whole: tuple[np.ndarray, np.ndarray] | None = None


def convex_pieces(vertices: np.ndarray, triangles: np.ndarray) -> Pieces | None:
    """Return convex pieces of what a mesh encloses; the same mesh gives the same ones, and is divided once per process.

    A mesh of flat faces is filled exactly, without overlaps; a curved one is held by hulls of its parts. That they hold the
    mesh within 1e-6 m is checked, and how far they reach beyond it is measured. None: it is not closed, or has more than 5,000
    triangles.
    """
    if len(triangles) > _MOST_COVERED:
        return None
    return _divided(
        np.ascontiguousarray(vertices, dtype=float).tobytes(), np.ascontiguousarray(triangles, dtype=np.int64).tobytes()
    )


@lru_cache(maxsize=_KEPT)
def _divided(corners: bytes, indices: bytes) -> Pieces | None:
    vertices, triangles = np.frombuffer(corners).reshape(-1, 3), np.frombuffer(indices, dtype=np.int64).reshape(-1, 3)
    closed = solid(vertices, triangles)
    if closed is None:
        return None
    separate = parts(closed)
    if len(separate) > 1:
        # closed bodies that reach into each other are one
        closed = union(separate)
    if len(triangles) <= _MOST_TRIANGLES:
        pieces = convex_cells(closed, _MOST)
        if pieces is not None and not extra_volume(closed, pieces) and not lost(vertices, triangles, None, pieces):
            return Pieces(tuple(pieces))
    return _covered(vertices, closed)


def _covered(vertices: np.ndarray, closed: manifold3d.Manifold) -> Pieces | None:
    size = float(np.ptp(vertices, axis=0).max())
    pieces = convex_cover(closed, _MOST_HOLDING, min(_AIM, _AIM_SHARE * size))
    # its parts have the body's volume, and a part is in its hull: what is left to check is the mesh that the body was made of
    if pieces is None or farthest_outside(vertices, pieces) > HELD:
        return None
    return Pieces(tuple(pieces), excess(closed, pieces), mesh_of(closed))

"""A closed body as convex pieces that hold it: for planner, simulation and elements of a building. Metres.

A body of flat faces is cut exactly by planes of its own faces, any other is held by hulls of its parts. That the pieces have all of
its volume is calculated, how far they reach beyond it is measured at points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import coal
import manifold3d
import numpy as np
from scipy.spatial import ConvexHull

from construction_twin.scene.mesh_file import surface
from construction_twin.scene.solids import hull_solid, mesh_of, parts, solid, union

#: Most pieces; triangles beyond which a mesh is not divided at all: it would take more than a few seconds.
MOST_PIECES, MOST_TRIANGLES = 64, 5000
#: Most pieces that fill a mesh exactly; triangles beyond which that is not tried: those of curved faces would each be a cut.
_MOST_CELLS, _MOST_CUT = 32, 600
#: Distance from a plane within which a point lies on it [m]; a part is convex when its hull has no more volume than this fraction.
_ON, _SAME = 1e-8, 1e-9
#: A part whose hull reaches no further beyond it is not divided: [m], and as a fraction of the mesh's size.
_AIM, _AIM_SHARE = 0.001, 0.005
#: What lies further outside of all pieces is not held [m]; also the thickness below which a difference of volumes is rounding.
HELD = 1e-6
#: A part of less thickness is nothing [m].
_THIN = 1e-8
#: Faces at which a hull's reach is measured, at most; a mesh of fewer is refined to this part of its size.
_FACES, _FINE = 600, 0.1
#: Parts of a part's size at which planes across its axes are tried.
_ACROSS = (0.25, 0.5, 0.75)
#: Main axes whose moments differ by less than this fraction are those of a body that has none there: rounding would choose them.
_ALIKE = 1e-3
#: Parts of the way from the middle of what a piece has more to its surface at which that is measured.
_DEPTHS = (1.0, 0.95, 0.85, 0.7)
#: Radius of what stands for a point, and a way out of every mesh that no face is likely to lie along [m].
_POINT, _FAR_AWAY = 1e-9, np.array((3.1e4, 4.7e4, 8.3e4))
#: Meshes of which the pieces are kept.
_KEPT = 64

#: A plane: its normal, shape (3,), and its distance from the origin along it.
_Plane = tuple[np.ndarray, float]


@dataclass(frozen=True, eq=False)
class ConvexPieces:
    """Convex pieces that together hold all of a mesh.

    Attributes:
        corners: Of each piece, shape (k, 3) [m].
        reach: How far they reach beyond the mesh, measured at its faces [m].
        whole: Vertices and triangles of what the mesh encloses; None: the pieces are exactly that, without overlaps.
    """

    corners: tuple[np.ndarray, ...]
    reach: float = 0.0
    whole: tuple[np.ndarray, np.ndarray] | None = None


def convex_pieces(vertices: np.ndarray, triangles: np.ndarray) -> ConvexPieces | None:
    """Return convex pieces of what a mesh encloses, the same for the same mesh; None: not closed, too fine, or too many pieces."""
    if len(triangles) > MOST_TRIANGLES:
        return None
    return _divided(
        np.ascontiguousarray(vertices, dtype=float).tobytes(), np.ascontiguousarray(triangles, dtype=np.int64).tobytes()
    )


@lru_cache(maxsize=_KEPT)
def _divided(corners: bytes, indices: bytes) -> ConvexPieces | None:
    vertices, triangles = np.frombuffer(corners).reshape(-1, 3), np.frombuffer(indices, dtype=np.int64).reshape(-1, 3)
    closed = solid(vertices, triangles)
    if closed is None:
        return None
    separate = parts(closed)
    if len(separate) > 1:
        # closed bodies that reach into each other are one
        closed = union(separate)
    cells = convex_cells(closed, _MOST_CELLS) if len(triangles) <= _MOST_CUT else None
    if cells is not None:
        more = sum(hull_solid(points).volume() for points in cells) - closed.volume()
        if abs(more) <= HELD * closed.surface_area() and farthest_outside(vertices, cells) <= HELD:
            return ConvexPieces(tuple(cells))
    covered = _covered(closed, min(_AIM, _AIM_SHARE * float(np.ptp(vertices, axis=0).max())))
    missing = closed.volume() - sum(part.body.volume() for part in covered)
    pieces = sorted((part.corners for part in covered), key=lambda one: np.round(one.min(axis=0), 6).tolist())
    if not 0 < len(pieces) <= MOST_PIECES or abs(missing) > HELD * closed.surface_area():
        return None
    if farthest_outside(vertices, pieces) > HELD:
        return None
    return ConvexPieces(
        tuple(pieces), max(max(part.reach for part in covered), _excess(closed, pieces)), mesh_of(closed)
    )


def _excess(body: manifold3d.Manifold, pieces: Sequence[np.ndarray]) -> float:
    """Return the largest distance from a body of points of its pieces that lie outside of it [m]."""
    mesh, here = surface(*mesh_of(body)), coal.Transform3s.Identity()
    point, request, most = coal.Sphere(_POINT), coal.DistanceRequest(), 0.0
    for corners in pieces:
        # only of what the piece has more: of a ring of 4,096 triangles that is a third of the time
        for more in (hull_solid(corners) - body).decompose():
            shell = mesh_of(more.refine_to_length(_FINE * float(np.ptp(corners, axis=0).max())))[0]
            middle = shell.mean(axis=0)
            for position in np.concatenate([middle + depth * (shell - middle) for depth in _DEPTHS]):
                at = coal.Transform3s(np.eye(3), position)
                away = coal.distance(point, at, mesh, here, request, coal.DistanceResult()) + _POINT
                # on a line to far away what lies outside meets an even number of faces
                if away > most and len(body.ray_cast(tuple(position), tuple(position + _FAR_AWAY))) % 2 == 0:
                    most = away
    return float(most)


def farthest_outside(points: np.ndarray, pieces: Sequence[np.ndarray]) -> float:
    """Return how far the worst of some points lies outside of the piece that it lies least outside of: at most its distance [m]."""
    least = np.full(len(points), np.inf)
    for planes in (ConvexHull(corners).equations for corners in pieces):
        least = np.minimum(least, (points @ planes[:, :3].T + planes[:, 3]).max(axis=1))
    return float(np.maximum(least, 0.0).max(initial=0.0))


def convex_cells(body: manifold3d.Manifold, most: int) -> list[np.ndarray] | None:
    """Return the corners of convex bodies that fill a closed body without overlaps; None: there would be more than `most`."""
    waiting = [body]
    convex: list[np.ndarray] = []
    while waiting:
        part = waiting.pop()
        corners, triangles = mesh_of(part)
        if part.volume() <= _ON * part.surface_area():
            continue
        hull = part.hull()
        if hull.volume() - part.volume() <= _SAME * hull.volume():
            convex.append(mesh_of(hull)[0])
            continue
        plane = _largest_within(corners, triangles)
        if plane is None or len(convex) + len(waiting) > 8 * most:
            return None
        waiting += part.split_by_plane(tuple(plane[:3]), float(plane[3]))
    cells = _merged(convex)
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


def _merged(cells: list[np.ndarray]) -> list[np.ndarray]:
    """Join pairs of bodies with a convex union, until there are none."""
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


def _covered(body: manifold3d.Manifold, aim: float) -> list[_Part]:
    """Cut a body by helpful planes into at most `MOST_PIECES`, until the hulls of its parts reach at most `aim` beyond it [m]."""
    done: list[_Part] = []
    left = [_Part(one) for one in _bodies(body)]
    while left:
        worst = max(left, key=lambda part: part.reach)
        left.remove(worst)
        cut = worst.cut() if worst.reach > aim else []
        if cut and len(done) + len(left) + len(cut) <= MOST_PIECES:
            left += cut
        else:
            done.append(worst)
    return done


def _bodies(side: manifold3d.Manifold) -> list[manifold3d.Manifold]:
    """Return the connected bodies of what is on a side of a plane, without what is too thin to be one."""
    found = [one for one in side.decompose() if abs(one.volume()) > _THIN * one.surface_area()]
    # the wall of a cavity is a body of its own for `decompose`, turned inside out
    return [side] if any(one.volume() < 0.0 for one in found) else found


class _Part:
    """A part of the body, and how far its hull reaches beyond it [m]."""

    def __init__(self, body: manifold3d.Manifold):
        self.body = body
        self.vertices, triangles = mesh_of(body)
        hull = ConvexHull(self.vertices)
        self.corners = hull.points[hull.vertices]
        self._middles, normals, self._areas = _faces(self.vertices, triangles)
        fine = mesh_of(body.refine_to_length(_FINE * float(np.ptp(self.vertices, axis=0).max())))
        middles, normals = (self._middles, normals) if len(triangles) > _FACES else _faces(*fine)[:2]
        middles, normals = (every[:: -(-len(every) // _FACES)] for every in (middles, normals))
        # outwards from the middle of a face to where the hull ends; on a face of the hull itself, and of a cut, that is nothing
        planes = np.unique(np.round(hull.equations, 9), axis=0)
        slopes = normals @ planes[:, :3].T
        heights = np.maximum(-(middles @ planes[:, :3].T + planes[:, 3]), 0.0)
        ways = np.where(slopes > 1e-6, heights / np.maximum(slopes, 1e-6), np.inf).min(axis=1)
        worst = int(ways.argmax())
        self.reach = float(ways[worst])
        self._worst = middles[worst], normals[worst]

    def cut(self) -> list[_Part]:
        """Return the parts into which the best plane divides this one; empty: none does."""
        found: list[manifold3d.Manifold] = []
        least = np.inf
        for normal, offset in self._planes():
            sides = [one for side in self.body.split_by_plane(tuple(normal), offset) for one in _bodies(side)]
            volume = round(sum(one.hull().volume() for one in sides), 12)
            if len(sides) > 1 and volume < least:
                found, least = sides, volume
        return [_Part(one) for one in found]

    def _planes(self) -> list[_Plane]:
        """Return planes to try: of the worst face, and across the axes."""
        middle, normal = self._worst
        planes = [(normal, float(normal @ middle))]
        for axis in (*np.eye(3), *self._main_axes()):
            low, high = float((self.vertices @ axis).min()), float((self.vertices @ axis).max())
            planes += [(axis, low + share * (high - low)) for share in _ACROSS] + [(axis, float(axis @ middle))]
        return planes

    def _main_axes(self) -> list[np.ndarray]:
        """Return the axes, besides x, y, z, along which the faces are spread most and least, unless rounding decides on them."""
        weights = self._areas / self._areas.sum()
        away = self._middles - weights @ self._middles
        moments, axes = np.linalg.eigh((away * weights[:, None]).T @ away)
        apart = np.abs(moments[:, None] - moments[None]) + np.diag([np.inf] * 3)
        slanted = np.abs(axes).max(axis=0) < 1.0 - _SAME
        return [axes[:, one] for one in range(3) if slanted[one] and apart[one].min() > _ALIKE * moments[2]]


def _faces(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return middles, shape (t, 3), normals, shape (t, 3), and areas, twice as large, of triangles that have one."""
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    real = areas > 0.0
    return corners[real].mean(axis=1), normals[real] / areas[real, None], areas[real]

"""A mesh that is not convex as convex pieces, for the planner and the simulation alike. Metres."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import manifold3d
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from construction_twin.scene.containment import HELD, excess, extra_volume, farthest_outside, lost
from construction_twin.scene.convex_cells import convex_cells
from construction_twin.scene.solids import mesh_of, parts, solid, union

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
    mesh within 1e-6 m is checked, and how far they reach beyond it is measured.

    Args:
        vertices: Shape (v, 3). [m]
        triangles: Shape (t, 3), integers

    Returns:
        None: the mesh is not closed, or has more than 5,000 triangles.
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

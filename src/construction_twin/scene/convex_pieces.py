"""A mesh that is not convex as convex pieces, for the planner and the simulation alike. Metres."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import manifold3d
import numpy as np

from construction_twin.scene.containment import HELD, excess, extra_volume, farthest_outside, lost
from construction_twin.scene.convex_cells import convex_cells
from construction_twin.scene.convex_cover import convex_cover
from construction_twin.scene.solids import mesh_of, parts, solid, union

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

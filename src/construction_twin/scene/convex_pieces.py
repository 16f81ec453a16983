"""A mesh that is not convex as convex pieces that fill it exactly, for the planner and the simulation alike. Metres."""

from __future__ import annotations

import numpy as np

from construction_twin.scene.containment import extra_volume, lost
from construction_twin.scene.convex_cells import convex_cells
from construction_twin.scene.solids import parts, solid, union

#: Most pieces.
_MOST = 32
#: Triangles beyond which a mesh is not divided: those of curved faces would each be a cut, and that takes seconds.
_MOST_TRIANGLES = 300


def convex_pieces(vertices: np.ndarray, triangles: np.ndarray) -> list[np.ndarray] | None:
    """Return the corners of convex pieces that fill what a mesh encloses, without overlaps; the same mesh gives the same ones.

    That they hold every point of the mesh within 1e-6 m, and have its volume, is checked.

    Args:
        vertices: Shape (v, 3). [m]
        triangles: Shape (t, 3), integers

    Returns:
        Each of shape (k, 3). None: the mesh is not closed, has too many triangles, or would be more than 32 pieces.
    """
    if len(triangles) > _MOST_TRIANGLES:
        return None
    closed = solid(vertices, triangles)
    if closed is None:
        return None
    separate = parts(closed)
    if len(separate) > 1:
        # closed bodies that reach into each other are one
        closed = union(separate)
    pieces = convex_cells(closed, _MOST)
    if pieces is None or extra_volume(closed, pieces) or lost(vertices, triangles, None, pieces):
        return None
    return pieces

"""Triangles of a convex hull, and triangles as coal measures them. Metres; knows no file and no object."""

from __future__ import annotations

from typing import TYPE_CHECKING

import coal
import numpy as np

if TYPE_CHECKING:
    # not loaded here: every node loads this module, and scipy.spatial is tens of MB
    from scipy.spatial import ConvexHull


def hull_mesh(hull: ConvexHull) -> tuple[np.ndarray, np.ndarray]:
    """Return the surface of a hull in space.

    Returns:
        corners: Shape (v, 3). [m]
        triangles: Shape (t, 3), counterclockwise seen from outside.
    """
    used, triangles = np.unique(hull.simplices, return_inverse=True)
    corners, triangles = hull.points[used], triangles.reshape(-1, 3)
    first, second, third = (corners[triangles[:, corner]] for corner in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(second - first, third - first), hull.equations[:, :3]) < 0
    triangles[inwards] = triangles[inwards][:, ::-1]
    return corners, triangles


def surface(vertices: np.ndarray, triangles: np.ndarray) -> coal.BVHModelOBBRSS:
    """Return triangles as a surface without an inside.

    Args:
        vertices: Shape (v, 3). [m]
        triangles: Shape (t, 3), integers
    """
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(triangles), len(vertices))
    mesh.addVertices(np.ascontiguousarray(vertices))
    mesh.addTriangles(np.ascontiguousarray(triangles, dtype=np.int32))
    mesh.endModel()
    return mesh

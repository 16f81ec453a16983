"""Triangles as coal measures them. Metres; knows no file and no object."""

from __future__ import annotations

import coal
import numpy as np


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

"""Triangles as coal measures them. Metres; knows no file and no object."""

from __future__ import annotations

import coal
import numpy as np


def surface(vertices: np.ndarray, triangles: np.ndarray) -> coal.BVHModelOBBRSS:
    """Return triangles as a surface without an inside: vertices, shape (v, 3), and three of them for each, shape (t, 3)."""
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(triangles), len(vertices))
    mesh.addVertices(np.ascontiguousarray(vertices))
    mesh.addTriangles(np.ascontiguousarray(triangles, dtype=np.int32))
    mesh.endModel()
    return mesh

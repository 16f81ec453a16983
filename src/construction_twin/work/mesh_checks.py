"""Whether triangles enclose a volume, and which. Metres; knows no element and mends nothing."""

from __future__ import annotations

import numpy as np


def is_closed(triangles: np.ndarray) -> bool:
    """Return whether each edge of each triangle is met exactly once in the other direction.

    Args:
        triangles: Shape (m, 3). Indices of vertices; vertices at the same place have the same index.
    """
    if len(triangles) == 0:
        return False
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]).astype(np.int64)
    count = int(triangles.max()) + 1
    forward = np.sort(edges[:, 0] * count + edges[:, 1])
    backward = np.sort(edges[:, 1] * count + edges[:, 0])
    return bool((forward[1:] != forward[:-1]).all() and np.array_equal(forward, backward))


def volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    """Return the enclosed volume [m³]; negative when the normals of a closed surface point inwards."""
    if len(triangles) == 0:
        return 0.0
    # around a vertex of its own: far from the origin the products would cancel out
    a, b, c = (vertices[triangles[:, k]] - vertices[triangles[0, 0]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)

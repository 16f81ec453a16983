"""What a URDF's collision shapes contain."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def numbers(element, attribute) -> list[float]:
    return [float(word) for word in element.get(attribute).split()]


def placed(shape) -> tuple:
    """Return a shape's rotation (3, 3) and centre in the link, its kind and its size [m]."""
    origin = shape.find("origin")
    rotation = Rotation.from_euler("xyz", numbers(origin, "rpy")).as_matrix()
    geometry = shape.find("geometry")[0]
    size = (
        numbers(geometry, "size")
        if geometry.tag == "box"
        else [float(geometry.get(key)) for key in ("radius", "length")]
    )
    return rotation, np.array(numbers(origin, "xyz")), geometry.tag, np.array(size)


def contains(kind: str, size: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return which points, in the shape's frame, lie in it or on its surface."""
    if kind == "box":
        return (np.abs(points) <= size / 2 + 1e-9).all(axis=1)
    radius, length = size
    return (np.hypot(points[:, 0], points[:, 1]) <= radius + 1e-9) & (np.abs(points[:, 2]) <= length / 2 + 1e-9)

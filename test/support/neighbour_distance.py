"""Distances to the shapes that another arm sweeps."""

from __future__ import annotations

import coal
import numpy as np


def distance_to(obstacle, point: np.ndarray) -> float:
    """Return how far a point is outside of an obstacle's padded shape [m]."""
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    at = coal.Transform3s(obstacle.placement.rotation, obstacle.placement.translation)
    to = coal.Transform3s(np.eye(3), point)
    found = coal.distance(obstacle.geometry, at, coal.Sphere(1e-6), to, request, result)
    return found - obstacle.padding

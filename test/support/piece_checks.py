"""What convex pieces are compared with, by means of their own: points, unions of bodies, distances. Metres."""

from __future__ import annotations

from collections.abc import Sequence

import coal
import manifold3d
import numpy as np

from construction_twin.scene.convex_pieces import HELD, farthest_outside, surface
from construction_twin.scene.solids import hull_solid, mesh_of, union

#: By how much pieces are made larger before they are compared with the body: faces in one plane but for the last digits.
_APART = 1e-7


def points_on(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the corners of triangles and points of a grid on them, shape (n, 3)."""
    steps = 6 if len(triangles) <= 2000 else 1
    weights = np.array([(a, b, steps - a - b) for a in range(steps + 1) for b in range(steps + 1 - a)]) / steps
    return np.einsum("wc,tcx->twx", weights, vertices[triangles]).reshape(-1, 3)


def lost(body: manifold3d.Manifold, pieces: Sequence[np.ndarray]) -> float:
    """Return how far a body reaches beyond its pieces [m]; 0: they hold it."""
    vertices, triangles = mesh_of(body)
    outside = farthest_outside(points_on(vertices, triangles), pieces)
    middles = [points.mean(axis=0) for points in pieces]
    larger = [m + (points - m) * (1.0 + _APART / np.ptp(points, axis=0).min()) for points, m in zip(pieces, middles)]
    rest = body - union(map(hull_solid, larger))
    if rest.volume() > HELD * body.surface_area():
        outside = max(outside, farthest_outside(mesh_of(rest)[0], pieces), 2.0 * HELD)
    return outside if outside > HELD else 0.0


def distances(points: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the distance of each point from triangles, shape (n,) [m]."""
    mesh, here, radius = surface(vertices, triangles), coal.Transform3s.Identity(), 1e-9
    point, request, found = coal.Sphere(radius), coal.DistanceRequest(), []
    for position in points:
        place = coal.Transform3s(np.eye(3), position)
        found.append(max(coal.distance(point, place, mesh, here, request, coal.DistanceResult()), 0.0) + radius)
    return np.array(found)

"""Whether convex pieces hold all of a body, and how far they reach beyond it. Metres.

Where the body is closed, that it is held is calculated: the body without the pieces has no volume. Where it is not, corners and
points on its triangles are tested. How far the pieces reach is measured at points.
"""

from __future__ import annotations

from collections.abc import Sequence

import coal
import manifold3d
import numpy as np
from scipy.spatial import ConvexHull

from construction_twin.scene.solids import hull_solid, mesh_of, triangle_area, union
from construction_twin.scene.triangle_mesh import surface

#: What lies further outside of all pieces is not held [m]; also the thickness below which a leftover is rounding.
HELD = 1e-6
#: By how much pieces are made larger or smaller before they are compared with the body [m].
_APART = 1e-7
#: Points on each triangle at which a body that is not closed is tested: corners of a grid.
_GRID = 6
#: Points at which what the pieces have more is measured: on its surface, most of them; inside of it along each axis.
_MOST_POINTS, _INSIDE = 4000, 14


def lost(
    vertices: np.ndarray, triangles: np.ndarray, body: manifold3d.Manifold | None, pieces: Sequence[np.ndarray]
) -> float:
    """Return how far a body reaches beyond the pieces [m]; 0: they hold it within 1e-6 m.

    Args:
        vertices: Shape (v, 3). [m]
        triangles: Shape (t, 3), integers
        body: The same as a closed body, if it is one.
        pieces: Each of shape (k, 3). Corners of each.
    """
    outside = farthest_outside(points_on(vertices, triangles), pieces)
    if body is not None:
        rest = body - union(hull_solid(resized(points, _APART)) for points in pieces)
        # a sheet of that thickness over the whole surface is what rounding may leave
        if rest.volume() > HELD * triangle_area(vertices, triangles):
            outside = max(outside, farthest_outside(mesh_of(rest)[0], pieces), 2.0 * HELD)
    return outside if outside > HELD else 0.0


def extra_volume(body: manifold3d.Manifold, pieces: Sequence[np.ndarray]) -> float:
    """Return by how much more volume pieces without overlaps have than a closed body [m^3]; 0: the same, but for rounding.

    Args:
        pieces: Each of shape (k, 3)
    """
    difference = sum(hull_solid(points).volume() for points in pieces) - body.volume()
    return difference if abs(difference) > HELD * body.surface_area() else 0.0


def points_on(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the corners of triangles and points on their edges and faces, shape (n, 3); large meshes: corners and middles."""
    corners = vertices[triangles]
    steps = _GRID if len(triangles) <= 2000 else 1
    weights = [(a, b, steps - a - b) for a in range(steps + 1) for b in range(steps + 1 - a)]
    inner = np.einsum("wc,tcx->twx", np.array(weights) / steps, corners).reshape(-1, 3)
    return np.concatenate([vertices[np.unique(triangles)], inner, corners.mean(axis=1)])


def farthest_outside(points: np.ndarray, pieces: Sequence[np.ndarray]) -> float:
    """Return how far the worst of some points lies outside of the piece that it lies least outside of: at most its distance [m].

    Args:
        points: Shape (n, 3). [m]
        pieces: Each of shape (k, 3). Corners of each.
    """
    least = np.full(len(points), np.inf)
    for planes in (ConvexHull(corners).equations for corners in pieces):
        least = np.minimum(least, (points @ planes[:, :3].T + planes[:, 3]).max(axis=1))
    return float(np.maximum(least, 0.0).max(initial=0.0))


def excess(body: manifold3d.Manifold, pieces: Sequence[np.ndarray]) -> float:
    """Return the largest distance from a closed body of what its pieces have more [m]; a cavity that they fill counts.

    Args:
        pieces: Each of shape (k, 3)
    """
    vertices, triangles = mesh_of(body)
    rounding = HELD * triangle_area(vertices, triangles)
    found = [hull_solid(resized(points, -_APART)) - body for points in pieces]
    more = [rest for rest in found if rest.volume() > rounding / len(pieces)]
    return max((_reach(rest, vertices, triangles) for rest in more), default=0.0)


def resized(points: np.ndarray, by: float) -> np.ndarray:
    """Return corners whose extents along their own main axes are larger by twice a distance, or smaller where it is negative [m].

    manifold3d may give a wrong difference of bodies whose faces lie in one plane but for the last digits (3.5.4: a convex part of a
    body minus the body was the whole part); so the pieces are compared a little larger, or smaller, than they are.
    """
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    axes = np.linalg.svd(points - middle, full_matrices=False)[2]
    local = (points - middle) @ axes.T
    extents = np.ptp(local, axis=0)
    return middle + (local * (1.0 + 2.0 * by / np.maximum(extents, 4.0 * abs(by)))) @ axes


def _reach(more: manifold3d.Manifold, vertices: np.ndarray, triangles: np.ndarray) -> float:
    """Return the largest distance of a body's points from a mesh [m]."""
    points = mesh_of(more)[0]
    size = float(np.ptp(points, axis=0).max())
    length = size / 20.0
    if more.surface_area() / length**2 < _MOST_POINTS:
        points = mesh_of(more.refine_to_length(length))[0]
    points = np.concatenate([points[:: max(len(points) // _MOST_POINTS, 1)], _inside(more)])
    return float(distances(points, vertices, triangles).max(initial=0.0))


def _inside(body: manifold3d.Manifold) -> np.ndarray:
    """Return points of a grid that lie in a body, shape (n, 3)."""
    vertices, triangles = mesh_of(body)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    x, y, z = (np.linspace(a, b, _INSIDE + 2)[1:-1] for a, b in zip(low, high))
    found = []
    for column in [(float(one), float(other)) for one in x for other in y]:
        # along a line of the grid: inside after an odd number of faces
        hits = body.ray_cast((*column, float(low[2]) - 1.0), (*column, float(high[2]) + 1.0))
        if hits:
            heights = np.array([hit.position[2] for hit in hits])
            inside = z[(heights[None, :] < z[:, None]).sum(axis=1) % 2 == 1]
            found.append(np.column_stack([np.tile(column, (len(inside), 1)), inside]))
    return np.concatenate(found) if found else np.empty((0, 3))


def distances(points: np.ndarray, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the distance of each point from triangles, shape (n,) [m]."""
    mesh = surface(vertices, triangles)
    radius = 1e-9
    point, here = coal.Sphere(radius), coal.Transform3s.Identity()
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    found = np.empty(len(points))
    for row, position in enumerate(points):
        result.clear()
        place = coal.Transform3s(np.eye(3), position)
        found[row] = max(coal.distance(point, place, mesh, here, request, result), 0.0) + radius
    return found

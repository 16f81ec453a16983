"""Closed bodies by manifold3d: from triangles, their connected parts, unions. Metres."""

from __future__ import annotations

from collections.abc import Iterable

import manifold3d
import numpy as np

#: Vertices that are closer are one, as a fraction of the body's size.
_WELD = 1e-7


def solid(vertices: np.ndarray, triangles: np.ndarray) -> manifold3d.Manifold | None:
    """Return the closed body of triangles, of which corners at the same place are welded; None if they do not enclose one."""
    vertices, triangles = welded(vertices, triangles)
    if len(triangles) < 4:
        return None
    for order in (triangles, triangles[:, ::-1]):
        mesh = manifold3d.Mesh64(np.ascontiguousarray(vertices), np.ascontiguousarray(order, dtype=np.uint64))
        found = manifold3d.Manifold(mesh)
        if found.status() == manifold3d.Error.NoError and found.volume() > 0:
            return found
    return None


def welded(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and triangles with equal corners merged, without triangles of zero area."""
    size = max(float(np.ptp(vertices, axis=0).max()), 1e-9)
    _, first, merged = np.unique(
        np.round(vertices / (size * _WELD)).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    triangles = merged.reshape(-1)[triangles]
    has_area = (
        (triangles[:, 0] != triangles[:, 1])
        & (triangles[:, 1] != triangles[:, 2])
        & (triangles[:, 2] != triangles[:, 0])
    )
    return np.asarray(vertices, dtype=float)[first], triangles[has_area]


def mesh_of(body: manifold3d.Manifold) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices, shape (v, 3) [m], and triangles, shape (t, 3), of a body."""
    mesh = body.to_mesh64()
    return np.array(mesh.vert_properties)[:, :3], np.array(mesh.tri_verts, dtype=np.int64)


def hull_solid(points: np.ndarray) -> manifold3d.Manifold:
    """Return the convex hull of points as a body; empty if they are flat."""
    return manifold3d.Manifold.hull_points(np.ascontiguousarray(points, dtype=float))


def union(bodies: Iterable[manifold3d.Manifold]) -> manifold3d.Manifold:
    """Return the union of bodies."""
    return manifold3d.Manifold.batch_boolean(list(bodies), manifold3d.OpType.Add)


def parts(body: manifold3d.Manifold) -> list[manifold3d.Manifold]:
    """Return the connected bodies of one, in an order that depends on the body alone; a cavity stays with what encloses it."""
    pieces = [piece for piece in body.decompose() if abs(piece.volume()) > 0]
    if len(pieces) > 1 and any(piece.volume() < 0 for piece in pieces):
        # manifold3d gives the wall of a cavity as a body of its own, turned inside out
        return [body]
    return sorted(pieces, key=lambda piece: tuple(round(value, 6) for value in piece.bounding_box()))

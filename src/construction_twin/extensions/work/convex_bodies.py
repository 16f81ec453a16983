"""The convex pieces of an element as points and planes: for boxes around it, its flat faces, its centre of gravity.

Metres, in the element's frame. The pieces are those of the scene: what is computed here is about the bodies that are checked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from construction_twin.kinematics.chain import Pose
from construction_twin.robot.motion_errors import SceneError
from construction_twin.scene.collision_bodies import is_convex
from construction_twin.scene.mesh_file import parse_mesh
from construction_twin.scene.objects import SceneObject, read_mesh_file
from construction_twin.scene.same_space import BOX, same_points

#: Points further outside of a plane are not on it [m].
ON_PLANE = 1e-5
#: Facets whose normals differ by less are of one face [-, sine].
_PARALLEL = 1e-4
#: Corners of the polygon that stands for a round body.
_ROUND = 32


@dataclass(frozen=True, eq=False)
class Hull:
    """A convex body.

    Attributes:
        points: Shape (v, 3). Its corners.
        planes: Shape (f, 4). Outward normal and offset of each facet: inside where ``normal . x + offset <= 0``.
        volume: [m^3]
        centre: Shape (3,). Of gravity.
    """

    points: np.ndarray
    planes: np.ndarray
    volume: float
    centre: np.ndarray


class Pieces:
    """The pieces of one element, in the element's frame; `objects`: not empty, `link` empty."""

    def __init__(self, objects: Sequence[SceneObject]):
        self.objects = tuple(objects)
        self.hulls = tuple(_hull(item) for item in objects)

    @cached_property
    def solid(self) -> bool:
        """Whether every piece is the closed convex body that it is taken for; a surface, which has no inside, is not."""
        return all(item.shape != "mesh" or _is_solid(item.mesh, item.mesh_digest) for item in self.objects)

    @cached_property
    def points(self) -> np.ndarray:
        """Corners of all pieces, shape (n, 3)."""
        return np.concatenate([hull.points for hull in self.hulls])

    @cached_property
    def centre(self) -> np.ndarray:
        """Centre of gravity of the pieces, all of one density, shape (3,)."""
        volumes = np.array([hull.volume for hull in self.hulls])
        return np.array([hull.centre for hull in self.hulls]).T @ volumes / volumes.sum()

    @cached_property
    def planes(self) -> np.ndarray:
        """The different planes of the facets of all pieces, largest first, shape (p, 4)."""
        found: list[np.ndarray] = []
        for plane in np.concatenate([hull.planes for hull in self.hulls]):
            if not any(
                abs(plane[3] - other[3]) <= ON_PLANE and np.linalg.norm(plane[:3] - other[:3]) <= _PARALLEL
                for other in found
            ):
                found.append(plane)
        return np.array(
            sorted(found, key=lambda plane: (-round(self._extent(plane), 6), *np.round(-plane, 6).tolist()))
        )

    def on(self, plane: np.ndarray) -> np.ndarray:
        """Return the corners that lie on a plane, shape (k, 3)."""
        return self.points[np.abs(self.points @ plane[:3] + plane[3]) <= ON_PLANE]

    def contain(self, points: np.ndarray, slack: float = 1e-6) -> np.ndarray:
        """Return which points lie in one of the pieces, shape (n,)."""
        inside = np.zeros(len(points), dtype=bool)
        for hull in self.hulls:
            inside |= (points @ hull.planes[:, :3].T + hull.planes[:, 3] <= slack).all(axis=1)
        return inside

    def same_turned(self, turn: Pose) -> bool:
        """Return whether a motion maps the pieces onto themselves: every piece's corners onto those of one of them."""
        left = list(self.hulls)
        for hull in self.hulls:
            moved = hull.points @ turn.rotation.T + turn.position
            match = next((other for other in left if same_points(moved, other.points, 1e-4)), None)
            if match is None:
                return False
            left.remove(match)
        return True

    def _extent(self, plane: np.ndarray) -> float:
        points = self.on(plane)
        first = np.ptp(points, axis=0)
        return float(np.prod(np.sort(first)[1:]))


def _hull(item: SceneObject) -> Hull:
    local = _local_hull(item.name if item.mesh else "", item.shape, item.size, item.mesh, item.mesh_digest)
    pose = item.pose
    normals = local.planes[:, :3] @ pose.rotation.T
    return Hull(
        local.points @ pose.rotation.T + pose.position,
        np.column_stack([normals, local.planes[:, 3] - normals @ pose.position]),
        local.volume,
        pose.rotation @ local.centre + pose.position,
    )


@lru_cache(maxsize=4096)
def _local_hull(name: str, shape: str, size: tuple[float, ...], mesh: str, digest: str) -> Hull:
    """Return a piece's hull in its own frame; `digest` is part of the key."""
    try:
        hull = ConvexHull(_corners(name, shape, size, mesh))
    except QhullError as error:
        raise SceneError(f"object {name!r}", shape, "a body that has a volume") from error
    points = hull.points[hull.vertices]
    middle = points.mean(axis=0)
    corners = hull.points[hull.simplices] - middle
    volumes = np.abs(np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6.0
    centre = middle + (corners.sum(axis=1) / 4.0).T @ volumes / volumes.sum()
    planes = np.unique(np.round(hull.equations, 9) + 0.0, axis=0)
    return Hull(points, planes, float(hull.volume), centre)


@lru_cache(maxsize=4096)
def _is_solid(mesh: str, digest: str) -> bool:
    """Return whether a mesh is closed and convex; `digest` is part of the key."""
    vertices, triangles = parse_mesh("mesh", mesh, read_mesh_file("mesh", mesh), (1.0, 1.0, 1.0))
    # an STL file repeats the corners of each triangle
    corners, merged = np.unique(vertices, axis=0, return_inverse=True)
    return is_convex(corners, merged.reshape(-1)[triangles])


def _corners(name: str, shape: str, size: tuple[float, ...], mesh: str) -> np.ndarray:
    if shape == "box":
        return BOX * size
    if shape == "mesh":
        x, y, z = size
        return parse_mesh(f"object {name!r} mesh", mesh, read_mesh_file(name, mesh), (x, y, z))[0]
    angles = np.linspace(0.0, 2.0 * np.pi, _ROUND, endpoint=False)
    if shape == "cylinder":
        radius, length = size
        ring = np.column_stack([radius * np.cos(angles), radius * np.sin(angles)])
        return np.concatenate([np.column_stack([ring, np.full(_ROUND, z)]) for z in (-0.5 * length, 0.5 * length)])
    heights = np.linspace(-1.0, 1.0, 17)
    radii = np.sqrt(1.0 - heights**2)
    return size[0] * np.concatenate(
        [np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(_ROUND, z)])
         for radius, z in zip(radii, heights)]
    )  # fmt: skip

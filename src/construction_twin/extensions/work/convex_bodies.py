"""The convex pieces of an element as points and planes: for boxes around it, its flat faces, its centre of gravity.

Metres, in the element's frame. The pieces are those of the scene: what is computed here is about the bodies that are checked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import coal
import numpy as np
from scipy.spatial import ConvexHull, QhullError

from construction_twin.kinematics.chain import Pose
from construction_twin.robot.motion_errors import SceneError
from construction_twin.scene.collision_bodies import scene_geometry
from construction_twin.scene.mesh_file import parse_mesh
from construction_twin.scene.objects import SceneObject, read_mesh_file
from construction_twin.scene.same_space import BOX, same_points

#: Points further outside of a plane are not on it [m].
ON_PLANE = 1e-5
#: Facets whose normals differ by less are of one face [-, sine].
_PARALLEL = 1e-4


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


class ElementPieces:
    """The pieces of one element, in the element's frame: boxes and meshes, `link` empty."""

    def __init__(self, objects: Sequence[SceneObject]):
        self.objects = tuple(objects)
        self.hulls = tuple(map(_hull, objects))

    @cached_property
    def solid(self) -> bool:
        """Whether every piece is the closed convex body that it is taken for; a surface, which has no inside, is not."""
        return not any(isinstance(scene_geometry(item), coal.BVHModelBase) for item in self.objects)

    @cached_property
    def points(self) -> np.ndarray:
        """Corners of all pieces, shape (n, 3)."""
        return np.concatenate([hull.points for hull in self.hulls])

    @cached_property
    def centre(self) -> np.ndarray:
        """Centre of gravity of the pieces, all of one density, shape (3,)."""
        return np.average([hull.centre for hull in self.hulls], axis=0, weights=[hull.volume for hull in self.hulls])

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
        return float(np.prod(np.sort(np.ptp(self.on(plane), axis=0))[1:]))


@lru_cache(maxsize=4096)
def _hull(item: SceneObject) -> Hull:
    name, (x, y, z) = f"object {item.name!r}", item.size
    if item.mesh:
        corners = parse_mesh(f"{name} mesh", item.mesh, read_mesh_file(item.name, item.mesh), (x, y, z))[0]
    else:
        corners = BOX * item.size
    try:
        hull = ConvexHull(corners @ item.pose.rotation.T + item.pose.position)
    except QhullError as error:
        raise SceneError(name, item.shape, "a body that has a volume") from error
    points = hull.points[hull.vertices]
    middle = points.mean(axis=0)
    # of gravity: that of the tetrahedra between the middle and the facets
    a, b, c = np.moveaxis(hull.points[hull.simplices] - middle, 1, 0)
    volumes = np.abs(np.einsum("ij,ij->i", a, np.cross(b, c)))
    centre = middle + volumes @ (a + b + c) / (4.0 * volumes.sum())
    return Hull(points, np.unique(np.round(hull.equations, 9) + 0.0, axis=0), float(hull.volume), centre)

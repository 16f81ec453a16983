"""Another arm as the objects of another planner (MoveIt): its shapes where it stands, each grown by the distance to keep from it.

A box, cylinder or sphere that is grown holds every point within that distance, and so does a convex mesh, whose faces are moved
outwards. A capsule becomes a cylinder and two spheres. Of a mesh that is not convex the surface is given as it is. Metres.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

import coal
import numpy as np
import pinocchio

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import Sentence
from construction_twin.kinematics.chain import Pose
from construction_twin.scene.collision_bodies import mesh_triangles
from construction_twin.scene.neighbour import Obstacle
from construction_twin.scene.planner_scene import PlannerObject


def neighbour_objects(obstacles: Iterable[Obstacle], root: str, margin: float) -> tuple[PlannerObject, ...]:
    """Return obstacles as another planner's objects, whose names are the same for the same arm at another pose.

    Args:
        obstacles: In the root of our robot's URDF.
        root: That link.
        margin: Distance to keep from them, besides their own padding [m].

    Returns:
        Called as their owners; a second part of one is called ``<owner> 2``.
    """
    parts: Counter[str] = Counter()
    objects = []
    for obstacle in obstacles:
        for shape, dimensions, mesh, offset in _shapes(obstacle.geometry, obstacle.padding + margin):
            parts[obstacle.owner] += 1
            count = parts[obstacle.owner]
            place = obstacle.placement * pinocchio.SE3(np.eye(3), offset)
            objects.append(
                PlannerObject(
                    obstacle.owner if count == 1 else f"{obstacle.owner} {count}",
                    shape,
                    dimensions,
                    *mesh,
                    root,
                    Pose(place.translation.copy(), place.rotation.copy()),
                    False,
                    (),
                )
            )
    return tuple(objects)


_Mesh = tuple[np.ndarray, np.ndarray]
_NO_MESH: _Mesh = (np.empty((0, 3)), np.empty((0, 3), dtype=int))


def _shapes(geometry: coal.CollisionGeometry, margin: float) -> list[tuple[str, tuple[float, ...], _Mesh, np.ndarray]]:
    """Return shape, dimensions, mesh and centre of each part of a body, grown."""
    centre = np.zeros(3)
    if isinstance(geometry, coal.Box):
        return [("box", tuple((2.0 * (np.asarray(geometry.halfSide) + margin)).tolist()), _NO_MESH, centre)]
    if isinstance(geometry, coal.Sphere):
        return [("sphere", (geometry.radius + margin,), _NO_MESH, centre)]
    if isinstance(geometry, coal.Cylinder):
        size = (geometry.radius + margin, 2.0 * (geometry.halfLength + margin))
        return [("cylinder", size, _NO_MESH, centre)]
    if isinstance(geometry, coal.Capsule):
        radius, end = geometry.radius + margin, np.array([0.0, 0.0, geometry.halfLength])
        between = ("cylinder", (radius, 2.0 * geometry.halfLength), _NO_MESH, centre)
        return [between, *(("sphere", (radius,), _NO_MESH, side * end) for side in (1.0, -1.0))]
    if isinstance(geometry, coal.ConvexBase):
        return [("mesh", (), _grown(np.asarray(geometry.points()), margin), centre)]
    if isinstance(geometry, coal.BVHModelBase):
        return [("mesh", (), mesh_triangles(geometry), centre)]
    expected = Sentence("expected.scene.neighbour_shapes")
    raise ConfigurationError("URDF collision shape", type(geometry).__name__, expected)


def _grown(points: np.ndarray, margin: float) -> _Mesh:
    """Return the convex body of points with every face moved outwards: it holds each point that is within the margin."""
    # loaded when a hull is grown: the node `scene` loads this module, and begins sooner by a quarter of a second
    from scipy.spatial import ConvexHull, HalfspaceIntersection

    planes = ConvexHull(points).equations.copy()
    planes[:, -1] -= margin
    hull = ConvexHull(HalfspaceIntersection(planes, points.mean(axis=0)).intersections)
    corners = {int(index): number for number, index in enumerate(hull.vertices)}
    vertices = hull.points[hull.vertices]
    triangles = np.array([[corners[int(index)] for index in row] for row in hull.simplices])
    # Qhull does not order the corners; seen from outside they go around counter-clockwise
    first, second, third = (vertices[triangles[:, corner]] for corner in range(3))
    inwards = np.einsum("ij,ij->i", np.cross(second - first, third - first), hull.equations[:, :3]) < 0.0
    triangles[inwards] = triangles[inwards][:, ::-1]
    return vertices, triangles

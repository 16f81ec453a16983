"""Whether two objects fill the same space: a symmetric body that was turned onto itself is where it was. Metres."""

from __future__ import annotations

import numpy as np

from construction_twin.kinematics.chain import Pose
from construction_twin.scene.mesh_file import parse_mesh
from construction_twin.scene.objects import SceneObject, read_mesh_file

#: Corners of a box whose edges are 1 long, about its middle.
BOX = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


def fills_same_space(
    one: SceneObject, world_T_one: Pose, other: SceneObject, world_T_other: Pose, slack: float
) -> bool:
    """Return whether two convex objects fill the same space: every corner of each has one of the other within `slack` [m].

    Of round bodies these are the ends of the axis; meshes count as the hulls of their corners.
    """
    if _kind(one) != _kind(other):
        return False
    return same_points(_points(one, world_T_one), _points(other, world_T_other), slack)


def same_points(first: np.ndarray, second: np.ndarray, slack: float) -> bool:
    """Return whether every point of two sets, shapes (n, 3) and (m, 3), has one of the other set within a distance [m]."""
    distances = np.linalg.norm(first[:, None] - second[None], axis=2)
    return bool(distances.min(axis=1).max() <= slack and distances.min(axis=0).max() <= slack)


def _kind(item: SceneObject) -> tuple:
    """Return what two objects must have in common so that their points say the rest."""
    return (item.shape, item.size) if item.shape in ("cylinder", "sphere") else ("corners",)


def _points(item: SceneObject, world_T_item: Pose) -> np.ndarray:
    if item.shape == "box":
        local = BOX * item.size
    elif item.shape == "cylinder":
        local = np.array([(0.0, 0.0, -0.5), (0.0, 0.0, 0.5)]) * item.size[1]
    elif item.shape == "sphere":
        local = np.zeros((1, 3))
    else:
        x, y, z = item.size
        corners = parse_mesh(f"object {item.name!r} mesh", item.mesh, read_mesh_file(item.name, item.mesh), (x, y, z))
        local = np.unique(corners[0], axis=0)
    return local @ world_T_item.rotation.T + world_T_item.position

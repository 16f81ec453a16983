"""Which bodies are prisms: a profile that runs along a direction. Metres."""

from __future__ import annotations

import numpy as np
import shapely

from construction_twin.scene.solids import welded

#: Distance within which a corner lies in a plane [m].
_ON = 1e-6
#: Directions of each kind that are tried to see whether a body is a prism.
_PRISM_DIRECTIONS = 4


def prism(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, shapely.Geometry, float] | None:
    """Return what a body is if all its sides are parallel to one direction and its two ends lie across it: a wall with its windows.

    Args:
        vertices: Shape (v, 3). [m]
        triangles: Shape (t, 3), integers

    Returns:
        element_T_profile: Shape (4, 4). Its z axis is the direction, its origin lies in the lower end.
        profile: In the x, y plane.
        depth: [m]
    """
    vertices, triangles = welded(vertices, triangles)
    first, second, third = (vertices[triangles[:, corner]] for corner in range(3))
    normals = np.cross(second - first, third - first)
    areas = np.linalg.norm(normals, axis=1)
    real = areas > 1e-12 * max(float(areas.max(initial=0.0)), 1e-12)
    normals = normals[real] / areas[real, None]
    faces, areas = triangles[real], areas[real]
    for axis in _axes(normals, areas):
        same = np.abs(normals @ axis)
        caps = same > 1.0 - 1e-9
        if not (caps | (same < 1e-6)).all():
            continue
        heights = vertices @ axis
        low, high = float(heights.min()), float(heights.max())
        if not ((heights - low <= _ON) | (high - heights <= _ON)).all():
            continue
        frame = np.eye(4)
        frame[:3, :3] = across(axis)
        frame[:3, 3] = axis * low
        flat = (vertices - frame[:3, 3]) @ frame[:3, :3]
        ends = []
        for level in (low, high):
            mine = faces[caps][np.abs(heights[faces[caps]] - level).max(axis=1) <= _ON]
            corners = flat[mine][:, :, :2]
            ends.append(shapely.union_all(shapely.polygons(corners)) if len(corners) else shapely.Polygon())
        if shapely.symmetric_difference(*ends).area > _ON * (ends[0].length + _ON) or not ends[0].area > 0:
            continue
        sides = float(areas[~caps].sum()) / 2.0
        if abs(sides - ends[0].length * (high - low)) > 1e-6 * sides:
            # a side is missing, or there twice
            continue
        return frame, ends[0], high - low
    return None


def _axes(normals: np.ndarray, areas: np.ndarray) -> list[np.ndarray]:
    """Return directions along which a body may be a prism: of many triangles, of much area, and across two large faces."""
    keys = np.round(normals, 6) + 0.0
    keys[(keys < 0).sum(axis=1) > (keys > 0).sum(axis=1)] *= -1.0
    _, first, group, count = np.unique(keys + 0.0, axis=0, return_index=True, return_inverse=True, return_counts=True)
    area = np.round(np.bincount(group.reshape(-1), areas), 9)
    by_count, by_area = np.argsort(-count, kind="stable"), np.argsort(-area, kind="stable")
    wanted = [normals[first[number]] for number in (*by_count[:_PRISM_DIRECTIONS], *by_area[:_PRISM_DIRECTIONS])]
    for other in by_area[1:]:
        between = np.cross(normals[first[by_area[0]]], normals[first[other]])
        if np.linalg.norm(between) > 0.1:
            wanted.append(between / np.linalg.norm(between))
            break
    axes: list[np.ndarray] = []
    for axis in wanted:
        if all(abs(axis @ one) < 1.0 - 1e-9 for one in axes):
            largest = int(np.argmax(np.round(np.abs(axis), 9)))
            axes.append(axis if axis[largest] > 0 else -axis)
    return axes


def across(axis: np.ndarray) -> np.ndarray:
    """Return a rotation whose z axis is a unit vector; its x axis is as near as possible to an axis of the frame."""
    start = np.eye(3)[int(np.argmin(np.round(np.abs(axis), 9)))]
    x = start - (start @ axis) * axis
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(axis, x), axis])

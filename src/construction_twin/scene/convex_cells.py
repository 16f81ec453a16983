"""A closed body divided exactly into convex ones by planes of its own faces. Metres.

The body is cut by manifold3d along the largest face that passes through its inside, and so is each part, until every part is
convex; neighbours whose union is convex are joined again.
"""

from __future__ import annotations

import manifold3d
import numpy as np
from scipy.spatial import ConvexHull

from construction_twin.scene.solids import mesh_of

#: Distance from a plane within which a point lies on it [m].
_ON = 1e-8
#: A part is convex when its hull has no more volume than this fraction.
_SAME = 1e-9


def convex_cells(body: manifold3d.Manifold, most: int) -> list[np.ndarray] | None:
    """Return the corners of convex bodies that fill a closed body without overlaps.

    Returns:
        Each of shape (k, 3). None: there would be more than `most`.
    """
    waiting = [body]
    kept: list[np.ndarray] = []
    while waiting:
        part = waiting.pop()
        corners, triangles = mesh_of(part)
        if part.volume() <= _ON * part.surface_area():
            continue
        hull = part.hull()
        if hull.volume() - part.volume() <= _SAME * hull.volume():
            kept.append(mesh_of(hull)[0])
            continue
        plane = _largest_within(corners, triangles)
        if plane is None or len(kept) + len(waiting) > 8 * most:
            return None
        waiting += part.split_by_plane(tuple(plane[:3]), float(plane[3]))
    cells = _joined(kept)
    return sorted(cells, key=lambda cell: np.round(cell.min(axis=0), 6).tolist()) if 0 < len(cells) <= most else None


def _largest_within(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray | None:
    """Return normal and offset of the plane with most area of faces, of those that have the body on both sides."""
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    found, most = None, 0.0
    left = areas > 0
    for row in np.argsort(-np.round(areas, 12), kind="stable"):
        if not left[row]:
            continue
        normal = normals[row] / areas[row]
        heights = (vertices - corners[row, 0]) @ normal
        mine = left & (np.abs(heights[triangles]).max(axis=1) <= _ON)
        left &= ~mine
        left[row] = False
        area = round(float(areas[mine].sum()), 9)
        if heights.max() > _ON and heights.min() < -_ON and area > most:
            found, most = np.array((*normal, normal @ corners[row, 0])), area
    return found


def _joined(cells: list[np.ndarray]) -> list[np.ndarray]:
    """Join two bodies whose union is convex, until there are none."""
    alive = dict(enumerate(cells))
    volumes = {number: float(ConvexHull(cell).volume) for number, cell in alive.items()}
    queue = [(one, other) for one in alive for other in alive if one < other]
    while queue:
        left: list[tuple[int, int]] = []
        for one, other in queue:
            if one not in alive or other not in alive or not _near(alive[one], alive[other]):
                continue
            hull = ConvexHull(np.concatenate([alive[one], alive[other]]))
            volume = volumes[one] + volumes[other]
            if hull.volume - volume > _SAME * volume:
                continue
            number = max(volumes) + 1
            del alive[one], alive[other]
            left += [(near, number) for near in alive]
            alive[number], volumes[number] = hull.points[hull.vertices], float(hull.volume)
        queue = left
    return list(alive.values())


def _near(one: np.ndarray, other: np.ndarray) -> bool:
    return bool(
        (one.min(axis=0) <= other.max(axis=0) + _ON).all() and (other.min(axis=0) <= one.max(axis=0) + _ON).all()
    )

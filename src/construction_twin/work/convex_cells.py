"""A closed body divided exactly into convex ones by planes of its own faces. Metres.

The body's box is cut along faces until no face passes through the inside of any part; parts inside of the body are kept, and
neighbours whose union is convex are joined. Points decide, not edges: the corners of a part that is cut are those on one side, and
where the lines between corners of both sides meet the plane.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import ConvexHull, QhullError

#: Distance from a plane within which a point lies on it [m].
_ON = 1e-8
#: A union is convex when its hull has no more volume than this fraction.
_SAME = 1e-9


def convex_cells(vertices: np.ndarray, triangles: np.ndarray, most: int) -> list[np.ndarray] | None:
    """Return the corners of convex bodies that fill a closed body without overlaps.

    Args:
        vertices: Shape (v, 3). [m]
        triangles: Shape (t, 3), integers. Of a closed surface.
        most: Bodies.

    Returns:
        Each of shape (k, 3). None: there would be more than `most`.
    """
    corners = vertices[triangles]
    planes = _planes(corners)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    box = np.array([(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    waiting = [(box, list(zip(planes, corners)))]
    kept: list[np.ndarray] = []
    leaves = 0
    while waiting:
        cell, faces = waiting.pop()
        if not faces:
            leaves += 1
            if _winds(cell.mean(axis=0), corners):
                kept.append(cell)
            continue
        if leaves + len(waiting) > 8 * most:
            return None
        plane = _best(faces)
        for sign in (1.0, -1.0):
            part = _part(cell, sign * plane)
            if part is not None:
                waiting.append((part, _faces(faces, sign * plane)))
    cells = _joined(kept)
    return sorted(cells, key=lambda cell: np.round(cell.min(axis=0), 6).tolist()) if 0 < len(cells) <= most else None


def _planes(corners: np.ndarray) -> np.ndarray:
    """Return normal and offset of each triangle's plane, shape (t, 4); of those in one plane, that of the largest."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    planes = np.column_stack([normals, -np.einsum("ij,ij->i", normals, corners[:, 0])])
    found = np.zeros_like(planes)
    left = np.ones(len(planes), dtype=bool)
    for row in np.argsort(-np.round(lengths[:, 0], 12), kind="stable"):
        if left[row]:
            near = left & (np.abs(corners @ planes[row, :3] + planes[row, 3]).max(axis=1) <= _ON)
            found[near] = planes[row]
            left &= ~near
            found[row], left[row] = planes[row], False
    return found


def _best(faces: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Return the plane in which most area of the faces lies."""
    areas: dict[bytes, list] = {}
    for plane, polygon in faces:
        area = np.linalg.norm(np.cross(polygon[1:-1] - polygon[0], polygon[2:] - polygon[0]).sum(axis=0))
        areas.setdefault(plane.tobytes(), [plane, 0.0])[1] += float(area)
    return max(areas.values(), key=lambda one: round(one[1], 9))[0]


def _faces(faces: Sequence[tuple[np.ndarray, np.ndarray]], plane: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return what of polygons lies below a plane, without those in it."""
    found = []
    for own, polygon in faces:
        heights = polygon @ plane[:3] + plane[3]
        if heights.min() >= -_ON:
            continue
        if heights.max() > _ON:
            points = []
            for here, there, a, b in zip(polygon, np.roll(polygon, -1, axis=0), heights, np.roll(heights, -1)):
                if a <= _ON:
                    points.append(here)
                if (a < -_ON and b > _ON) or (a > _ON and b < -_ON):
                    points.append(here + (there - here) * (a / (a - b)))
            polygon = np.array(points)
        if len(polygon) >= 3:
            found.append((own, polygon))
    return found


def _part(cell: np.ndarray, plane: np.ndarray) -> np.ndarray | None:
    """Return the corners of what of a convex body lies below a plane; None if that has no volume."""
    heights = cell @ plane[:3] + plane[3]
    if heights.max() <= _ON:
        return cell
    if heights.min() >= -_ON:
        return None
    below, above = heights < -_ON, heights > _ON
    first, second = cell[below], cell[above]
    a, b = heights[below], heights[above]
    share = a[:, None] / (a[:, None] - b[None])
    between = first[:, None] + (second[None] - first[:, None]) * share[..., None]
    points = np.concatenate([cell[~above], between.reshape(-1, 3)])
    try:
        hull = ConvexHull(points)
    except QhullError:
        return None
    return points[hull.vertices] if hull.volume > _ON * hull.area else None


def _winds(point: np.ndarray, corners: np.ndarray) -> bool:
    """Return whether a point lies inside: the solid angle of all triangles is 4 pi there, 0 outside."""
    a, b, c = (corners[:, number] - point for number in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    triple = np.einsum("ij,ij->i", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("ij,ij->i", one, other) for one, other in ((a, b), (b, c), (c, a)))
    return bool(abs(2.0 * np.arctan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb).sum()) > 2.0 * np.pi)


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

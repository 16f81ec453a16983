"""A flat outline with holes, divided exactly into few convex polygons. Triangulation and areas are shapely's. Metres."""

from __future__ import annotations

import numpy as np
import shapely

from construction_twin.core.sentences import Sentence
from construction_twin.core.work_errors import WorkError

#: Areas that differ by less than this fraction are one.
_SAME = 1e-10
#: Corners beyond which an outline is not one that anybody drew by hand; what is divided by directions of its edges.
_MOST_CORNERS, _FEW_CORNERS = 4000, 60
#: Directions of edges along which an outline is cut in strips to see which division is smallest.
_DIRECTIONS = 4


def convex_polygons(outline: np.ndarray, holes: tuple[np.ndarray, ...] = ()) -> list[np.ndarray]:
    """Return convex polygons that cover an outline without its holes, and nothing else.

    Of several ways to divide it the one with the fewest polygons is taken, with most rectangles among those.

    Args:
        outline: Shape (k, 2)
        holes: Each of shape (k, 2)

    Returns:
        Each of shape (k, 2). Counterclockwise, the first corner not repeated. Their corners are those of the outline and, where it
        was cut in strips, points on its edges.
    """
    whole = shapely.Polygon(outline, holes)
    if not whole.is_valid or not whole.area > 0:
        raise WorkError(
            Sentence(
                "work.outline.crosses",
                corners=len(outline),
                holes=len(holes),
                found=str(shapely.is_valid_reason(whole)),
                area=whole.area,
            )
        )
    if _is_convex(whole):
        return [_corners(whole)]
    corners = len(outline) + sum(map(len, holes))
    if corners > _MOST_CORNERS:
        raise WorkError(Sentence("work.outline.corners", corners=corners, most=_MOST_CORNERS))
    divisions = [_merged(list(shapely.constrained_delaunay_triangles(whole).geoms))]
    if corners <= _FEW_CORNERS:
        divisions += [_merged(_strips(whole, direction)) for direction in _edge_directions(whole)]
    # the triangles are exact: strips must cover as much, and a line that misses a corner by its last digit leaves a sliver
    divisions = [
        parts
        for parts in divisions
        if abs(sum(part.area for part in parts) - whole.area) <= _SAME * whole.area and all(map(_is_convex, parts))
    ]
    best = min(divisions, key=lambda parts: (len(parts), -sum(_is_rectangle(part) for part in parts)))
    return sorted((_corners(part) for part in best), key=lambda corners: corners.min(axis=0).tolist())


def _is_convex(part: shapely.Polygon) -> bool:
    return not len(part.interiors) and part.convex_hull.area - part.area <= _SAME * part.area


def _is_rectangle(part: shapely.Polygon) -> bool:
    return part.minimum_rotated_rectangle.area - part.area <= _SAME * part.area


def _corners(part: shapely.Polygon) -> np.ndarray:
    hull = part.convex_hull
    return np.array(shapely.orient_polygons(hull).exterior.coords)[:-1]


def _edge_directions(whole: shapely.Polygon) -> list[np.ndarray]:
    """Return unit vectors of the longest edges and across them, without those that are nearly another one."""
    edges = np.concatenate([np.diff(np.array(ring.coords), axis=0) for ring in (whole.exterior, *whole.interiors)])
    edges = edges[np.argsort(-np.round(np.linalg.norm(edges, axis=1), 9), kind="stable")]
    found: list[np.ndarray] = []
    for edge in edges:
        unit = edge / np.linalg.norm(edge)
        for one in (unit, np.array((-unit[1], unit[0]))):
            if len(found) < _DIRECTIONS and all(abs(one[0] * two[1] - one[1] * two[0]) > 1e-6 for two in found):
                found.append(one)
    return found


def _strips(whole: shapely.Polygon, direction: np.ndarray) -> list[shapely.Polygon]:
    """Return the parts between lines along a direction through all corners at which the outline turns inwards."""
    across = np.array((-direction[1], direction[0]))
    levels = np.unique(np.round([corner @ across for corner in _inward_corners(whole)], 12))
    points = np.array(whole.exterior.coords)
    along, out = points @ direction, points @ across
    bounds = [out.min() - 1.0, *levels, out.max() + 1.0]
    ends = np.array((along.min() - 1.0, along.max() + 1.0))
    parts: list[shapely.Polygon] = []
    for low, high in zip(bounds, bounds[1:]):
        box = [ends[one] * direction + level * across for one, level in ((0, low), (1, low), (1, high), (0, high))]
        cut = shapely.intersection(whole, shapely.Polygon(box))
        parts += [
            part for part in shapely.get_parts(cut) if part.geom_type == "Polygon" and part.area > _SAME * whole.area
        ]
    return parts


def _inward_corners(whole: shapely.Polygon) -> list[np.ndarray]:
    found = []
    oriented = shapely.orient_polygons(whole)
    for ring in (oriented.exterior, *oriented.interiors):
        points = np.array(ring.coords)[:-1]
        before, after = points - np.roll(points, 1, axis=0), np.roll(points, -1, axis=0) - points
        turn = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        found += list(points[turn < 0])
    return found


def _merged(parts: list[shapely.Polygon]) -> list[shapely.Polygon]:
    """Join two neighbours whose union is convex, those with the longest border first, until there are none."""
    alive: dict[int, shapely.Polygon] = dict(enumerate(parts))
    tree = shapely.STRtree(parts)
    first, second = tree.query(parts, predicate="touches")
    neighbours: dict[int, set[int]] = {number: set() for number in alive}
    for one, other in zip(first.tolist(), second.tolist()):
        neighbours[one].add(other)
    # parts that only share a corner are tried too: their hull is larger than both
    pairs = [(one, other) for one in neighbours for other in neighbours[one] if one < other]
    queue = sorted(pairs, key=lambda pair: (-round(_border(alive[pair[0]], alive[pair[1]]), 9), pair))
    while queue:
        left: list[tuple[int, int]] = []
        for one, other in queue:
            if one not in alive or other not in alive:
                continue
            hull = shapely.convex_hull(shapely.union(alive[one], alive[other]))
            area = alive[one].area + alive[other].area
            if hull.area - area > _SAME * area:
                continue
            number = max(neighbours) + 1
            neighbours[number] = (neighbours[one] | neighbours[other]) - {one, other}
            del alive[one], alive[other]
            alive[number] = hull
            for near in neighbours[number]:
                neighbours[near].add(number)
            left += [(near, number) for near in sorted(neighbours[number]) if near in alive]
        queue = left
    return list(alive.values())


def _border(one: shapely.Polygon, other: shapely.Polygon) -> float:
    return float(shapely.intersection(one, other).length)

"""Ways found before, tried before a search begins.

A cell has few ways round what stands in it, and one request resembles the next: over the rack, through the window, back. The inner
points of the last paths are kept, and a request is first answered by one of them, from its own start and to its own goal, if that
is free now. Nothing is taken for granted: every edge is checked in the world of the request, so it does not matter in which scene a
path was found.

What comes out depends on what was asked before. So a planner whose seed is fixed, whose plans must be the same each time, does
without (`planner.Planner`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from construction_twin.core.motion_errors import NoPathError
from construction_twin.planning.motion_validator import MotionValidator
from construction_twin.planning.path_search import PathQuery, PathSearch
from construction_twin.planning.path_shortening import shortened

#: Paths that are kept, each good for both directions.
KEPT = 64
#: Ways that are tried for a request, the shortest first: each costs about a hundredth of a search.
TRIED = 16
#: A way is tried that is at most so many times as long as the straight line, or as the path that it comes of: instead of a longer
#: one a search finds a shorter one.
DETOUR, AS_LONG = 1.5, 1.1
#: Points that differ by no more than this in any joint are much the same [rad] or [m].
SAME = 0.1
#: Most ways do not fit: they are checked with steps so many times as long, and the one that fits as asked.
COARSER = 4.0


@dataclass(frozen=True, eq=False)
class Remembered:
    """A path that came of an earlier one.

    Attributes:
        path: As `path_search.PathSearch.find` returns it.
        kept: The points of the earlier one that it was made of, as its memory has them.
    """

    path: np.ndarray
    kept: np.ndarray


@dataclass(frozen=True, eq=False)
class _Kept:
    """The points of a path between its ends, with what every search asks of them.

    Attributes:
        points: Shape (m, n). m >= 1
        length: Of the whole path.
        inner_length: Of the path along the points.
        lowest, highest: Shape (n,). Of the points.
    """

    points: np.ndarray
    length: float
    inner_length: float
    lowest: np.ndarray
    highest: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray, length: float) -> _Kept:
        """Return what is kept of the inner points of a path that is so long."""
        return cls(points, length, _length(points), points.min(axis=0), points.max(axis=0))


class PathMemory:
    """The inner points of the last paths of one robot, in both directions. Not for use from several threads at once."""

    def __init__(self) -> None:
        # the oldest first, one that is found again is the newest
        self._inner: dict[bytes, _Kept] = {}

    def keep(self, path: np.ndarray) -> None:
        """Keep a path; a straight line has nothing to keep.

        Args:
            path: Shape (m, n). m >= 2
        """
        self._refresh(path[1:-1], _length(path))

    def served(self, found: Remembered) -> None:
        """Note that what was found became a plan: it is kept, too, unless it is much the same as what it came of."""
        inner, kept = found.path[1:-1], found.kept
        self._refresh(kept, self._inner[kept.tobytes()].length)
        if inner.shape != kept.shape or np.abs(inner - kept).max() > SAME:
            self.keep(found.path)

    def forget(self, found: Remembered) -> None:
        """Forget a path of which no plan came, so that the next request does not try it first."""
        for inner in (found.kept, found.kept[::-1]):
            self._inner.pop(inner.tobytes(), None)

    def _refresh(self, inner: np.ndarray, length: float) -> None:
        for points in (inner, inner[::-1]) if len(inner) else ():
            self._inner.pop(points.tobytes(), None)
            self._inner[points.tobytes()] = _Kept.of(points, length)
        while len(self._inner) > 2 * KEPT:
            del self._inner[next(iter(self._inner))]

    def find(self, query: PathQuery, search: PathSearch, budget: float) -> Remembered | None:
        """Return a path through points of an earlier one; None if none fits.

        Where the straight edge to one of the ends is blocked, a way to there is sought: easier than one to the other end.

        Args:
            search: For the way to one end.
            budget: For it [s].
        """
        coarse = query.validator.coarser(COARSER)
        part: tuple[np.ndarray, bool] | None = None
        for way in self._ways(query):
            # kept points are checked first, the ends are free
            begins, ends = coarse.free(way[0], way[1]), coarse.free(way[-1], way[-2])
            if begins and ends and self._inner_free(way, coarse):
                path = _shortened(way, query)
                if path is not None:
                    return Remembered(path, way[1:-1])
            elif begins != ends and part is None and self._inner_free(way, coarse):
                part = way, begins
        if part is None:
            return None
        way, begins = part
        between = (way[-2], way[-1]) if begins else (way[0], way[1])
        try:
            found = search.find(dataclasses.replace(query, start=between[0], goals=[between[1]]), budget)
        except NoPathError:
            return None
        path = _shortened(np.vstack((way[:-2], found) if begins else (found, way[2:])), query)
        return None if path is None else Remembered(path, way[1:-1])

    def _inner_free(self, way: np.ndarray, coarse: MotionValidator) -> bool:
        """Return whether the points between the ends are free, and the edges between them: they were, once."""
        return coarse.world.is_free(way[1]) and all(coarse.free(*edge) for edge in zip(way[1:-2], way[2:-1]))

    def _ways(self, query: PathQuery) -> Iterator[np.ndarray]:
        """Yield paths from the start to one of the goals through kept points, the shortest first, at most `TRIED`."""
        if not self._inner:
            return
        ways = list(self._inner.values())
        low, high = np.array([way.lowest for way in ways]), np.array([way.highest for way in ways])
        inside = np.flatnonzero(np.all(low >= query.lower, axis=1) & np.all(high <= query.upper, axis=1)).tolist()
        if not inside:
            return
        kept = [ways[index] for index in inside]
        begins, ends = np.array([way.points[0] for way in kept]), np.array([way.points[-1] for way in kept])
        to_begin = np.linalg.norm(begins - query.start, axis=1) + np.array([way.inner_length for way in kept])
        targets = np.array(query.goals)
        lengths = to_begin + np.linalg.norm(targets[:, None] - ends, axis=2)
        straight = np.linalg.norm(targets - query.start, axis=1)[:, None]
        lengths[lengths > np.maximum(DETOUR * straight, [AS_LONG * way.length for way in kept])] = np.inf
        for index in np.argsort(lengths, axis=None, kind="stable")[:TRIED].tolist():
            goal, way = divmod(index, len(kept))
            if lengths[goal, way] == np.inf:
                return
            yield np.vstack((query.start, kept[way].points, query.goals[goal]))


def _shortened(way: np.ndarray, query: PathQuery) -> np.ndarray | None:
    """Return a way whose edges were checked coarsely, shortened; None where the query's own check finds a contact."""
    check = query.validator.shortcuts
    path = shortened(way, check.first_free)
    return path if all(check.free(*edge) for edge in zip(path, path[1:])) else None


def _length(path: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())

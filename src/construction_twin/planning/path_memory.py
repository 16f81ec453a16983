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
from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np

from construction_twin.core.motion_errors import NoPathError
from construction_twin.planning.motion_validator import MotionValidator, ShortcutCheck
from construction_twin.planning.path_search import PathQuery, PathSearch
from construction_twin.planning.path_shortening import shortened

#: Paths that are kept, each good for both directions.
KEPT = 64
#: Ways that are tried for a request, the shortest first: each costs about a hundredth of a search.
TRIED = 16
#: A way that is so many times longer than the straight line is not tried: a search finds shorter ones.
DETOUR = 1.5
#: Most ways do not fit: they are checked with steps so many times as long, and the one that fits as asked.
COARSER = 4.0


class PathMemory:
    """The inner points of the last paths of one robot."""

    def __init__(self) -> None:
        self._inner: deque[np.ndarray] = deque(maxlen=2 * KEPT)

    def keep(self, path: np.ndarray) -> None:
        """Keep a path; a straight line has nothing to keep.

        Args:
            path: Shape (m, n). m >= 2
        """
        if len(path) > 2:
            self._inner.append(path[1:-1])
            self._inner.append(path[-2:0:-1])

    def find(self, query: PathQuery, search: PathSearch, budget: float) -> np.ndarray | None:
        """Return a path through points of an earlier one, as `path_search.PathSearch.find` would; None if none fits.

        Where the straight edge to one of the ends is blocked, a way to there is sought: easier than one to the other end.

        Args:
            search: For the way to one end.
            budget: For it [s].
        """
        coarse = query.validator.coarser(COARSER)
        part: tuple[np.ndarray, bool] | None = None
        for way in self._ways(query.start, query.goals):
            # kept points are checked first, the ends are free
            begins, ends = coarse.free(way[0], way[1]), coarse.free(way[-1], way[-2])
            if begins and ends and self._inner_free(way, coarse):
                path = _shortened(way, query)
                if path is not None:
                    return path
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
        return _shortened(np.vstack((way[:-2], found) if begins else (found, way[2:])), query)

    def _inner_free(self, way: np.ndarray, coarse: MotionValidator) -> bool:
        """Return whether the points between the ends are free, and the edges between them: they were, once."""
        return coarse.world.is_free(way[1]) and all(coarse.free(*edge) for edge in zip(way[1:-2], way[2:-1]))

    def _ways(self, start: np.ndarray, goals: Sequence[np.ndarray]) -> Iterator[np.ndarray]:
        """Yield paths from a start to one of the goals through kept points, the shortest first, at most `TRIED`.

        Args:
            start: Shape (n,).
            goals: Each of shape (n,).
        """
        if not self._inner:
            return
        begins, ends = np.array([inner[0] for inner in self._inner]), np.array([inner[-1] for inner in self._inner])
        between = np.array([float(np.linalg.norm(np.diff(inner, axis=0), axis=1).sum()) for inner in self._inner])
        to_begin = np.linalg.norm(begins - start, axis=1) + between
        targets = np.array(goals)
        lengths = to_begin + np.linalg.norm(targets[:, None] - ends, axis=2)
        lengths[lengths > DETOUR * np.linalg.norm(targets - start, axis=1)[:, None]] = np.inf
        for index in np.argsort(lengths, axis=None, kind="stable")[:TRIED].tolist():
            goal, kept = divmod(index, len(self._inner))
            if lengths[goal, kept] == np.inf:
                return
            yield np.vstack((start, self._inner[kept], goals[goal]))


def _shortened(way: np.ndarray, query: PathQuery) -> np.ndarray | None:
    """Return a way whose edges were checked coarsely, shortened; None where the query's own check finds a contact."""
    check = ShortcutCheck(query.validator)
    path = shortened(way, check.first_free)
    return path if all(check.free(*edge) for edge in zip(path, path[1:])) else None

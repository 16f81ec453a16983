"""Ways found before, tried before a search begins.

A cell has few ways round what stands in it, and one request resembles the next: over the rack, through the window, back. The inner
points of the last paths are kept, and a request is first answered by one of them, from its own start and to its own goal, if that
is free now. Nothing is taken for granted: every edge is checked in the world of the request, so it does not matter in which scene a
path was found.

What comes out depends on what was asked before. So a planner whose seed is fixed, whose plans must be the same each time, does
without (`planner.Planner`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np

from construction_twin.planning.motion_validator import ShortcutCheck
from construction_twin.planning.path_search import PathQuery
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

    def find(self, query: PathQuery) -> np.ndarray | None:
        """Return a path through points of an earlier one, as `path_search.PathSearch.find` would; None if none fits."""
        coarse = query.validator.coarser(COARSER)
        for way in self._ways(query.start, query.goals):
            # the edges to the ends are new, those between them were free once; kept points are checked first, the ends are free
            edges = [(way[0], way[1]), (way[-1], way[-2]), *zip(way[1:-2], way[2:-1])]
            if all(coarse.free(*edge) for edge in edges):
                check = ShortcutCheck(query.validator)
                path = shortened(way, check.first_free)
                if all(check.free(*edge) for edge in zip(path, path[1:])):
                    return path
        return None

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

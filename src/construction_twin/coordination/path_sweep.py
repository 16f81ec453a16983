"""The space that an arm occupies along a trajectory, computed in chunks, because a trajectory may last an hour."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from construction_twin.planning.limit_usage import cycle_times
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.neighbour import Neighbour, Obstacle, PathCopy, row_of

#: Rows of a chunk: 5 s of motion, computed in about 0.01 s.
CHUNK = 1250


@dataclass(frozen=True)
class PlanPosition:
    """An arm's position on a plan: the row of its `PathSweep`."""

    plan_id: str
    row: int


class PathSweep:
    """A trajectory as copies of an arm's bodies; see `Neighbour.along`. Rows are its samples every 4 ms.

    Attributes:
        times: Shape (m,). Of all rows [s].
        copies: Of the chunks computed so far, as in `SweptPath.copies`.
    """

    def __init__(self, arm: Neighbour, trajectory: Trajectory, standing: bool = True):
        self._arm = arm
        self._trajectory = trajectory
        self._standing = standing
        times = cycle_times(trajectory)
        self.times = np.append(times[times < trajectory.duration], trajectory.duration)
        self.copies: list[PathCopy] = []
        self._rows = np.empty((len(self.times), len(trajectory.positions[0])))
        # the last row that has been computed
        self._made = 0

    @property
    def complete(self) -> bool:
        """Whether the whole trajectory has been computed."""
        return self._made == len(self.times) - 1

    @property
    def fraction(self) -> float:
        """Fraction of the trajectory that has been computed."""
        return self._made / (len(self.times) - 1)

    def grow(self, row: int | None = None) -> None:
        """Compute chunks at least up to a row; without one, compute the next chunk."""
        row = self._made + 1 if row is None else row
        while not self.complete and self._made < row:
            start, end = self._made, min(self._made + CHUNK, len(self.times) - 1)
            rows = self._trajectory.sample_many(self.times[start : end + 1])[0]
            self._rows[start : end + 1] = rows
            if start == 0 and self._standing:
                self.copies += [PathCopy(0, len(self.times) - 1, obstacle) for obstacle in self._arm.standing()]
            swept = self._arm.along(rows, standing=False)
            self.copies += [PathCopy(start + first, start + last, obstacle) for first, last, obstacle in swept.copies]
            self._made = end

    def row_after(self, row: int, time: float) -> int:
        """Return the first row more than `time` [s] after another row; the number of rows if there is none."""
        return int(np.searchsorted(self.times, self.times[row] + time, side="right"))

    def copies_before(self, row: int) -> int:
        """Return how many of the computed copies are needed before a row; they are the first in the list."""
        return bisect_left(self.copies, row, key=lambda copy: copy.first)

    def rest(self, row: int = 0) -> tuple[Obstacle, ...]:
        """Return the space that the arm occupies from a row on, as far as it has been computed."""
        return tuple(copy.obstacle for copy in self.copies if copy.last >= row)

    def row_of(self, q: Iterable[float], start: int = 0) -> int | None:
        """Return the first row from `start` on that matches a pose; see `neighbour.row_of`. Computes the chunks up to it."""
        if not self.copies:
            self.grow()
        q = np.asarray(q)
        while (found := row_of(self._rows[: self._made + 1], q, start)) is None and not self.complete:
            start = max(start, self._made)
            self.grow()
        return found

"""What an arm takes up along a trajectory, made section by section: a trajectory may take an hour, and nobody can wait for it."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable

import numpy as np

from construction_twin.planning.limit_usage import cycle_times
from construction_twin.robot.trajectory import Trajectory
from construction_twin.scene.neighbour import Neighbour, Obstacle, row_of

#: Rows of a section: 5 s, some 0.01 s to make.
SECTION = 1250


class PathSweep:
    """A trajectory as copies of an arm's bodies; see `Neighbour.along`. Rows are its samples every 4 ms.

    Parameters
    ----------
    arm : Neighbour
    trajectory : Trajectory
    standing : bool, optional
        With what no joint moves.

    Attributes
    ----------
    times : array, shape (m,)
        Of all rows [s].
    copies : list of (int, int, Obstacle)
        Of the sections made so far, as of `SweptPath.copies`.
    """

    def __init__(self, arm: Neighbour, trajectory: Trajectory, standing: bool = True):
        self._arm = arm
        self._trajectory = trajectory
        self._standing = standing
        times = cycle_times(trajectory)
        self.times = np.append(times[times < trajectory.duration], trajectory.duration)
        self.copies: list[tuple[int, int, Obstacle]] = []
        self._rows = np.empty((len(self.times), len(trajectory.positions[0])))
        # the last row that a section has been made until
        self._made = 0

    @property
    def complete(self) -> bool:
        """Whether there is no section left to make."""
        return self._made == len(self.times) - 1

    @property
    def fraction(self) -> float:
        """How much of the trajectory has been made; 1: all of it."""
        return self._made / (len(self.times) - 1)

    def grow(self, row: int | None = None) -> None:
        """Make the sections until a row, at least; without one make the next section."""
        row = self._made + 1 if row is None else row
        while not self.complete and self._made < row:
            start, end = self._made, min(self._made + SECTION, len(self.times) - 1)
            rows = self._trajectory.sample_many(self.times[start : end + 1])[0]
            self._rows[start : end + 1] = rows
            if start == 0 and self._standing:
                self.copies += [(0, len(self.times) - 1, obstacle) for obstacle in self._arm.standing()]
            swept = self._arm.along(rows, standing=False)
            self.copies += [(start + first, start + last, obstacle) for first, last, obstacle in swept.copies]
            self._made = end

    def row_after(self, row: int, time: float) -> int:
        """Return the first row that is more than a time behind another [s]; the number of rows where none is."""
        return int(np.searchsorted(self.times, self.times[row] + time, side="right"))

    def copies_before(self, row: int) -> int:
        """Return how many copies, of those made so far, are needed before a row; they come first."""
        return bisect_left(self.copies, row, key=lambda copy: copy[0])

    def rest(self, row: int = 0) -> tuple[Obstacle, ...]:
        """Return what the arm takes up from a row on, as far as it was made."""
        return tuple(obstacle for _, last, obstacle in self.copies if last >= row)

    def row_of(self, q: Iterable[float], start: int = 0) -> int | None:
        """Return the first row from `start` on that a pose belongs to; see `neighbour.row_of`. Makes the sections until there."""
        if not self.copies:
            self.grow()
        q = np.asarray(q)
        while (found := row_of(self._rows[: self._made + 1], q, start)) is None and not self.complete:
            start = max(start, self._made)
            self.grow()
        return found

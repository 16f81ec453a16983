"""Does the other arm stand in the way of a plan, now or with what it is about to do, and which of the two gives way?

Joint values in rad (m for linear joints), order of the robot's ``joint_names``; times along a plan in s from its start, at
planned speed; points in time in ns.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from construction_twin.coordination.path_sweep import PathSweep
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan
from construction_twin.scene.first_contact import copies, first_contact, joined
from construction_twin.scene.neighbour import Neighbour, Obstacle

#: Copies of our arm that are compared in one go. Always a whole block: so obstacles that came one after the other soon stand at the
#: same one, and are compared together from then on.
_BLOCK = 128
#: To make a copy of our arm ready for comparison costs as much as to compare it with so many.
_OVERHEAD = 500


@dataclass(frozen=True)
class Conflict:
    """Where a plan meets the other arm.

    Attributes
    ----------
    time : float
        From the present pose until then, at planned speed, at least [s].
    between : tuple of str, length 2
        A link or carried object of ours, and the other arm's.
    """

    time: float
    between: tuple[str, str]


@dataclass(frozen=True)
class PathCheck:
    """What a look along a way has found.

    Attributes
    ----------
    conflict : Conflict or None
        The first one that is known.
    fraction : float
        How much of the way has been compared with all that the other arm takes up; 1: all of it.
    """

    conflict: Conflict | None
    fraction: float


class _Batch:
    """Obstacles that came at the same time, and how many copies of our arm are clear of them."""

    def __init__(self, obstacles: frozenset[Obstacle]):
        self.obstacles = obstacles
        self.checked = 0
        self.contact: tuple[int, Obstacle] | None = None
        self.shapes = copies(tuple(obstacles))

    def take(self, other: _Batch) -> None:
        """Take in another batch that stands at the same copy of our arm."""
        self.obstacles |= other.obstacles
        self.shapes = joined(self.shapes, other.shapes)

    def thin(self) -> None:
        """Compare no longer with those that are not there any more."""
        self.shapes = copies(tuple(self.obstacles))


class OwnPath:
    """A plan of ours as copies of our arm, compared with the other arm's step by step: no look takes long.

    What was found out of the way once stays so: our way gets shorter, and so does what the other arm takes up on its path.

    Parameters
    ----------
    plan : Plan
    arm : Neighbour
        Our own robot with what it carries, from its own root; its `step` is how close the copies are.

    Attributes
    ----------
    plan : Plan
    """

    def __init__(self, plan: Plan, arm: Neighbour):
        self.plan = plan
        self._sweep = PathSweep(arm, plan.trajectory, standing=False)
        self._clear: frozenset[Obstacle] = frozenset()
        self._batches: list[_Batch] = []

    def row_of(self, q: Iterable[float], start: int = 0) -> int | None:
        """Return the first row from `start` on that a pose belongs to; see `neighbour.row_of`."""
        return self._sweep.row_of(q, start)

    def check(
        self, obstacles: Iterable[Obstacle], padding: float, row: int = 0, horizon: float = np.inf, budget: int = 0
    ) -> PathCheck:
        """Compare the way from a row on with all that the other arm takes up: up to a horizon now, then as far as a budget goes.

        Parameters
        ----------
        obstacles : iterable of Obstacle
            All that the other arm takes up.
        padding : float
            Distance to keep from it [m], on top of what both sides' copies have. The same every time.
        row : int, optional
            Where our arm is. Never less than before.
        horizon : float, optional
            Compared in any case: what lies less than this ahead [s].
        budget : int, optional
            How many pairs of copies are compared beyond, about; the next look goes on from there.
        """
        end = self._sweep.row_after(row, horizon)
        self._sweep.grow(end)
        if budget:
            self._sweep.grow()
        self._sort(frozenset(obstacles), row)
        near, known = self._sweep.copies_before(end), len(self._sweep.copies)
        for batch in self._batches:
            self._compare(batch, padding, row, near)
        self._merge()
        while budget > 0 and (behind := [one for one in self._batches if not one.contact and one.checked < known]):
            # the one that is farthest: others are soon forgotten, such as an arm that is moved by hand
            batch = max(behind, key=lambda one: one.checked)
            budget -= self._compare(batch, padding, row, batch.checked + 1)
            self._merge()
        fraction = min((self._fraction(batch) for batch in self._batches), default=1.0)
        contacts = [batch.contact for batch in self._batches if batch.contact]
        self._settle()
        return PathCheck(
            self._conflict(*min(contacts, key=lambda found: found[0]), row) if contacts else None, fraction
        )

    def _sort(self, obstacles: frozenset[Obstacle], row: int) -> None:
        """Put new obstacles into a batch of their own, and forget what is over."""
        for batch in self._batches:
            batch.obstacles &= obstacles
            if batch.contact:
                place, other = batch.contact
                if other not in obstacles or self._sweep.copies[place][1] < row:
                    batch.contact = None
        self._batches = [batch for batch in self._batches if batch.obstacles]
        self._clear &= obstacles
        new = obstacles.difference(self._clear, *(batch.obstacles for batch in self._batches))
        if new:
            self._batches.append(_Batch(new))

    def _merge(self) -> None:
        """Make one batch of those that stand at the same copy of our arm."""
        first: dict[int, _Batch] = {}
        for batch in self._batches:
            if not batch.contact and first.setdefault(batch.checked, batch) is not batch:
                first[batch.checked].take(batch)
        self._batches = [one for one in self._batches if one.contact or first[one.checked] is one]

    def _settle(self) -> None:
        """Keep nothing but the obstacles' names of what our whole way is clear of."""
        clear = [batch for batch in self._batches if self._fraction(batch) == 1.0]
        self._clear = self._clear.union(*(batch.obstacles for batch in clear))
        self._batches = [batch for batch in self._batches if batch not in clear]

    def _fraction(self, batch: _Batch) -> float:
        if batch.checked < len(self._sweep.copies):
            return self._sweep.copies[batch.checked][0] / len(self._sweep.times)
        return self._sweep.fraction

    def _compare(self, batch: _Batch, padding: float, row: int, end: int) -> int:
        """Compare with a batch until a copy of our arm, or a little further; return what it cost, in pairs."""
        swept, compared = self._sweep.copies, 1
        while not batch.contact and batch.checked < end:
            stop = min(batch.checked - batch.checked % _BLOCK + _BLOCK, len(swept))
            ahead = [place for place in range(batch.checked, stop) if swept[place][1] >= row]
            compared += len(ahead) * (len(batch.obstacles) + _OVERHEAD)
            found = first_contact(copies([swept[place][2] for place in ahead]), batch.shapes, padding)
            if found is None:
                batch.checked = stop
                continue
            batch.checked = ahead[found[0]]
            if found[1] in batch.obstacles:
                batch.contact = batch.checked, found[1]
            else:
                batch.thin()
        return compared

    def _conflict(self, place: int, other: Obstacle, row: int) -> Conflict:
        first, _, mine = self._sweep.copies[place]
        since = self._sweep.times[max(first, row)] - self._sweep.times[row]
        return Conflict(float(since), (mine.owner.partition("/")[2], other.owner))


@dataclass(frozen=True)
class Claim:
    """The right to a way, from the first setpoint of an approved plan until it has ended.

    Attributes
    ----------
    since : int
        Stamp of its first setpoint [ns]; 0: it has not begun.
    name : str
        Of the robot; settles who was first when both began at once.
    """

    since: int
    name: str

    def before(self, other: Claim) -> bool:
        """Return whether this one came first; a plan that has not begun comes after one that has."""
        return (self.since or np.inf, self.name) < (other.since or np.inf, other.name)


def gives_way(conflict: Conflict, own: Claim, other: Claim | None, horizon: float) -> bool:
    """Return whether our plan must not start, or not go on.

    It gives way to an arm that follows no plan, whatever keeps it there; to one whose plan began before ours; and to any when
    the conflict is closer than `horizon`: two arms that both brake cannot meet then.

    Parameters
    ----------
    conflict : Conflict
    own : Claim
    other : Claim or None
        None: the other arm follows no plan.
    horizon : float
        See `braking_horizon` [s].
    """
    return other is None or not own.since or other.before(own) or conflict.time <= horizon


def braking_horizon(robot: RobotModel, other: RobotModel, pose_age: float, verdict_age: float, delay: float) -> float:
    """Return how far ahead a conflict must be seen [s]: both arms' longest braking times, and the age of all that is known.

    Parameters
    ----------
    robot, other : RobotModel
    pose_age : float
        Of the poses that a look is made with, at most [s].
    verdict_age : float
        Of the verdict that the executor goes by, at most, since the poses were read [s]: a look may take long, or be left out.
    delay : float
        From the moment when a verdict counts no longer to the first braking setpoint [s].
    """
    braking = (float(np.max(np.divide(one.velocity, one.acceleration))) for one in (robot, other))
    return sum(braking) + pose_age + verdict_age + delay

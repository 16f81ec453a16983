"""Conflicts between a plan and the other arm, now or on its own path, and which of the two arms gives way.

Joint values in rad (m for prismatic joints), order of the robot's ``joint_names``; times along a plan in s from its start, at
planned speed; stamps in ns.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import coal
import numpy as np

from construction_twin.coordination.path_sweep import PathSweep
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan
from construction_twin.scene.neighbour import Neighbour, Obstacle

#: Accuracy of the distances between centres, which are computed from differences of squares, within 100 m [m].
_ROUNDING = 1e-4


class Copies:
    """Copies of one shape, as arrays."""

    def __init__(self, places: Sequence[int], items: Sequence[Obstacle]):
        self.places = np.array(places)
        self.items = tuple(items)
        self.radius = items[0].sphere[1]
        self.paddings = np.array([item.padding for item in items])
        self._set(
            np.array([item.sphere[0] for item in items]),
            np.array([item.placement.rotation for item in items]).reshape(len(items), 9),
        )

    def _set(self, centres: np.ndarray, rotations: np.ndarray) -> None:
        self.centres, self._rotations = centres, rotations
        self.squares = (centres**2).sum(axis=1)
        middle = (centres.min(axis=0) + centres.max(axis=0)) / 2.0
        spread = np.sqrt(((centres - middle) ** 2).sum(axis=1)) + self.paddings
        self._ball = middle, float(spread.max()) + self.radius
        self._transforms: dict[int, coal.Transform3s] = {}

    def with_more(self, other: Copies) -> Copies:
        """Return these and more copies of the same shape. The places of the result have no meaning."""
        made = object.__new__(Copies)
        made.places = np.arange(len(self.items) + len(other.items))
        made.items = self.items + other.items
        made.radius = self.radius
        made.paddings = np.concatenate([self.paddings, other.paddings])
        made._set(np.vstack([self.centres, other.centres]), np.vstack([self._rotations, other._rotations]))
        return made

    def near(self, other: Copies, padding: float) -> np.ndarray:
        """Return the indices of those copies that may be within a distance of the ball around all other copies."""
        middle, radius = other._ball
        reach = self.paddings + (radius + self.radius + padding + _ROUNDING)
        return np.flatnonzero(((self.centres - middle) ** 2).sum(axis=1) <= reach**2)

    def apart(self, index: int, wanted: np.ndarray) -> np.ndarray:
        """Return an upper bound of the distance between the same point of one copy and of some others, shape (k,) [m]."""
        shifts = np.linalg.norm(self.centres[wanted] - self.centres[index], axis=1)
        # a turn by w moves a point at distance r by 2 r sin(w / 2); the product of the matrices' entries is 1 + 2 cos(w)
        turns = np.sqrt(np.maximum(0.0, 3.0 - self._rotations[wanted] @ self._rotations[index]))
        return shifts + self.radius * turns

    def transform(self, index: int) -> coal.Transform3s:
        """Return a copy's placement as Coal takes it."""
        if index not in self._transforms:
            placement = self.items[index].placement
            self._transforms[index] = coal.Transform3s(placement.rotation, placement.translation)
        return self._transforms[index]


def copies(items: Sequence[Obstacle]) -> list[Copies]:
    """Return obstacles grouped by their shapes."""
    places: dict[int, list[int]] = {}
    for place, item in enumerate(items):
        places.setdefault(id(item.geometry), []).append(place)
    return [Copies(found, [items[place] for place in found]) for found in places.values()]


def joined(shapes: Sequence[Copies], more: Sequence[Copies]) -> list[Copies]:
    """Return two results of `copies` merged into one."""
    by_geometry = {id(item.items[0].geometry): item for item in shapes}
    for item in more:
        key = id(item.items[0].geometry)
        by_geometry[key] = by_geometry[key].with_more(item) if key in by_geometry else item
    return [*by_geometry.values()]


def first_contact(own: Sequence[Copies], others: Sequence[Copies], padding: float) -> tuple[int, Obstacle] | None:
    """Return the first of our obstacles that comes too close to one of the others, and that one; None if none does.

    Few pairs are measured: the distance of one pair of copies, less the distances between the copies, is a lower bound for every
    other pair of copies of the same two bodies.

    Args:
        padding: Distance to keep, on top of what both obstacles have [m].

    Returns:
        place: In the list that `own` was made from.
        other
    """
    request = coal.DistanceRequest()
    # how deep a contact is does not matter
    request.enable_signed_distance = False
    found = None
    for mine in own:
        for theirs in others:
            count = len(mine.places) if found is None else int(np.searchsorted(mine.places, found[0]))
            found = _contact(mine, theirs, count, padding, request) or found
    return found


def _contact(
    mine: Copies, theirs: Copies, count: int, padding: float, request: coal.DistanceRequest
) -> tuple[int, Obstacle] | None:
    """Return the first among the first `count` copies of one shape that touches a copy of another shape, and that copy."""
    wanted = theirs.near(mine, padding)
    if not len(wanted) or not count:
        return None
    rows = np.arange(count)
    paddings, their_paddings = mine.paddings[:count, None] + padding, theirs.paddings[wanted]
    squares = (
        mine.squares[:count, None] + theirs.squares[wanted] - 2.0 * (mine.centres[:count] @ theirs.centres[wanted].T)
    )
    # lower bounds of the distances between padded copies, at first from the balls around them
    left = np.sqrt(np.maximum(squares, 0.0))
    left -= paddings + (mine.radius + theirs.radius + _ROUNDING)
    left -= their_paddings
    first, second = mine.items[0].geometry, theirs.items[0].geometry
    found = None
    while len(left) and left.min() <= 0.0:
        row, column = np.unravel_index(np.argmin(left), left.shape)
        at, to = int(row), int(wanted[column])
        result = coal.DistanceResult()
        distance = coal.distance(first, mine.transform(at), second, theirs.transform(to), request, result)
        if distance <= paddings[at, 0] + theirs.paddings[to]:
            found = int(mine.places[at]), theirs.items[to]
            left = left[:at]
            continue
        covered = distance - mine.apart(at, rows[: len(left)])[:, None] - paddings[: len(left)]
        covered = covered - (theirs.apart(to, wanted) + their_paddings)
        np.maximum(left, covered, out=left)
        # this pair was measured and is free, even if rounding left its bound at 0
        left[at, column] = np.inf
    return found


#: Copies of our arm that are compared at once. Batches of obstacles advance by whole blocks, so that batches that arrived one
#: after the other soon reach the same copy and are then compared together.
BLOCK = 128
#: Preparing a copy of our arm for comparison costs as much as comparing it with this many obstacles.
_OVERHEAD = 500


@dataclass(frozen=True)
class Conflict:
    """The first place where a plan comes too close to the other arm.

    Attributes:
        time: Lower bound of the time from the present pose until then, at planned speed [s].
        between: Length 2. A link or carried object of ours, and the other arm's.
    """

    time: float
    between: tuple[str, str]


@dataclass(frozen=True)
class PathCheck:
    """The result of comparing a plan's path with the other arm, as far as it has been compared.

    Attributes:
        fraction: Fraction of the path that has been compared with the space that the other arm occupies; 1: all of it.
    """

    conflict: Conflict | None
    fraction: float


class _Batch:
    """Obstacles that arrived together, and the number of copies of our arm that were found clear of them."""

    def __init__(self, obstacles: frozenset[Obstacle]):
        self.obstacles = obstacles
        self.checked = 0
        self.contact: tuple[int, Obstacle] | None = None
        self.shapes = copies(tuple(obstacles))

    def take(self, other: _Batch) -> None:
        """Add another batch that has reached the same copy of our arm."""
        self.obstacles |= other.obstacles
        self.shapes = joined(self.shapes, other.shapes)

    def thin(self) -> None:
        """Drop the shapes of obstacles that no longer exist."""
        self.shapes = copies(tuple(self.obstacles))


class OwnPath:
    """A plan of ours as copies of our arm, compared with the other arm in steps, so that no single call takes long.

    What was once found clear stays clear: the rest of our path only gets shorter, and so does the rest of the other arm's path.
    """

    def __init__(self, plan: Plan, arm: Neighbour):
        self.plan = plan
        self._sweep = PathSweep(arm, plan.trajectory, standing=False)
        self._clear: frozenset[Obstacle] = frozenset()
        self._batches: list[_Batch] = []

    def row_of(self, q: Iterable[float], start: int = 0) -> int | None:
        """Return the first row of the path from `start` on that matches a pose; see `neighbour.row_of`."""
        return self._sweep.row_of(q, start)

    def check(
        self, obstacles: Iterable[Obstacle], padding: float, row: int = 0, horizon: float = np.inf, budget: int = 0
    ) -> PathCheck:
        """Compare the path from a row on with the space that the other arm occupies: up to a horizon, then within a budget.

        Args:
            padding: Distance to keep from it [m], added to the padding of both sides' copies. Must be the same at every call.
            row: Our arm's present row. Must not decrease from call to call.
            horizon: The next part of the path, of this length, is always compared [s].
            budget: About how many pairs of copies are compared beyond the horizon; the next call continues there.
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
            # the batch that is furthest: others may soon be gone, such as those of an arm that is moved by hand
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
        """Put new obstacles into a batch of their own, and forget obstacles and contacts that no longer exist."""
        for batch in self._batches:
            batch.obstacles &= obstacles
            if batch.contact:
                place, other = batch.contact
                if other not in obstacles or self._sweep.copies[place].last < row:
                    batch.contact = None
        self._batches = [batch for batch in self._batches if batch.obstacles]
        self._clear &= obstacles
        new = obstacles.difference(self._clear, *(batch.obstacles for batch in self._batches))
        if new:
            self._batches.append(_Batch(new))

    def _merge(self) -> None:
        """Merge the batches that have reached the same copy of our arm."""
        first: dict[int, _Batch] = {}
        for batch in self._batches:
            if not batch.contact and first.setdefault(batch.checked, batch) is not batch:
                first[batch.checked].take(batch)
        self._batches = [one for one in self._batches if one.contact or first[one.checked] is one]

    def _settle(self) -> None:
        """Drop the batches of which our whole path is clear; only their obstacles are remembered."""
        clear = [batch for batch in self._batches if self._fraction(batch) == 1.0]
        self._clear = self._clear.union(*(batch.obstacles for batch in clear))
        self._batches = [batch for batch in self._batches if batch not in clear]

    def _fraction(self, batch: _Batch) -> float:
        if batch.checked < len(self._sweep.copies):
            return self._sweep.copies[batch.checked].first / len(self._sweep.times)
        return self._sweep.fraction

    def _compare(self, batch: _Batch, padding: float, row: int, end: int) -> int:
        """Compare a batch with the copies of our arm up to one of them, by whole blocks; return the cost in pairs."""
        swept, compared = self._sweep.copies, 1
        while not batch.contact and batch.checked < end:
            stop = min(batch.checked - batch.checked % BLOCK + BLOCK, len(swept))
            ahead = [place for place in range(batch.checked, stop) if swept[place].last >= row]
            compared += len(ahead) * (len(batch.obstacles) + _OVERHEAD)
            found = first_contact(copies([swept[place].obstacle for place in ahead]), batch.shapes, padding)
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
        copy = self._sweep.copies[place]
        since = self._sweep.times[max(copy.first, row)] - self._sweep.times[row]
        return Conflict(float(since), (copy.obstacle.owner.partition("/")[2], other.owner))


@dataclass(frozen=True)
class Claim:
    """An arm's right of way, from the first setpoint of an approved plan until the plan has ended.

    Attributes:
        since: Stamp of its first setpoint [ns]; 0: it has not begun.
        name: Of the robot; decides if both began at the same time.
    """

    since: int
    name: str

    def before(self, other: Claim) -> bool:
        """Return whether this one came first; a plan that has not begun comes after one that has."""
        return (self.since or np.inf, self.name) < (other.since or np.inf, other.name)


def gives_way(conflict: Conflict, own: Claim, other: Claim | None, horizon: float) -> bool:
    """Return whether our plan must not start or must not continue.

    It gives way to an arm that follows no plan; to an arm whose plan began before ours; and to every arm if the conflict is closer
    than `horizon`, because two arms that both brake then cannot touch.

    Args:
        other: None: the other arm follows no plan.
    """
    return other is None or not own.since or other.before(own) or conflict.time <= horizon


def braking_horizon(robot: RobotModel, other: RobotModel, pose_age: float, verdict_age: float, delay: float) -> float:
    """Return how far ahead a conflict must be detected [s]: both arms' longest braking times plus the ages of the information.

    Args:
        pose_age: Largest age of the poses that a check uses [s].
        verdict_age: Largest time from reading the poses to the executor's use of the verdict [s]: a check may take long or be
            skipped.
        delay: Time from a verdict's expiry to the first braking setpoint [s].
    """
    braking = (float(np.max(np.divide(one.velocity, one.acceleration))) for one in (robot, other))
    return sum(braking) + pose_age + verdict_age + delay

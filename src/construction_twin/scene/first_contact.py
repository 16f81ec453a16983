"""The first contact between two sets of padded shapes.

Few pairs are measured. Many shapes are copies of one body at neighbouring poses: the distance measured for one pair of copies,
less the distances between the copies, is a lower bound for every other pair of copies of the same two bodies. Metres.
"""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np

from construction_twin.scene.neighbour import Obstacle

#: Accuracy of the distances between centres, which are computed from differences of squares, within 100 m [m].
_ROUNDING = 1e-4


class Copies:
    """Copies of one shape, as arrays.

    Args:
        places: Index of each in the list that it was taken from, ascending.
        items: All of the same geometry.
    """

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

    Args:
        own, others: See `copies`.
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

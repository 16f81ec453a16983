"""Where do two sets of padded shapes meet first? Most pairs are answered without being measured: a measured distance holds for
every pair of copies of the same two shapes that are near those two, less what they are apart. Metres.
"""

from __future__ import annotations

from collections.abc import Sequence

import coal
import numpy as np

from construction_twin.scene.neighbour import Obstacle

#: Centres' distances are differences of squares: good to this much within 100 m [m].
_ROUNDING = 1e-4


class Copies:
    """Copies of one shape, as arrays.

    Parameters
    ----------
    places : sequence of int
        Where each is in the list that it was taken from, ascending.
    items : sequence of Obstacle
        All of the same geometry.
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
        """Return these and more copies of the same shape; their places are of no use."""
        made = object.__new__(Copies)
        made.places = np.arange(len(self.items) + len(other.items))
        made.items = self.items + other.items
        made.radius = self.radius
        made.paddings = np.concatenate([self.paddings, other.paddings])
        made._set(np.vstack([self.centres, other.centres]), np.vstack([self._rotations, other._rotations]))
        return made

    def near(self, other: Copies, padding: float) -> np.ndarray:
        """Return which of these may be within a distance of any of the others, by the ball around all of those."""
        middle, radius = other._ball
        reach = self.paddings + (radius + self.radius + padding + _ROUNDING)
        return np.flatnonzero(((self.centres - middle) ** 2).sum(axis=1) <= reach**2)

    def apart(self, index: int, wanted: np.ndarray) -> np.ndarray:
        """Return how far any point of one copy is from the same point of some others, at most, shape (k,) [m]."""
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
    """Return a list of obstacles by their shapes."""
    places: dict[int, list[int]] = {}
    for place, item in enumerate(items):
        places.setdefault(id(item.geometry), []).append(place)
    return [Copies(found, [items[place] for place in found]) for found in places.values()]


def joined(shapes: Sequence[Copies], more: Sequence[Copies]) -> list[Copies]:
    """Return two results of `copies` as one."""
    by_geometry = {id(item.items[0].geometry): item for item in shapes}
    for item in more:
        key = id(item.items[0].geometry)
        by_geometry[key] = by_geometry[key].with_more(item) if key in by_geometry else item
    return [*by_geometry.values()]


def first_contact(own: Sequence[Copies], others: Sequence[Copies], padding: float) -> tuple[int, Obstacle] | None:
    """Return the first of our obstacles that comes too close to any of the others, and to which; None where none does.

    Parameters
    ----------
    own, others : sequence of Copies
        See `copies`.
    padding : float
        Distance to keep, on top of what both obstacles have [m].

    Returns
    -------
    place : int
        In the list that `own` was made from.
    other : Obstacle
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
    """Return the first of the first `count` copies of one shape that meets a copy of another, and which."""
    wanted = theirs.near(mine, padding)
    if not len(wanted) or not count:
        return None
    rows = np.arange(count)
    paddings, their_paddings = mine.paddings[:count, None] + padding, theirs.paddings[wanted]
    squares = (
        mine.squares[:count, None] + theirs.squares[wanted] - 2.0 * (mine.centres[:count] @ theirs.centres[wanted].T)
    )
    # what is left between the paddings of two copies, at least: first by the balls around them
    left = np.sqrt(np.maximum(squares, 0.0))
    left -= paddings + (mine.radius + theirs.radius + _ROUNDING)
    left -= their_paddings
    first, second = mine.items[0].geometry, theirs.items[0].geometry
    found = None
    while len(left) and left.min() <= 0.0:
        at, column = np.unravel_index(np.argmin(left), left.shape)
        to = int(wanted[column])
        result = coal.DistanceResult()
        distance = coal.distance(first, mine.transform(at), second, theirs.transform(to), request, result)
        if distance <= paddings[at, 0] + theirs.paddings[to]:
            found = int(mine.places[at]), theirs.items[to]
            left = left[:at]
            continue
        covered = distance - mine.apart(at, rows[: len(left)])[:, None] - paddings[: len(left)]
        covered = covered - (theirs.apart(to, wanted) + their_paddings)
        np.maximum(left, covered, out=left)
        # free by measurement, whatever rounding made of it
        left[at, column] = np.inf
    return found

"""The smallest of many distances on a motion, and the first contact, without measuring all of them.

Between two poses a distance changes by at most the motion of the bodies, which bounds it between two measured poses. Metres and
radians; rows of joint values in Pinocchio's order.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from construction_twin.scene.collision_bodies import Body, RobotBodies

#: Accuracy of a measured distance [m]: Coal's own tolerance.
TOLERANCE = 1e-6
#: A smallest distance may be larger than the smallest there is by so much [m], or by this part of it if that is more: a body that
#: turns beside another at a constant distance would take hundreds of measurements a row.
ACCURACY, ACCURACY_PART = 1e-4, 0.01
#: A contact is sought in ever shorter parts of a motion, until no point of a pair moves further than this [m].
RESOLUTION = 2e-5
#: A stretch between two rows is divided no nearer to its ends than this part of it.
_EDGE = 0.1
#: So many stretches are divided together, those first where most is to be expected.
_DIVIDED = 256

#: What a stretch is, one row each of a table: of bounds, no distance on it is smaller [m].
_LOW, _HIGH, _AT_LOW, _AT_HIGH, _MOVED_LOW, _MOVED_HIGH, _BOUND = range(7)


def pair_levers(robot: RobotBodies, bodies: Sequence[Body], pairs: Sequence[tuple]) -> np.ndarray:
    """Return how far the two bodies of each pair move relative to each other at most per unit of each joint, shape (p, size).

    [m/rad], or 1 for prismatic joints; Pinocchio's order. The first two entries of `pairs` are indices into `bodies`.
    """
    below = np.zeros((len(bodies), robot.model.nq), dtype=bool)
    for index, body in enumerate(bodies):
        below[index, sorted(_joints_below(robot, body))] = True
    first, second = np.array([(pair[0], pair[1]) for pair in pairs], dtype=int).reshape(-1, 2).T
    levers = body_levers(robot, bodies, robot.strokes)[0].T
    # a joint that moves both bodies moves them together: what counts is each body with the joints that move it alone
    return levers[first] * (below[first] & ~below[second]) + levers[second] * (below[second] & ~below[first])


class Travel:
    """For each pair, an upper bound of the relative motion of its bodies from the first row on; rows, and their `pair_levers`."""

    def __init__(self, rows: np.ndarray, levers: np.ndarray):
        self._way, self._levers = np.zeros_like(rows), levers
        np.cumsum(np.abs(np.diff(rows, axis=0)), axis=0, out=self._way[1:])

    def at(self, places: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """Return the travel of some pairs, each up to a place [m], all of shape (k,)."""
        row = places.astype(int)
        low, high = self._way[row], self._way[np.minimum(row + 1, len(self._way) - 1)]
        return np.einsum("kn,kn->k", low + (places - row)[:, None] * (high - low), self._levers[pairs])


def body_levers(robot: RobotBodies, bodies: Sequence[Body], strokes: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """Return bounds of the motion of each body's points per unit of each joint, and of their distance from the root [m].

    The former in Pinocchio's order, shape (size, b): [m/rad], 1 for a prismatic joint, 0 for one that does not move the body.
    """
    model = robot.model
    axes = {joint: (axis, linear) for joint, axis, linear in robot.joint_axes}
    per_body = np.zeros((model.nq, len(bodies)))
    reaches = []
    for column, body in enumerate(bodies):
        body.geometry.computeLocalAABB()
        # no point of the body is further than `around` from `offset`, in the joint's frame
        offset, around = body.placement.act(np.array(body.geometry.aabb_center)), body.geometry.aabb_radius
        joint = body.joint
        while joint:
            index, (axis, linear) = model.joints[joint].idx_q, axes[joint]
            per_body[index, column] = 1.0 if linear else float(np.linalg.norm(np.cross(axis, offset))) + around
            around += float(np.linalg.norm(offset)) + linear * strokes[index]
            offset = model.jointPlacements[joint].translation
            joint = model.parents[joint]
        reaches.append(float(np.linalg.norm(offset)) + around)
    return per_body, reaches


def _joints_below(robot: RobotBodies, body: Body) -> set[int]:
    """Return the places, in Pinocchio's configuration, of the joints that move a body."""
    model, joint, places = robot.model, body.joint, set()
    while joint:
        places.add(model.joints[joint].idx_q)
        joint = model.parents[joint]
    return places


class Motion:
    """The motion of pairs, at least one, through rows of joint values, each joint going evenly from one row to the next.

    A place on it is a number of rows: 3.5 is half way from row 3 to row 4. What was measured for one question serves the next.
    ``measure(places, pairs)`` returns the distances of some pairs, each at a place [m], arrays of shape (k,).
    """

    def __init__(self, travel: Travel, last: int, pairs: int, measure: Callable[[np.ndarray, np.ndarray], np.ndarray]):
        self._travel, self._measure, self._count = travel, measure, pairs
        # all that was measured
        self._pairs = np.tile(np.arange(pairs), 2)
        self._places = np.repeat([0.0, float(last)], pairs)
        self._distances = measure(self._places, self._pairs)
        moved = travel.at(self._places, self._pairs).reshape(2, pairs)
        self._stretches = _Stretches(float(last), self._distances.reshape(2, pairs), moved)

    def smallest(self, without: Sequence[int] = ()) -> tuple[float, int]:
        """Return place and pair of the smallest distance: no other is smaller by more than `ACCURACY` or `ACCURACY_PART` of it."""
        wanted = np.ones(self._count, dtype=bool)
        wanted[list(without)] = False
        stretches = self._stretches
        while True:
            measured = np.flatnonzero(wanted[self._pairs])
            closest = int(measured[np.argmin(self._distances[measured])])
            best = float(self._distances[closest])
            below = best - max(ACCURACY, ACCURACY_PART * best)
            chosen = np.flatnonzero((stretches.table[_BOUND] < below) & wanted[stretches.pairs])
            if not len(chosen):
                return float(self._places[closest]), int(self._pairs[closest])
            self._divide(_first_of(chosen, stretches.table[_BOUND, chosen], _DIVIDED))

    def first_contact(
        self, margins: np.ndarray, touches: Callable[[float, int], bool]
    ) -> tuple[tuple[float, int] | None, np.ndarray]:
        """Find the first place at which two bodies come to their margin, shape (p,) [m], as ``touches(place, pair)`` confirms.

        Returns:
            first: Place and pair; None: none do. No contact is earlier, except one during which no point of a pair moves further
                than `RESOLUTION`: the bodies then are closer than the margin by at most half of that.
            doubtful: Shape (k,). Earlier rows in which a pair is at its margin, and neither bound nor measurement decides.
        """
        first: tuple[float, int] | None = None
        examined, doubtful = 0, []
        limits = margins + TOLERANCE
        while True:
            within = examined + np.flatnonzero(self._distances[examined:] <= limits[self._pairs[examined:]])
            examined = len(self._distances)
            for index in within[np.argsort(self._places[within], kind="stable")].tolist():
                place, pair = float(self._places[index]), int(self._pairs[index])
                if first is None or place < first[0]:
                    if touches(place, pair):
                        first = place, pair
                    else:
                        doubtful.append((place, place))
            stretches = self._stretches
            open_ = stretches.table[_BOUND] < limits[stretches.pairs]
            if first is not None:
                open_ &= stretches.table[_LOW] < first[0]
            chosen = np.flatnonzero(open_)
            chosen = chosen[stretches.divisible(chosen)]
            if not len(chosen):
                left = np.flatnonzero(open_)
                doubtful += zip(stretches.table[_LOW, left].tolist(), stretches.table[_HIGH, left].tolist())
                return first, _rows_within(doubtful, math.inf if first is None else first[0])
            # earlier ones first: a contact that is found ends the search of all that comes later
            self._divide(_first_of(chosen, stretches.table[_LOW, chosen], _DIVIDED))

    def _divide(self, chosen: np.ndarray) -> None:
        """Measure somewhere within stretches, and put their two parts in their place."""
        places, pairs = self._stretches.middles(chosen), self._stretches.pairs[chosen]
        distances = self._measure(places, pairs)
        self._places = np.concatenate((self._places, places))
        self._pairs = np.concatenate((self._pairs, pairs))
        self._distances = np.concatenate((self._distances, distances))
        self._stretches.divide(chosen, places, distances, self._travel.at(places, pairs))


class _Stretches:
    """Stretches of a motion between two places, each of one of `pairs`, at first one of each from 0 to the last row.

    Kept of both ends: a lower bound of the distance, and the travel of the pair up to there. Between them the distance is nowhere
    smaller than half of what is left of both when the travel between is taken off. `distances`, `moved`: shape (2, p) [m].
    """

    def __init__(self, last: float, distances: np.ndarray, moved: np.ndarray):
        self.pairs = np.arange(distances.shape[1])
        self.table = np.empty((7, len(self.pairs)))
        self.table[_LOW], self.table[_HIGH] = 0.0, last
        self.table[_AT_LOW], self.table[_AT_HIGH] = distances
        self.table[_MOVED_LOW], self.table[_MOVED_HIGH] = moved
        self.table[_BOUND] = _bounds(self.table)

    def divisible(self, which: np.ndarray) -> np.ndarray:
        """Return whether the bodies move on some stretches."""
        return self.table[_MOVED_HIGH, which] - self.table[_MOVED_LOW, which] > RESOLUTION

    def middles(self, which: np.ndarray) -> np.ndarray:
        """Return where to measure in some stretches, shape (k,): about where the bounds from both ends meet.

        In a row as long as there is one in between, then between two.
        """
        stretch = self.table[:, which]
        lows, highs, at_lows, at_highs = stretch[:4]
        ways = np.maximum(stretch[_MOVED_HIGH] - stretch[_MOVED_LOW], 1e-300)
        # not too near an end, or the search would hardly get on
        part = np.clip(0.5 + 0.5 * (at_lows - at_highs) / ways, _EDGE, 1.0 - _EDGE)
        places = lows + part * (highs - lows)
        first, last = np.floor(lows) + 1.0, np.ceil(highs) - 1.0
        return np.where(first <= last, np.clip(np.round(places), first, last), places)

    def divide(self, which: np.ndarray, places: np.ndarray, distances: np.ndarray, moved: np.ndarray) -> None:
        """Replace stretches by their two parts, given what was measured between them."""
        first = self.table[:, which]
        second = first.copy()
        first[_HIGH], first[_AT_HIGH], first[_MOVED_HIGH] = places, distances, moved
        second[_LOW], second[_AT_LOW], second[_MOVED_LOW] = places, distances, moved
        # an end is no nearer than this, either
        np.maximum(first[_AT_LOW], distances - (moved - first[_MOVED_LOW]), out=first[_AT_LOW])
        np.maximum(second[_AT_HIGH], distances - (second[_MOVED_HIGH] - moved), out=second[_AT_HIGH])
        first[_BOUND], second[_BOUND] = _bounds(first), _bounds(second)
        self.table[:, which] = first
        self.table = np.concatenate((self.table, second), axis=1)
        self.pairs = np.concatenate((self.pairs, self.pairs[which]))


def _bounds(stretch: np.ndarray) -> np.ndarray:
    """Return a lower bound of the distance on each stretch [m]."""
    return (stretch[_AT_LOW] + stretch[_AT_HIGH] - (stretch[_MOVED_HIGH] - stretch[_MOVED_LOW])) / 2


def _rows_within(stretches: Sequence[tuple[float, float]], end: float) -> np.ndarray:
    """Return the rows on some stretches that are before a place."""
    rows = {row for low, high in stretches for row in range(math.ceil(low), math.floor(high) + 1)}
    return np.array(sorted(row for row in rows if row < end), dtype=int)


def _first_of(chosen: np.ndarray, order: np.ndarray, count: int) -> np.ndarray:
    """Return the `count` of lowest order."""
    if len(chosen) <= count:
        return chosen
    return chosen[np.argsort(order, kind="stable")[:count]]

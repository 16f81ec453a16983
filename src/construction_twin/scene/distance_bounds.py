"""The smallest of many distances on a motion, and the first contact, found without measuring all of them.

Between two poses the distance of two bodies changes by at most the motion of the bodies, which bounds the distances between two
measured poses: in all rows between them, and in all that lies between two rows. Metres and radians; rows of joint values in
Pinocchio's order.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from construction_twin.scene.collision_bodies import Body, RobotBodies

#: Accuracy of a measured distance [m]: Coal's own tolerance.
TOLERANCE = 1e-6
#: A smallest distance may be larger than the smallest between two rows by so much [m], or by this part of it if that is more: a
#: body that turns beside another at a constant distance would take hundreds of measurements a row.
BETWEEN, BETWEEN_PART = 1e-4, 0.01
#: A contact is sought in ever shorter parts of a motion, until no point of a pair moves further than this [m].
RESOLUTION = 2e-5
#: A stretch between two rows is divided no nearer to its ends than this part of it.
_EDGE = 0.1
#: Every so many rows all pairs are measured before the search begins.
_STRIDE = 64


class _Gap(NamedTuple):
    """A pair between two measured places, ordered by the lower bound of its distance there."""

    bound: float
    low: float
    high: float
    pair: int
    at_low: float
    at_high: float


def levers(robot: RobotBodies, bodies: Sequence[Body], pairs: Sequence[tuple], strokes: np.ndarray) -> np.ndarray:
    """Return how far the two bodies of each pair can move relative to each other per unit of each joint.

    Args:
        pairs: Their first two entries are indices into `bodies`.
        strokes: Shape (size,). Largest absolute value of each joint, Pinocchio's order; used for prismatic joints [m].

    Returns:
        Shape (size, p). [m/rad], or 1 for prismatic joints; Pinocchio's order.
    """
    model = robot.model
    per_body, _ = body_levers(robot, bodies, strokes)
    moves = np.array(
        [[place in joints for place in range(model.nq)] for joints in map(partial(_joints_below, robot), bodies)]
    ).T
    if not len(pairs):
        return np.zeros((model.nq, 0))
    first, second = np.array([(pair[0], pair[1]) for pair in pairs]).T
    # a joint that moves both bodies moves them together
    return np.where(moves[:, first] ^ moves[:, second], per_body[:, first] + per_body[:, second], 0.0)


def body_levers(robot: RobotBodies, bodies: Sequence[Body], strokes: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """Return bounds of the motion of a body's points per unit of each joint, and of their distance from the root.

    Args:
        strokes: Shape (size,). As of `levers`.

    Returns:
        levers: Shape (size, b). [m/rad], or 1 for prismatic joints; Pinocchio's order. 0 for a joint that does not move the body.
        reaches: Length b. Largest distance of any point of it from the root at any joint values [m].
    """
    model = robot.model
    per_body = np.zeros((model.nq, len(bodies)))
    reaches = []
    for column, body in enumerate(bodies):
        body.geometry.computeLocalAABB()
        centre = body.placement.act(np.array(body.geometry.aabb_center))
        distance = float(np.linalg.norm(centre)) + body.geometry.aabb_radius
        joint = body.joint
        while joint:
            index = model.joints[joint].idx_q
            linear = model.joints[joint].shortname().startswith("JointModelP")
            per_body[index, column] = 1.0 if linear else distance
            distance += float(np.linalg.norm(model.jointPlacements[joint].translation)) + linear * strokes[index]
            joint = model.parents[joint]
        reaches.append(distance)
    return per_body, reaches


def _joints_below(robot: RobotBodies, body: Body) -> set[int]:
    """Return the places, in Pinocchio's configuration, of the joints that move a body."""
    model, joint, places = robot.model, body.joint, set()
    while joint:
        places.add(model.joints[joint].idx_q)
        joint = model.parents[joint]
    return places


class Motion:
    """The motion of many pairs through rows of joint values, each joint going evenly from one row to the next.

    A place on it is a number of rows: 3.5 is half way from row 3 to row 4.

    Args:
        travel: Shape (m, p). For each pair, an upper bound of the relative motion of its bodies from the first row to each row [m].
        measure_row: Returns the distances of all pairs in a row, shape (p,) [m].
        measure: Returns the distance of one pair at a place [m]: ``measure(place, pair)``.
    """

    def __init__(
        self,
        travel: np.ndarray,
        measure_row: Callable[[int], np.ndarray],
        measure: Callable[[float, int], float],
    ):
        self._travel, self._measure = travel, measure
        # beyond the last row nothing moves; the table needs one row more to interpolate in
        self._steps = np.vstack([np.diff(travel, axis=0), np.zeros((1, travel.shape[1]))])
        self._rows = np.unique(np.linspace(0, len(travel) - 1, 1 + -(-len(travel) // _STRIDE)).astype(int))
        self._known = np.array([measure_row(int(row)) for row in self._rows])

    def smallest(self, without: Sequence[int] = ()) -> tuple[float, int]:
        """Find the smallest distance of all pairs anywhere on the motion.

        Args:
            without: Pairs that are left out; not all of them.

        Returns:
            place
            pair: Where the smallest distance is. No other in a row is smaller by more than `TOLERANCE`, and none between two rows
                by more than `BETWEEN` or `BETWEEN_PART` of it.
        """
        known = self._known
        if len(without):
            known = known.copy()
            known[:, list(without)] = math.inf
        at, closest = np.unravel_index(np.argmin(known), known.shape)
        best, best_place, best_pair = float(known[at, closest]), float(self._rows[at]), int(closest)
        heap = self._gaps(known, best - TOLERANCE)
        while heap and heap[0].bound < best - TOLERANCE:
            gap = heapq.heappop(heap)
            if gap.high - gap.low <= 1 and gap.bound >= best - max(BETWEEN, BETWEEN_PART * best):
                continue
            place = self._middle(gap)
            distance = self._measure(place, gap.pair)
            if distance < best:
                best, best_place, best_pair = distance, place, gap.pair
            for half in self._halves(gap, place, distance):
                if half.bound < best - TOLERANCE:
                    heapq.heappush(heap, half)
        return best_place, best_pair

    def first_contact(self, margins: np.ndarray, touches: Callable[[float, int], bool]) -> tuple[float, int] | None:
        """Find where two bodies first touch; None if none do anywhere on the motion.

        Args:
            margins: Shape (p,). At this distance or less two bodies touch [m].
            touches: Whether a pair touches at a place, asked where the distance says so: ``touches(place, pair)``.

        Returns:
            place
            pair: No contact is earlier, except one during which no point of a pair moves further than `RESOLUTION`: two bodies then
                come closer than the margin by no more than half of that.
        """
        first: tuple[float, int] | None = None
        heap = self._gaps(self._known, margins + TOLERANCE)
        for row, known in zip(self._rows.tolist(), self._known):
            for pair in np.flatnonzero(known <= margins + TOLERANCE).tolist():
                if (first is None or row < first[0]) and touches(float(row), pair):
                    first = float(row), pair
        # earlier ones first: a contact that is found ends the search of all that comes later
        order = [(gap.low, gap) for gap in heap]
        heapq.heapify(order)
        while order and (first is None or order[0][0] < first[0]):
            _, gap = heapq.heappop(order)
            if self._way(gap) <= RESOLUTION:
                continue
            place = self._middle(gap)
            distance = self._measure(place, gap.pair)
            if distance <= margins[gap.pair] + TOLERANCE and (first is None or place < first[0]):
                first = (place, gap.pair) if touches(place, gap.pair) else first
            for half in self._halves(gap, place, distance):
                if half.bound < margins[gap.pair] + TOLERANCE:
                    heapq.heappush(order, (half.low, half))
        return first

    def _gaps(self, known: np.ndarray, below: np.ndarray | float) -> list[_Gap]:
        """Return the stretches between measured rows on which a pair may be closer than a distance, as a heap."""
        rows = self._rows
        bounds = (known[:-1] + known[1:] - np.diff(self._travel[rows], axis=0)) / 2
        heap = [
            _Gap(
                bounds[gap, pair],
                float(rows[gap]),
                float(rows[gap + 1]),
                int(pair),
                known[gap, pair],
                known[gap + 1, pair],
            )
            for gap, pair in np.argwhere(bounds < below)
        ]
        heapq.heapify(heap)
        return heap

    def _at(self, place: float, pair: int) -> float:
        """Return the travel of a pair up to a place [m]."""
        row = int(place)
        return float(self._travel[row, pair] + (place - row) * self._steps[row, pair])

    def _way(self, gap: _Gap) -> float:
        return self._at(gap.high, gap.pair) - self._at(gap.low, gap.pair)

    def _middle(self, gap: _Gap) -> float:
        """Return where the bounds from both ends meet: in a row as long as there is one in between, then between two."""
        low, high, moved = gap.low, gap.high, self._travel[:, gap.pair]
        meet = (self._at(low, gap.pair) + self._at(high, gap.pair) + gap.at_low - gap.at_high) / 2
        first, last = math.floor(low) + 1, math.ceil(high) - 1
        if first <= last:
            return float(np.searchsorted(moved[first:last], meet) + first)
        row = int(low)
        step = self._steps[row, gap.pair]
        place = row + (meet - moved[row]) / step if step > 0.0 else low
        # not too near an end, or the search would hardly get on
        edge = _EDGE * (high - low)
        return min(max(place, low + edge), high - edge)

    def _halves(self, gap: _Gap, place: float, distance: float) -> Iterator[_Gap]:
        """Return the parts of a stretch before and after a place that was measured."""
        middle = self._at(place, gap.pair)
        before, after = middle - self._at(gap.low, gap.pair), self._at(gap.high, gap.pair) - middle
        yield _Gap((gap.at_low + distance - before) / 2, gap.low, place, gap.pair, gap.at_low, distance)
        yield _Gap((distance + gap.at_high - after) / 2, place, gap.high, gap.pair, distance, gap.at_high)

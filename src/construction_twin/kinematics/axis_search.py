"""The search along a linear axis for the place of the carriage at which a branch of the arm is nearest to a seed.

The axis is divided, coarsely, and the arm's branches are solved at all places of the division at once. A simple bound tells in
which intervals between two places a branch may come nearer to the seed than at any place. Of those, the interval that promises
most is divided at the place where it does (`axis_intervals`), again and again, until none can hold anything nearer.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from construction_twin.kinematics.axis_intervals import (
    EITHER_WAY,
    ROUNDING,
    Aim,
    Interval,
    Node,
    either_way,
    make_intervals,
    make_node,
)
from construction_twin.kinematics.closed_form import SLOTS, ClosedFormInverse
from construction_twin.kinematics.opw_along import OpwAlong
from construction_twin.kinematics.solution import TURN

#: Number of evenly spaced places along the axis.
_PLACES = 41
#: Where the wrist centre passes axis 1 more closely than the first [m], places are added where joint 1 has turned by these angles
#: [rad]; not closer than the last [m].
_PASSING, _TURNS, _CLOSEST = 0.2, np.tan([-1.3, -0.8, 0.0, 0.8, 1.3]), 1e-6
#: Joints 2 and 3 further out of range than this at both ends of an interval are so between them [rad].
_FAR = 0.15
#: A joint that moves by more in an interval may turn round in it, or move faster within [rad]; what slower ones may gain by
#: turning round [rad].
_FAST, _GAIN = 0.35, 0.02
#: Nearer by less is not looked for [rad].
_NEARER = 5e-7
#: A wrist that comes closer to singular than this counts as exactly singular: only the sum of joints 4 and 6 is given [rad]. Beside
#: such a place the arm is solved this far away [m].
_SINGULAR, _ASIDE = 4e-7, 1e-6
#: Most intervals divided.
_DIVISIONS = 1000
#: Of each slot, the one with the other elbow.
_PARTNERS = np.arange(len(SLOTS)) ^ 1


@dataclass(frozen=True, eq=False)
class Samples:
    """The arm's branches at places along the axis.

    Attributes
    ----------
    flange : array, shape (4, 4)
        The target as `ClosedFormInverse.flange` gives it, with the carriage at zero.
    places : array, shape (k,)
        Of each sample [m]; those of a branch are in a row, ascending.
    slots : array of int, shape (k,)
        Branch of each sample.
    q : array, shape (6, k)
        [rad]; nan where a branch is missing.
    left : array of int, shape (i,)
        Samples with which intervals begin; they end with the next one.
    singular : list of float
        Places where the wrist is exactly singular [m], as far as found.
    edges : list of float
        Places just within an edge of a shoulder's reach [m].
    edges_known : bool
        No branch ends within an interval.
    """

    flange: np.ndarray
    places: np.ndarray
    slots: np.ndarray
    q: np.ndarray
    left: np.ndarray
    singular: list[float]
    edges: list[float]
    edges_known: bool


@dataclass(frozen=True, eq=False)
class Found:
    """A place on a branch within the ranges.

    Attributes
    ----------
    square : float
        Squared distance from the seed.
    q : array, shape (7,)
        The carriage's place [m], then the arm's joints [rad].
    slot : int
        The branch.
    """

    square: float
    q: np.ndarray
    slot: int


@dataclass(frozen=True, eq=False)
class Measured:
    """Samples with respect to an aim.

    Attributes
    ----------
    away : array, shape (7, k)
        Distance of place [m] and joints [rad] from the seed.
    nearest : array, shape (7, k)
        The same with the whole turns nearest to the seed even where they are out of range.
    squares : array, shape (k,)
        Squared distance; nan where a branch is missing.
    excess : array, shape (k,)
        By how much the worst joint is out of range [rad].
    """

    away: np.ndarray
    nearest: np.ndarray
    squares: np.ndarray
    excess: np.ndarray


class AxisSearch:
    """Searches along the axis.

    Parameters
    ----------
    arm : ClosedFormInverse
        The six joints on the carriage.
    travel : array, shape (3,)
        Direction in which the carriage travels, in the directions of the arm's model.
    low, high : float
        The carriage's range [m].
    """

    def __init__(self, arm: ClosedFormInverse, travel: np.ndarray, low: float, high: float):
        self._arm, self._along = arm, OpwAlong(arm.model, travel)
        self._travel = travel
        self._low, self._high = low, high
        self._even = np.linspace(low, high, _PLACES)
        robot = arm.chain.robot
        self._lower, self._upper = np.array(robot.lower)[:, None], np.array(robot.upper)[:, None]
        # of joints 2 and 3: middle of the range, and half of it with a margin
        self._middle = (0.5 * (self._lower + self._upper))[1:3, 0]
        self._half = (0.5 * (self._upper - self._lower))[1:3, 0] + _FAR
        self._half_ranges = 0.5 * (self._upper - self._lower)
        signs = arm.model.signs
        self._sense = float(signs[3] * signs[5])
        self._straight = signs[4] * arm.model.offsets[4]

    def sample(self, flange: np.ndarray, place: float, wanted: np.ndarray) -> Samples:
        """Return the branches at evenly spaced places, at a given one, and at those that `opw_along` names.

        Parameters
        ----------
        flange : array, shape (4, 4)
            As in `Samples`.
        place : float
            [m]
        wanted : array of bool, shape (8,)
            Which branches.
        """
        edges, at_axis = self._along.steep_places(flange)
        edges = [edge for edge in edges if self._low < edge < self._high]
        more = [place, *edges]
        if at_axis is not None and at_axis[1] < _PASSING:
            more += (at_axis[0] + max(at_axis[1], _CLOSEST) * _TURNS).tolist()
        places = np.concatenate([self._even, [min(max(each, self._low), self._high) for each in more]])
        q, lost = self._solve(flange, places)
        singular = places[lost.any(axis=1)].tolist() if lost.any() else []
        if singular:
            aside = [each + away for each in singular for away in (-_ASIDE, _ASIDE)]
            beside = np.minimum(np.maximum(aside, self._low), self._high)
            kept = ~lost.any(axis=1)
            places = np.concatenate([places[kept], beside])
            q = np.concatenate([q[kept], self._solve(flange, beside)[0]])
        order = places.argsort(kind="stable")
        places, q = places[order], q[order]
        two = q[:, :, 1:3] - self._middle
        two -= TURN * np.rint(two * (1.0 / TURN))
        near = (np.abs(two, out=two) < self._half).all(axis=2).T & wanted[:, None]
        # one row for each branch; an interval counts if either of its ends does
        needed = np.zeros((len(SLOTS), len(places) + 1), dtype=bool)
        np.logical_or(near[:, 1:], near[:, :-1], out=needed[:, 1:-1])
        if at_axis is not None:
            # all edges of the reach are among the places: between a place on a branch and one that is not, there is nothing
            exists = ~np.isnan(two[:, :, 0]).T
            needed[:, 1:-1] &= exists[:, 1:]
            needed[:, 1:-1] &= exists[:, :-1]
        kept = needed[:, 1:] | needed[:, :-1]
        slots, rows = kept.nonzero()
        left = needed[:, 1:][slots, rows].nonzero()[0]
        picked = np.ascontiguousarray(q[rows, slots].T)
        return Samples(flange, places[rows], slots, picked, left, singular, edges, at_axis is not None)

    def aim(self, seed: np.ndarray, turns: Sequence[int]) -> Aim:
        """Return what to search for; see `Aim`."""
        low, high = self._lower[:, 0] - seed[1:], self._upper[:, 0] - seed[1:]
        return Aim(seed, turns, low.tolist(), high.tolist())

    def measure(self, samples: Samples, aim: Aim) -> Measured:
        """Return samples with respect to an aim: moved by whole turns as near to the seed as the ranges allow, then by the aim's."""
        away = np.empty((7, len(samples.places)))
        np.subtract(samples.places, aim.seed[0], out=away[0])
        joints = away[1:]
        np.subtract(samples.q, aim.seed[1:, None], out=joints)
        joints -= TURN * np.rint(joints * (1.0 / TURN))
        nearest = away.copy()
        # the seed is in range, so besides the nearest turn only the next one towards the range can be in it; out of range, the one
        # that is out by less, so that nothing jumps where the range ends
        for row, low, high in zip(joints, aim.low, aim.high):
            both = low + high
            if high < 0.5 * TURN and both < 0.0:
                row -= TURN * (row > max(high, 0.5 * (both + TURN)))
            elif -low < 0.5 * TURN and both > 0.0:
                row += TURN * (row < min(low, 0.5 * (both - TURN)))
        if any(aim.turns):
            more = TURN * np.array(aim.turns)[:, None]
            joints += more
            nearest[1:] += more
        squares = np.einsum("ij,ij->j", away, away)
        excess = self._excess(joints, aim)
        excess[np.isnan(squares)] = math.inf
        return Measured(away, nearest, squares, excess)

    def _excess(self, joints: np.ndarray, aim: Aim) -> np.ndarray:
        """Return by how much the worst joint is out of range, shape (k,), of distances from the seed, shape (6, k)."""
        out = np.abs(joints - (0.5 * (np.array(aim.low) + aim.high))[:, None])
        out -= self._half_ranges
        return out.max(axis=0)

    def within(self, samples: Samples, measured: Measured, aim: Aim) -> list[Found]:
        """Return the samples within the ranges, the nearest to the seed first."""
        inside = (measured.excess <= ROUNDING).nonzero()[0]
        inside = inside[measured.squares[inside].argsort(kind="stable")]
        return [self._sample(samples, measured, aim, column) for column in inside.tolist()]

    def nearest(
        self,
        samples: Samples,
        measured: Measured,
        aim: Aim,
        at_singular: Callable[[float], float],
        slot: int | None = None,
    ) -> list[Found]:
        """Return the nearest place of the nearest branch, and what was the best before it was found: the nearest first.

        Parameters
        ----------
        samples : Samples
        measured : Measured
            The samples, for the same aim.
        aim : Aim
        at_singular : callable
            Told of each place where the wrist is exactly singular and which may be the nearest [m]; returns the squared
            distance of the nearest solution there.
        slot : int, optional
            Only this branch.
        """
        best = min(map(at_singular, samples.singular), default=math.inf)
        found: list[Found] = []
        costs = np.where(measured.excess <= ROUNDING, measured.squares, math.inf)
        if slot is not None:
            costs[samples.slots != slot] = math.inf
        if len(costs):
            column = int(costs.argmin())
            if costs[column] < best:
                found.append(self._sample(samples, measured, aim, column))
                best = found[0].square
        counter = itertools.count()
        straight = self._straight - float(aim.seed[5]), self._sense
        heap: list[tuple[float, int, int, Interval]] = []

        def put(first: Node, last: Node, own: int) -> None:
            for interval in make_intervals(first, last, aim, straight, samples.edges_known):
                if interval.bound < best:
                    heapq.heappush(heap, (interval.bound, next(counter), own, interval))

        for column in self._promising(samples, measured, aim, best, straight, slot).tolist():
            rates = [self._along.rates(samples.q[:, end].tolist()) for end in (column, column + 1)]
            both = (
                [
                    make_node(away[:, end].tolist(), rate, aim, samples.places[end] in samples.edges)
                    for end, rate in zip((column, column + 1), rates)
                ]
                for away in (measured.away, measured.nearest)
            )
            (first, last), (near_first, near_last) = both
            own = int(samples.slots[column])
            put(first, last, own)
            # turns that are out of range at both ends may be within it between them
            if near_first.square < first.square or near_last.square < last.square:
                put(near_first, near_last, own)
        for _ in range(_DIVISIONS):
            if not heap or heap[0][0] >= max(0.0, math.sqrt(best) - _NEARER) ** 2:
                break
            _, _, own, (_, split, first, last) = heapq.heappop(heap)
            place = float(aim.seed[0]) + first.away[0] + split * (last.away[0] - first.away[0])
            expected = [a + split * (b - a) for a, b in zip(first.away, last.away)]
            middle, singular = self._node(samples.flange, place, own, expected, aim)
            middles = [middle, middle]
            if singular:
                best = min(best, at_singular(place))
                middles = [
                    self._node(samples.flange, place + aside, own, expected, aim)[0] for aside in (-_ASIDE, _ASIDE)
                ]
            for node in middles[: 1 + singular]:
                if node.excess <= ROUNDING and node.square < best:
                    best = node.square
                    found.append(Found(best, aim.seed + node.away, own))
            put(first, middles[0], own)
            put(middles[1], last, own)
        found.reverse()
        return found

    def flanges(self, flange: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Return targets as the arm sees them from places, shape (m, 4, 4); `flange` is the one from place zero."""
        flanges = np.empty((len(places), 4, 4))
        flanges[:] = flange
        flanges[:, :3, 3] -= places[:, None] * self._travel
        return flanges

    def _solve(self, flange: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the branches at places, shape (m, 8, 6), and which of them are lost because the wrist is exactly singular."""
        q, wrist, _ = self._arm.branches(self.flanges(flange, places))
        missing = np.isnan(wrist)
        # the elbow does not decide about the reach: where only one of both is missing, its wrist is the reason
        return q, (missing & ~missing[:, _PARTNERS]) | (wrist < _SINGULAR)

    def _promising(
        self,
        samples: Samples,
        measured: Measured,
        aim: Aim,
        best: float,
        straight: tuple[float, float],
        slot: int | None,
    ) -> np.ndarray:
        """Return the samples with which intervals begin that may hold a solution nearer than the best."""
        left = samples.left
        if slot is not None:
            left = left[samples.slots[left] == slot]
        squares, excess = measured.squares, measured.excess
        before, after = measured.nearest[:, left], measured.nearest[:, left + 1]
        steps = np.abs(after - before)
        turned = steps > 0.5 * TURN
        # a joint that turns one way comes as near as this
        gaps = np.minimum(before * before, after * after)
        gaps[(before * after < 0.0) & ~turned] = 0.0
        bounds = gaps.sum(axis=0)
        for column in (
            ((steps[4] > EITHER_WAY) | (steps[6] > EITHER_WAY) | (steps[1] > EITHER_WAY)).nonzero()[0].tolist()
        ):
            bounds[column] = either_way(before[:, column].tolist(), after[:, column].tolist(), straight)
        first_out, last_out = excess[left], excess[left + 1]
        inside0, inside1 = first_out <= ROUNDING, last_out <= ROUNDING
        fastest = steps[1:].max(axis=0)
        # between places out of range a branch may come into range by as much as its joints move
        may_enter = np.minimum(first_out, last_out) < fastest + ROUNDING
        # a branch that runs smoothly within the ranges is lowest beside the lowest of its places
        rises = squares[1:] > squares[:-1]
        joined = np.zeros(len(rises) + 2, dtype=bool)
        joined[left + 1] = True
        before_falls, after_rises = joined.copy(), joined.copy()
        before_falls[1:-1] &= ~rises
        after_rises[1:-1] &= rises
        falls = ~rises[left]
        lowest = np.where(falls, after_rises[left + 2] | ~joined[left + 2], before_falls[left] | ~joined[left])
        wild = (inside0 != inside1) | (may_enter & ~inside0 & ~inside1) | (fastest > _FAST)
        other = (measured.nearest != measured.away).any(axis=0)
        other = (other[left] | other[left + 1]).nonzero()[0]
        if len(other):
            least = np.minimum(*(self._excess(ends[1:, other], aim) for ends in (before, after)))
            wild[other] |= least < fastest[other] + ROUNDING
        promising = (bounds < (math.sqrt(best) + _GAIN) ** 2) & (wild | (lowest & (inside0 | inside1)))
        if not samples.edges_known:
            promising |= np.isnan(squares[left]) != np.isnan(squares[left + 1])
        return left[promising]

    def _node(
        self, flange: np.ndarray, place: float, slot: int, expected: Sequence[float], aim: Aim
    ) -> tuple[Node, bool]:
        """Return a branch at a place, with the whole turns nearest to what is expected; and whether its wrist is exactly singular."""
        q, lost = self._solve(flange, np.array([place]))
        joints = q[0, slot].tolist()
        away = [place - float(aim.seed[0])]
        for value, near, guess in zip(joints, aim.seed[1:].tolist(), expected[1:]):
            value -= near
            away.append(value - TURN * round((value - guess) / TURN) if value == value else value)
        return make_node(away, self._along.rates(joints), aim), bool(lost[0, slot])

    def _sample(self, samples: Samples, measured: Measured, aim: Aim, column: int) -> Found:
        return Found(float(measured.squares[column]), aim.seed + measured.away[:, column], int(samples.slots[column]))

"""The search along a linear axis for the place of the carriage at which a branch of the arm is nearest to a seed.

The axis is divided, coarsely, and the arm's branches are solved at all places of the division at once. A simple bound tells in
which intervals between two places a branch may come nearer to the seed than at any place. Of those, the interval that promises
most is divided at the place where it does (`axis_intervals`), again and again, until none can hold anything nearer.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
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
_PLACES = 31
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
#: The branches with the wrist turned over follow those without, so many.
_WRIST = len(SLOTS) // 2
#: Of each slot, the one with the other elbow.
_PARTNERS = np.arange(len(SLOTS)) ^ 1


@dataclass(frozen=True, eq=False)
class Samples:
    """The arm's branches at places along the axis.

    Samples are numbered branch by branch, in the order of `SLOTS`, those of a branch along the axis.

    Attributes
    ----------
    flange : array, shape (4, 4)
        The target as `ClosedFormInverse.flange` gives it, with the carriage at zero.
    places : array, shape (m,)
        Ascending [m].
    q : array, shape (6, 8 m)
        Of each sample [rad]; nan where the branch is missing or not wanted.
    joined : array of bool, shape (8 m + 1,)
        Which samples bound an interval with the one before; the last number stands for no sample.
    wrist : list of float, length 8
        |sin| of each branch's wrist angle at the given place; nan where a branch is missing.
    singular : list of float
        Places where the wrist is exactly singular [m], as far as found.
    edges : list of float
        Places just within an edge of a shoulder's reach [m].
    edges_known : bool
        No branch ends within an interval.
    """

    flange: np.ndarray
    places: np.ndarray
    q: np.ndarray
    joined: np.ndarray
    wrist: list[float]
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
        self._one = np.empty((1, 4, 4))
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
        places = np.concatenate([self._even, more])
        np.minimum(np.maximum(places, self._low, out=places), self._high, out=places)
        places.sort()
        q, wrist, lost = self._solve(flange, places)
        here = wrist[int(places.searchsorted(place))].tolist()
        singular = places[lost].tolist()
        if singular:
            beside = [each + aside for each in singular for aside in (-_ASIDE, _ASIDE)]
            places = np.sort(np.clip(np.concatenate([places[~lost], beside]), self._low, self._high))
            q, _, _ = self._solve(flange, places)
        # joints 2 and 3 do not depend on how the wrist is turned, and they have less than one turn
        two = q[:, :_WRIST, 1:3] - self._middle
        two -= TURN * np.rint(two * (1.0 / TURN))
        near = (np.abs(two, out=two) < self._half).all(axis=2).T
        counts = near[:, 1:] | near[:, :-1]
        if at_axis is not None:
            # all edges of the reach are among the places: between a place on a branch and one that is not, there is nothing
            exists = ~np.isnan(q[:, :_WRIST, 0]).T
            counts &= exists[:, 1:] & exists[:, :-1]
        joined = np.zeros((2, _WRIST, len(places)), dtype=bool)
        joined[:, :, 1:] = counts
        joined = joined.reshape(len(SLOTS), -1) & wanted[:, None]
        rows = q.transpose(2, 1, 0).copy()
        rows[:, ~wanted] = math.nan
        return Samples(
            flange, places, rows.reshape(6, -1), np.append(joined, False), here, singular, edges, at_axis is not None
        )

    def aim(self, seed: np.ndarray, turns: Sequence[int]) -> Aim:
        """Return what to search for; see `Aim`."""
        low, high = self._lower[:, 0] - seed[1:], self._upper[:, 0] - seed[1:]
        return Aim(seed, turns, low.tolist(), high.tolist())

    def measure(self, samples: Samples, aim: Aim) -> Measured:
        """Return samples with respect to an aim, with the whole turns nearest to the seed within the ranges, and the aim's."""
        away = np.empty((7, samples.q.shape[1]))
        away[0].reshape(len(SLOTS), -1)[:] = samples.places - aim.seed[0]
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
        excess = self._out(joints, aim).max(axis=0)
        excess[np.isnan(squares)] = math.inf
        return Measured(away, nearest, squares, excess)

    def _out(self, joints: np.ndarray, aim: Aim) -> np.ndarray:
        """Return by how much joints are out of range, negative: within it, of distances from the seed, shape (6, k)."""
        out = joints - (0.5 * (np.array(aim.low) + aim.high))[:, None]
        np.abs(out, out=out)
        out -= self._half_ranges
        return out

    def within(self, samples: Samples, measured: Measured, aim: Aim) -> list[Found]:
        """Return the samples within the ranges, the nearest to the seed first."""
        inside = (measured.excess <= ROUNDING).nonzero()[0]
        inside = inside[measured.squares[inside].argsort(kind="stable")]
        return [_found(samples, measured, aim, column) for column in inside.tolist()]

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
        count = len(samples.places)
        first, end = (0, len(costs)) if slot is None else (slot * count, (slot + 1) * count)
        column = first + int(costs[first:end].argmin())
        if costs[column] < best:
            found.append(_found(samples, measured, aim, column))
            best = found[0].square
        counter = itertools.count()
        straight = self._straight - float(aim.seed[5]), self._sense
        heap: list[tuple[float, int, int, Interval]] = []

        def put(first: Node, last: Node, own: int) -> None:
            for interval in make_intervals(first, last, aim, straight, samples.edges_known):
                if interval.bound < best:
                    heapq.heappush(heap, (interval.bound, next(counter), own, interval))

        nodes: dict[tuple[int, bool], Node] = {}

        def node(column: int, nearest: bool) -> Node:
            if (column, nearest) not in nodes:
                away = (measured.nearest if nearest else measured.away)[:, column].tolist()
                rates = self._along.rates(samples.q[:, column].tolist())
                nodes[column, nearest] = make_node(away, rates, aim, samples.places[column % count] in samples.edges)
            return nodes[column, nearest]

        for column, promises, lowest, others in self._promising(samples, measured, aim, best, straight, (first, end)):
            own = column // count
            # beside the lowest place, the branch is lower only where it falls
            if promises and (lowest is None or (node(lowest, False).slope < 0.0) == (lowest == column)):
                put(node(column, False), node(column + 1, False), own)
            if others:
                put(node(column, True), node(column + 1, True), own)
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

    def _solve(self, flange: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return branches, |sin| of their wrist angles, and at which places one is lost because its wrist is exactly singular."""
        q, wrist, _ = self._arm.branches(self.flanges(flange, places))
        missing = np.isnan(wrist)
        # the elbow does not decide about the reach: where only one of both is missing, its wrist is the reason
        return q, wrist, ((missing > missing[:, _PARTNERS]) | (wrist < _SINGULAR)).any(axis=1)

    def _promising(
        self,
        samples: Samples,
        measured: Measured,
        aim: Aim,
        best: float,
        straight: tuple[float, float],
        part: tuple[int, int],
    ) -> Iterator[tuple[int, bool, int | None, bool]]:
        """Yield the samples of a part with which intervals begin whose bounds are below the best.

        With each: whether it may hold a nearer solution; the end at which it is lowest, if it may do so only beside that end; and
        whether turns that are out of range at both ends may be within it between them.
        """
        near = measured.nearest
        before, after = near[:, :-1], near[:, 1:]
        steps = np.abs(after - before)
        fastest = steps[1:].max(axis=0) if len(near[0]) else steps[0]
        # a joint that turns one way comes as near as this
        square = near * near
        gaps = np.minimum(square[:, :-1], square[:, 1:])
        gaps *= (before * after >= 0.0) | (steps > 0.5 * TURN)
        bounds = gaps.sum(axis=0)
        intervals = np.zeros(len(bounds), dtype=bool)
        intervals[slice(*part)] = samples.joined[1:-1][slice(*part)]
        for column in (intervals & (fastest > EITHER_WAY)).nonzero()[0].tolist():
            bounds[column] = either_way(before[:, column].tolist(), after[:, column].tolist(), straight)
        candidates = bounds < (math.sqrt(best) + _GAIN) ** 2
        if not samples.edges_known:
            candidates |= np.isnan(bounds)
        candidates &= intervals
        # a joint out of range at both ends may be within it between them if it moves by as much
        out = self._out(near[1:], aim)
        may_enter = (np.minimum(out[:, :-1], out[:, 1:]) <= steps[1:] + ROUNDING).all(axis=0) | ~(fastest < EITHER_WAY)
        moved = (near != measured.away).any(axis=0).tolist()
        joined, squares, excess = samples.joined.tolist(), measured.squares.tolist(), measured.excess.tolist()
        for column in candidates.nonzero()[0].tolist():
            last = column + 1
            enters = bool(may_enter[column])
            others = enters and (moved[column] or moved[last])
            first_out, last_out = excess[column] > ROUNDING, excess[last] > ROUNDING
            lowest = None
            if first_out and last_out:
                promises = enters
            elif first_out or last_out or not fastest[column] <= _FAST:
                promises = True
            # a branch that runs smoothly within the ranges is lowest beside the lowest of its places
            elif squares[last] <= squares[column]:
                lowest, promises = last, not (joined[last + 1] and squares[last + 1] < squares[last])
            else:
                lowest, promises = column, not (joined[column] and squares[column - 1] < squares[column])
            yield column, promises, lowest, others

    def _node(
        self, flange: np.ndarray, place: float, slot: int, expected: Sequence[float], aim: Aim
    ) -> tuple[Node, bool]:
        """Return a branch at a place, with turns nearest to the expected ones, and whether its wrist is exactly singular."""
        target = self._one
        target[0] = flange
        for row, part in enumerate(self._travel.tolist()):
            target[0, row, 3] -= place * part
        q, wrist, _ = self._arm.branches(target)
        joints, angle = q[0, slot].tolist(), float(wrist[0, slot])
        away = [place - float(aim.seed[0])]
        for value, near, guess in zip(joints, aim.seed[1:].tolist(), expected[1:]):
            value -= near
            away.append(value - TURN * round((value - guess) / TURN) if value == value else value)
        singular = angle < _SINGULAR or (angle != angle and not math.isnan(wrist[0, slot ^ 1]))
        return make_node(away, self._along.rates(joints), aim), singular


def _found(samples: Samples, measured: Measured, aim: Aim, column: int) -> Found:
    """Return a sample as found."""
    square = float(measured.squares[column])
    return Found(square, aim.seed + measured.away[:, column], column // len(samples.places))

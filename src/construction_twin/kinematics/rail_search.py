"""The search along a linear axis for the position of the carriage at which a branch of the arm is nearest to a seed.

The arm's branches are known at positions all along the axis (`rail_samples`). Simple bounds tell in which intervals between two
positions a branch may come nearer to the seed than at any position. Of those, the interval that promises most is divided at the
position where it does (`rail_intervals`), again and again, until none can hold anything nearer.
"""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from construction_twin.kinematics.rail_intervals import (
    EITHER_WAY,
    ROUNDING,
    Aim,
    Interval,
    Node,
    either_way,
    make_intervals,
)
from construction_twin.kinematics.rail_samples import ASIDE, Measured, RailSampler, Samples

#: A joint that moves by more in an interval may turn round in it, or move faster within [rad]; what slower ones may gain by
#: turning round [rad].
_FAST, _GAIN = 0.35, 0.02
#: Nearer by less is not looked for [rad].
_NEARER = 5e-7
#: Most intervals divided.
_DIVISIONS = 1000


@dataclass(frozen=True, eq=False)
class Candidate:
    """A position on a branch within the ranges.

    Attributes:
        square: Squared distance from the seed.
        q: Shape (7,). The carriage's position [m], then the arm's joints [rad].
        slot: The branch.
    """

    square: float
    q: np.ndarray
    slot: int


def within(samples: Samples, measured: Measured, aim: Aim) -> list[Candidate]:
    """Return the samples within the ranges, the nearest to the seed first."""
    inside = (measured.excess <= ROUNDING).nonzero()[0]
    inside = inside[measured.squares[inside].argsort(kind="stable")]
    return [_candidate(samples, measured, aim, column) for column in inside.tolist()]


def nearest(
    sampler: RailSampler,
    samples: Samples,
    measured: Measured,
    aim: Aim,
    at_singular: Callable[[float], float],
    slot: int | None = None,
) -> list[Candidate]:
    """Return the nearest position of the nearest branch, and what was the best before it was found: the nearest first.

    Args:
        measured: The samples, for the same aim.
        at_singular: Told of each position where the wrist is exactly singular and which may be the nearest [m]; returns the squared
            distance of the nearest solution there.
        slot: Only this branch.
    """
    best = min(map(at_singular, samples.singular), default=math.inf)
    found: list[Candidate] = []
    count = len(samples.positions)
    part = slice(0, len(measured.squares)) if slot is None else slice(slot * count, (slot + 1) * count)
    costs = np.where(measured.excess[part] <= ROUNDING, measured.squares[part], math.inf)
    lowest = int(costs.argmin())
    if costs[lowest] < best:
        found.append(_candidate(samples, measured, aim, part.start + lowest))
        best = found[0].square
    heap: list[tuple[float, int, int, Interval]] = []
    counter, straight = itertools.count(), sampler.straight(aim)

    def put(first: Node, last: Node, own: int) -> None:
        for interval in make_intervals(first, last, aim, straight, samples.edges_known):
            if interval.bound < best:
                heapq.heappush(heap, (interval.bound, next(counter), own, interval))

    for first, last, own in _promising(sampler, samples, measured, aim, best, part):
        put(first, last, own)
    for _ in range(_DIVISIONS):
        if not heap or heap[0][0] >= max(0.0, math.sqrt(best) - _NEARER) ** 2:
            break
        _, _, own, (_, split, first, last) = heapq.heappop(heap)
        position = float(aim.seed[0]) + first.away[0] + split * (last.away[0] - first.away[0])
        # beyond the end of a branch: as on the branch
        start, stop = (last, last) if first.square != first.square else (first, last)
        stop = start if last.square != last.square else stop
        expected = [a + split * (b - a) for a, b in zip(start.away, stop.away)]
        middle, singular = sampler.node(samples.flange, position, own, expected, aim)
        middles = [middle]
        if singular:
            best = min(best, at_singular(position))
            beside = (position - ASIDE, position + ASIDE)
            middles = [sampler.node(samples.flange, each, own, expected, aim)[0] for each in beside]
        for node in middles:
            if node.excess <= ROUNDING and node.square < best:
                best = node.square
                found.append(Candidate(best, aim.seed + node.away, own))
        put(first, middles[0], own)
        put(middles[-1], last, own)
    found.reverse()
    return found


def _promising(
    sampler: RailSampler, samples: Samples, measured: Measured, aim: Aim, best: float, part: slice
) -> Iterator[tuple[Node, Node, int]]:
    """Yield the ends of intervals that may hold a solution nearer than the best, and their branch."""
    limit = (math.sqrt(best) + _GAIN) ** 2
    away = measured.nearest[:, part]
    before, after = away[:, :-1], away[:, 1:]
    # a joint that turns one way comes as near as this
    square = away * away
    gaps = np.minimum(square[:, :-1], square[:, 1:])
    gaps *= before * after >= 0.0
    bounds = gaps.sum(axis=0)
    # where it turns by much it may turn the other way: what is left are the others
    changes = before[1::3] - after[1::3], before[6] - after[6]
    flips = (np.abs(changes[0], out=changes[0]).max(axis=0) > EITHER_WAY) | (np.abs(changes[1]) > EITHER_WAY)
    bounds -= flips * (gaps[1] + gaps[4] + gaps[5] + gaps[6])
    candidates = bounds < limit
    if not samples.edges_known:
        candidates |= np.isnan(bounds)
    candidates &= samples.joined[part.start + 1 : part.stop]
    columns = candidates.nonzero()[0]
    if not len(columns):
        return
    before, after = before[:, columns], after[:, columns]
    steps = np.abs(after - before)
    low, high = np.array([aim.low, aim.high])[:, :, None]
    out = np.minimum(*(np.maximum(ends[1:] - high, low - ends[1:]) for ends in (before, after)))
    # a joint out of range at both ends may be within it between them if it moves by as much
    may_enter = (out <= steps[1:] + ROUNDING).all(axis=0) | flips[columns]
    fastest = steps[1:].max(axis=0)
    columns += part.start
    moved = measured.moved[columns] | measured.moved[columns + 1]
    joined, squares, excess = samples.joined.tolist(), measured.squares.tolist(), measured.excess.tolist()
    nodes: dict[tuple[int, bool], Node] = {}

    def node(column: int, nearest: bool) -> Node:
        if (column, nearest) not in nodes:
            nodes[column, nearest] = sampler.sample_node(samples, measured, column, nearest, aim)
        return nodes[column, nearest]

    straight = sampler.straight(aim)
    each = zip(columns.tolist(), fastest.tolist(), may_enter.tolist(), moved.tolist())
    for number, (column, fast, enters, turned) in enumerate(each):
        if fast > EITHER_WAY:
            first, second = before[:, number].tolist(), after[:, number].tolist()
            if either_way(first, second, straight) >= limit:
                continue
        last, own = column + 1, column // len(samples.positions)
        first_out, last_out = excess[column] > ROUNDING, excess[last] > ROUNDING
        if first_out and last_out and fast == fast:  # not nan: the branch does not end here
            promises = enters
        elif first_out or last_out or not fast <= _FAST:
            promises = True
        # a branch that runs smoothly within the ranges is lowest beside the lowest of its positions, where it falls from there
        elif squares[last] <= squares[column]:
            at_lowest = not (joined[last + 1] and squares[last + 1] < squares[last])
            promises = at_lowest and not node(last, False).slope < 0.0
        else:
            at_lowest = not (joined[column] and squares[column - 1] < squares[column])
            promises = at_lowest and not node(column, False).slope > 0.0
        if promises:
            yield node(column, False), node(last, False), own
        # turns that are out of range at both ends may be within it between them
        if turned and enters:
            yield node(column, True), node(last, True), own


def _candidate(samples: Samples, measured: Measured, aim: Aim, column: int) -> Candidate:
    """Return a sample as found."""
    square = float(measured.squares[column])
    return Candidate(square, aim.seed + measured.away[:, column], column // len(samples.positions))

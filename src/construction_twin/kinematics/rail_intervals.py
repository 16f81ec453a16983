"""Intervals between two positions of the carriage: how near a branch of the arm may come to the seed in them, and where to look.

Between two positions every joint is nearly a cubic of the position, and so is the squared distance from the seed; values and rates
(`rail_rates`) at both ends give it. Where joints move too fast for cubics, a bound that holds for joints that turn one way takes
the cubic's part. In plain floats: only few intervals have to be looked at so closely.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import mul, sub
from typing import NamedTuple

import numpy as np

from construction_twin.kinematics.rail_rates import AT_EDGE
from construction_twin.kinematics.ranges import TURN

#: Out of range by less is rounding [rad].
ROUNDING = 3e-7
#: A wrist or an arm that turns by more between two positions may turn either way [rad].
EITHER_WAY = 1.5
#: Cubics that miss the joints' rates by more are not trusted: than this, or than so much and a share of what the joints move [rad].
#: Where they are trusted, the distance is off by at most this fraction of it.
_ROUGH, _AT_MOST, _SHARE, _OFF = 0.12, 1e-3, 0.3, 0.125
#: Half a turn [rad].
_HALF = 0.5 * TURN
#: Where a branch ends in an interval, its distance may fall by this times the root of the interval [rad/sqrt(m)], as the elbow
#: moves; shorter ones are not divided [m].
_FALL, _END = 5.0, AT_EDGE
#: Shorter intervals are not divided [m].
_SHORT = 1e-8


@dataclass(frozen=True, eq=False)
class Aim:
    """What is looked for.

    Attributes:
        seed: Shape (7,). Near which: position [m] and joints [rad], within the ranges.
        turns: Length 6. By how many whole turns the arm's joints are further than the nearest one; None: nearest within the ranges.
        low, high: Length 6. Ends of the joints' ranges, or of these turns, as distances from the seed [rad].
    """

    seed: np.ndarray
    turns: Sequence[int] | None
    low: list[float]
    high: list[float]


class Node(NamedTuple):
    """A branch at a position, all with respect to an `Aim`.

    Attributes:
        away, rates: Length 7. Distance of the position [m] and of the joints [rad] from the seed; and their rates, 1 for the
            position.
        square, slope: Squared distance, and its rate; nan: there is no such branch.
        excess, outwards: By how much the worst joint is out of range [rad], and its rate outwards.
        edge: At an edge of the reach, within `rail_rates.AT_EDGE`.
    """

    away: list[float]
    rates: list[float]
    square: float
    slope: float
    excess: float
    outwards: float
    edge: bool


class Interval(NamedTuple):
    """Two positions of a branch. Ordered by what may be found between them.

    Attributes:
        bound: Nowhere between is the squared distance from the seed less than this, unless at an end; inf: there is nothing
            between.
        split: Where to look next, as a fraction of the way from the first to the last.
    """

    bound: float
    split: float
    first: Node
    last: Node


def make_node(away: list[float], rates: list[float], aim: Aim, edge: bool = False) -> Node:
    """Return a node.

    Args:
        away: Length 7. As in `Node`; nan: there is no such branch.
        rates: Length 6. Of the joints.
        edge: As in `Node`.
    """
    rates = [1.0, *rates]
    square = sum(map(mul, away, away))
    above, below = list(map(sub, away[1:], aim.high)), list(map(sub, aim.low, away[1:]))
    excess, under = max(above), max(below)
    if excess >= under:
        outwards = rates[above.index(excess) + 1]
    else:
        excess, outwards = under, -rates[below.index(under) + 1]
    slope = 2.0 * sum(map(mul, away, rates))
    return Node(away, rates, square, slope, math.inf if square != square else excess, outwards, edge)


def make_intervals(
    first: Node, last: Node, aim: Aim, straight: tuple[float, float], edges_known: bool
) -> list[Interval]:
    """Return the interval between two nodes; two of them if a joint's turns at its ends differ, for each end's to go on.

    Args:
        straight: How far joint 5 is from the seed where axes 4 and 6 are in line [rad]; and 1 if joints 4 and 6 have the same sense
            there, -1 if not.
        edges_known: Whether no branch ends between two positions.
    """
    if first.square != first.square or last.square != last.square:
        return _ending(first, last, edges_known)
    change = list(map(sub, last.away, first.away))
    if max(change) <= _HALF and min(change) >= -_HALF:
        return [_interval(first, last, aim, straight)]
    turns = [0, *(round(each / TURN) for each in change[1:])]
    back = make_node([value - TURN * turn for value, turn in zip(last.away, turns)], last.rates[1:], aim, last.edge)
    on = make_node([value + TURN * turn for value, turn in zip(first.away, turns)], first.rates[1:], aim, first.edge)
    return [_interval(first, back, aim, straight), _interval(on, last, aim, straight)]


def _ending(first: Node, last: Node, edges_known: bool) -> list[Interval]:
    """Return the interval in which a branch ends."""
    square = last.square if first.square != first.square else first.square
    wide = last.away[0] - first.away[0]
    if edges_known or square != square or not wide > _END:
        return []
    return [Interval(max(math.sqrt(square) - _FALL * math.sqrt(wide), 0.0) ** 2, 0.5, first, last)]


def _interval(first: Node, last: Node, aim: Aim, straight: tuple[float, float]) -> Interval:
    """Return the interval between two nodes whose joints go on from one to the other."""
    wide = last.away[0] - first.away[0]
    if not wide > _SHORT:
        return Interval(math.inf, 0.5, first, last)
    if not (first.edge or last.edge):
        return Interval(*_assess(first, last, wide, aim, straight), first, last)
    # from an edge of the reach joints move with the root of the distance, in which they are cubics
    near, far = math.sqrt(AT_EDGE), math.sqrt(AT_EDGE + wide)
    root0, root1 = (near, far) if first.edge else (far, near)
    bound, split = _assess(_scaled(first, 2.0 * root0), _scaled(last, 2.0 * root1), far - near, aim, straight)
    root = near + (far - near) * (split if first.edge else 1.0 - split)
    split = (root * root - AT_EDGE) / wide
    return Interval(bound, split if first.edge else 1.0 - split, first, last)


def _scaled(node: Node, factor: float) -> Node:
    """Return a node with rates against something other than the position."""
    rates = [factor * rate for rate in node.rates]
    return node._replace(rates=rates, slope=factor * node.slope, outwards=factor * node.outwards)


def _assess(first: Node, last: Node, wide: float, aim: Aim, straight: tuple[float, float]) -> tuple[float, float]:
    """Return bound and division of the interval between two nodes."""
    half = 0.5 * wide
    change = list(map(sub, last.away, first.away))
    missed = [each - half * (u + v) for each, u, v in zip(change, first.rates, last.rates)]
    error = math.hypot(*missed)
    if not error < min(_ROUGH, _AT_MOST + _SHARE * math.hypot(*change)):
        return _rough(first, last, missed, straight)
    f0, f1 = first.square, last.square
    g0, g1 = wide * first.slope, wide * last.slope
    third = g0 + g1 - 2.0 * (f1 - f0)
    second = f1 - f0 - g0 - third
    off = math.sqrt(max(f0, f1)) * error * _OFF

    def least(at: float) -> float:
        """Return below what the squared distance is not at a fraction of the way: the cubic less its greatest error."""
        room = at * (1.0 - at)
        return f0 + at * (g0 + at * (second + at * third)) - 32.0 * off * room * room

    vertex, bound = math.nan, least(0.5)
    root = second * second - 3.0 * third * g0
    if root >= 0.0 and (root := second + math.sqrt(root)):
        at = -g0 / root
        if 0.0 < at < 1.0:
            vertex, bound = at, min(bound, least(at))
    leaves, enters = last.excess > ROUNDING, first.excess > ROUNDING
    if not (leaves or enters):
        return bound, vertex if vertex == vertex else 0.5
    if leaves and enters:
        bound = min(bound, f0, f1) if _may_enter(first, last, wide, aim) else math.inf
        return bound, 0.5
    end = _end_of_range(first, last, wide)
    at_end = least(end)
    if vertex < end if leaves else vertex > end:
        return min(bound, at_end), vertex
    return at_end, end


def _end_of_range(first: Node, last: Node, wide: float) -> float:
    """Return where a range ends, as a fraction: Newton's step from the end that is nearer to it, or else the chord."""
    e0, e1 = first.excess, last.excess
    slope = wide * (first.outwards if abs(e0) < abs(e1) else last.outwards)
    if slope:
        at = -e0 / slope if abs(e0) < abs(e1) else 1.0 - e1 / slope
        if 0.0 < at < 1.0:
            return at
    return e0 / (e0 - e1)


def _may_enter(first: Node, last: Node, wide: float, aim: Aim) -> bool:
    """Return whether every joint may be in its range somewhere between two nodes out of range."""
    third = wide / 3.0
    for joint, (low, high) in enumerate(zip(aim.low, aim.high), 1):
        a, b = first.away[joint], last.away[joint]
        controls = (a, a + third * first.rates[joint], b - third * last.rates[joint], b)
        if min(controls) > high + ROUNDING or max(controls) < low - ROUNDING:
            return False
    return True


def _rough(first: Node, last: Node, missed: list[float], straight: tuple[float, float]) -> tuple[float, float]:
    """Return bound and division of an interval in which joints move too fast for cubics.

    It is divided where half of the fast motion is done. For a wrist that passes its singularity, that is the bisector of the angle
    that joint 4 turns.
    """
    a0, a1 = first.away, last.away
    if max(abs(a1[joint] - a0[joint]) for joint in (1, 4, 6)) > EITHER_WAY:
        bound = either_way(a0, a1, straight)
        if abs(a1[1] - a0[1]) <= EITHER_WAY:
            sin0, sin1 = abs(math.sin(a0[5] - straight[0])), abs(math.sin(a1[5] - straight[0]))
            return bound, min(max(sin0 / (sin0 + sin1), 1e-9), 1.0 - 1e-9)
    else:
        bound = sum([0.0 if a * b < 0.0 else min(a * a, b * b) for a, b in zip(a0, a1)])
    # nan: at a singularity itself
    worst = max(range(7), key=lambda joint: abs(missed[joint]) if missed[joint] == missed[joint] else math.inf)
    pace0, pace1 = (
        math.sqrt(min(abs(rate) + 0.5, 1e12)) if rate == rate else 1e6
        for rate in (first.rates[worst], last.rates[worst])
    )
    return bound, pace1 / (pace0 + pace1)


def either_way(first: Sequence[float], last: Sequence[float], straight: tuple[float, float]) -> float:
    """Return a bound below the squared distance where joints turn fast, and so perhaps the other way round.

    Args:
        first, last: Length 7. Distances from the seed at both ends, as `Node.away`.
        straight: See `make_intervals`.
    """
    gaps = [0.0 if a * b < 0.0 and abs(a - b) < 0.5 * TURN else min(a * a, b * b) for a, b in zip(first, last)]
    bound = gaps[0] + gaps[2] + gaps[3]
    if abs(last[1] - first[1]) > EITHER_WAY and abs(last[1] - first[1]) < TURN - EITHER_WAY:
        return bound  # the wrist centre passes axis 1, and the wrist turns with joint 1
    # joints 4 and 6 together turn by their sum, or their difference, even if each turns either way
    sense = straight[1] if math.cos(last[5] - straight[0]) > 0.0 else -straight[1]
    return bound + gaps[1] + gaps[5] + 0.5 * _together(first[4] + sense * first[6], last[4] + sense * last[6]) ** 2


def _together(first: float, last: float) -> float:
    """Return the least distance from a whole turn of an angle that goes from one value to another by less than half a turn."""
    first -= TURN * round(first / TURN)
    last -= TURN * round(last / TURN)
    if first * last < 0.0 and abs(first - last) < 0.5 * TURN:
        return 0.0
    return min(abs(first), abs(last))

"""Cubic interpolation between stamped poses: the arithmetic of playout, monitor and evaluation.

A Hermite segment per pair of stamps [ns], with the velocity of the parabola through a stamp and its neighbours: a motion of
constant acceleration is met exactly, also over missing stamps. Without a neighbour it is the segment's mean.
"""

from __future__ import annotations

Pose = tuple[float, ...]


def weights(stamp: int, stamp0: int, stamp1: int, before: int | None, after: int | None) -> tuple[float, float, float]:
    """Return the weights a, b, c of ``q0 + (a * (q0 - q_before) + b * (q1 - q0) + c * (q_after - q1))`` at a stamp.

    In this form equal poses give exactly that pose. `evaluation.alignment.TwinPath` does the same, operation by operation.
    """
    period = stamp1 - stamp0
    fraction = (stamp - stamp0) / period
    rest = 1.0 - fraction
    begin = fraction * rest * rest
    end = -fraction * fraction * rest
    a, b, c = 0.0, fraction * fraction * (3.0 - 2.0 * fraction), 0.0
    if before is None:
        b += begin
    else:
        earlier = stamp0 - before
        b += begin * (earlier / (earlier + period))
        a = begin * (period / earlier * (period / (earlier + period)))
    if after is None:
        b += end
    else:
        later = after - stamp1
        b += end * (later / (later + period))
        c = end * (period / later * (period / (later + period)))
    return a, b, c


def interpolate(
    stamp: int,
    start: tuple[int, Pose],
    end: tuple[int, Pose],
    before: tuple[int, Pose] | None = None,
    after: tuple[int, Pose] | None = None,
) -> Pose:
    """Interpolate between two poses at their stamps, with regard to their neighbours in time, None at the end of what is known."""
    # plain tuples, and no records: these are made and unpacked in every cycle of 4 ms
    stamp0, q0 = start
    stamp1, q1 = end
    if stamp <= stamp0:
        return q0
    if stamp >= stamp1:
        return q1
    qb, qa = (before or start)[1], (after or end)[1]
    a, b, c = weights(stamp, stamp0, stamp1, before and before[0], after and after[0])
    return tuple([v0 + (a * (v0 - vb) + b * (v1 - v0) + c * (va - v1)) for vb, v0, v1, va in zip(qb, q0, q1, qa)])

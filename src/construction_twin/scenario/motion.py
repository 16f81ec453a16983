"""How fast and how far an arm moved, from recorded positions; rad, s, ns."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from construction_twin.core.limits import MotionLimits
from construction_twin.gateway.trace import TraceEntry

#: Of a fraction of a limit: room for the last bits of differences of floating point numbers.
ROUNDING = 1e-6


def limit_usage(
    positions: np.ndarray,
    breaks: np.ndarray,
    limits: MotionLimits,
    decimals: int,
    cycle: float,
    left_out: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest velocity and acceleration of each joint as a fraction of its limit with the format's allowance.

    Args:
        positions: Shape (k, n). One per cycle [rad].
        breaks: Shape (k,). Where a motion begins anew, from rest.
        cycle: The controller's cycle [s].
        left_out: Shape (k,). Positions that do not count.
    """
    allowance = np.array(limits.allowances(decimals, cycle))
    steps = np.diff(positions, axis=0, prepend=positions[:1])
    steps[breaks] = 0.0
    before = np.vstack([np.zeros_like(steps[:1]), steps[:-1]])
    before[breaks] = 0.0
    changes = steps - before
    if left_out is not None:
        steps[left_out] = changes[left_out] = 0.0
    velocity = np.abs(steps).max(axis=0) / cycle / (np.array(limits.velocity) + allowance * cycle / 2)
    acceleration = np.abs(changes).max(axis=0) / cycle**2 / (np.array(limits.acceleration) + allowance)
    return velocity, acceleration


def trace_arrays(entries: Sequence[TraceEntry], cycle: float) -> tuple[np.ndarray, np.ndarray]:
    """Return what arrived of a gateway's trace, and where a motion begins anew: shapes (k, n) and (k,).

    As in `trace_excesses`, a new session begins from rest, and so does what follows a cycle [s] without a reply that arrived.
    """
    standing = np.zeros(len(entries), dtype=bool)
    arrived = np.ones(len(entries), dtype=bool)
    for number, (before, entry) in enumerate(itertools.pairwise(entries), 1):
        if entry.session == before.session:
            arrived[number - 1] = not entry.lost
            standing[number] = entry.lost or entry.time_since(before) > round(cycle * 1000)
    standing = standing[arrived]
    entries = [entry for entry, was_there in zip(entries, arrived) if was_there]
    positions = np.array([entry.position for entry in entries])
    sessions = np.array([entry.session for entry in entries])
    breaks = np.concatenate([[True], sessions[1:] != sessions[:-1]])
    # from rest, but a step is still a step: the one before is taken out by repeating the position
    rows = np.flatnonzero(standing & ~breaks)
    positions = np.insert(positions, rows, positions[rows - 1], axis=0)
    breaks = np.insert(breaks, rows, True)
    return positions, breaks


def distance_after(stamps: np.ndarray, positions: np.ndarray, begin: int, end: int) -> tuple[np.ndarray, float]:
    """Return the largest distance of each joint from its position at `begin`, until `end`, and the time to the arm's rest [s].

    Args:
        stamps: Shape (k,). [ns]
        positions: Shape (k, n). [rad]
        begin, end: [ns]
    """
    # from the cycle before: by its number, because a controller process that was late sends the next ones sooner
    first = max(0, int(np.searchsorted(stamps, begin)) - 1)
    inside = np.arange(first, int(np.searchsorted(stamps, end, side="right")))
    if not len(inside):
        return np.zeros(positions.shape[1]), 0.0
    part = positions[inside]
    moved = np.flatnonzero(np.abs(np.diff(part, axis=0)).max(axis=1, initial=0.0) > 1e-9)
    rest = max(0.0, (stamps[inside[moved[-1] + 1]] - begin) / 1e9) if len(moved) else 0.0
    return np.abs(part - part[0]).max(axis=0), float(rest)

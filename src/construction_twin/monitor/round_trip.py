"""How long the arm's answer to a setpoint takes, on one clock: the monotonic one of the process that saw both.

Pure. Stamps only name the setpoints: a wall clock that is set meanwhile changes nothing.
"""

from __future__ import annotations

import math

from construction_twin.core.units import CYCLE_NS, NANOSECONDS

#: Setpoints that are remembered: 65 s. An arm whose replies get lost may trail by many of them.
KEPT = 16384


class RoundTrips:
    """When each of the last setpoints passed."""

    def __init__(self):
        # two lists that are written over: nothing is made in a cycle
        self._stamps = [0] * KEPT
        self._passed = [0] * KEPT

    def note(self, stamp: int, now: int) -> None:
        """Note that the setpoint with this nominal stamp passed at `now` [ns]."""
        place = stamp // CYCLE_NS % KEPT
        self._stamps[place], self._passed[place] = stamp, now

    def since(self, stamp: int, now: int) -> float:
        """Return how long ago at `now` [ns] the path had come to this stamp [s]; nan when no setpoint nearby is known.

        A stamp between two setpoints is one of the gateway's playout. Where a message waited in a queue the time of its reception
        is an estimate, and may lie a moment before the setpoint passed: 0 then.
        """
        place = stamp // CYCLE_NS % KEPT
        between = stamp - self._stamps[place]
        if stamp == 0 or not -CYCLE_NS < between < CYCLE_NS:
            return math.nan
        return max(now - self._passed[place] - between, 0) / NANOSECONDS

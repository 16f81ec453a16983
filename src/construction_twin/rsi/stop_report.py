"""What a stop does: the way to rest, stated when braking begins, and what it was in the end. Standard library only; rad, m, s."""

from __future__ import annotations

import math

from construction_twin.rsi.follower import Follower
from construction_twin.units import CYCLE_NS, NANOSECONDS


class StopReport:
    """The last stop of one gateway.

    Parameters
    ----------
    linear : tuple of bool, shape (n,)
        Axes in m.
    """

    def __init__(self, linear: tuple[bool, ...]):
        self._linear = linear
        #: What the gateway braked for: ``silence``, ``refused``, ``stop``, ``speed_limit``; "" before the first stop.
        self.cause = ""
        #: Way of each axis and time to rest, as stated when braking began [rad], [m]; [s].
        self.distance: tuple[float, ...] = ()
        self.time = 0.0
        #: The same as it was in the end; empty and None until the arm is at rest.
        self.moved: tuple[float, ...] = ()
        self.took: float | None = None
        self._start: tuple[float, ...] = ()
        self._elapsed = 0

    def begin(self, cause: str, follower: Follower) -> None:
        """State the way to rest; call it when braking begins."""
        self.cause = cause
        self.distance, cycles = follower.braking()
        self.time = cycles * CYCLE_NS / NANOSECONDS
        self.moved, self.took = (), None
        self._start, self._elapsed = follower.position, 0

    def advance(self, follower: Follower, elapsed: int) -> None:
        """Take note of a step of braking that took `elapsed` [ns] of the controller's time."""
        self._elapsed += elapsed
        if follower.at_rest:
            self.end(follower)

    def end(self, follower: Follower) -> None:
        """The arm is at rest."""
        self.moved = tuple([abs(end - start) for start, end in zip(self._start, follower.position)])
        self.took = self._elapsed / NANOSECONDS

    def report(self) -> dict:
        """Return what the status says: deg, mm for linear axes, and s."""
        return {
            "cause": self.cause,
            "distance_deg": self._for_people(self.distance),
            "time_s": self.time,
            "moved_deg": self._for_people(self.moved),
            "took_s": self.took,
        }

    def _for_people(self, ways: tuple[float, ...]) -> list[float]:
        # rounded up: what is stated is never less than what it stands for
        return [
            math.ceil(1e6 * (1e3 * way if slides else math.degrees(way))) / 1e6
            for way, slides in zip(ways, self._linear)
        ]

"""What a stop does: the way to rest, stated when braking begins, and what it was in the end. Standard library only; rad, m, s."""

from __future__ import annotations

import math

from construction_twin.core.follower import Follower
from construction_twin.core.units import CYCLE_NS, NANOSECONDS


class Braking:
    """Braking of a follower from its present step on, as the arm will carry it out.

    Parameters
    ----------
    follower : Follower
    measured : tuple of float, shape (n,)
        Where the arm is, behind the follower by what its servos trail [rad], [m]; empty when it does not do what the follower does,
        or is not known: then the way is the follower's.
    """

    def __init__(self, follower: Follower, measured: tuple[float, ...]):
        ways, cycles = follower.braking()
        #: Where the arm was when it began [rad], [m].
        self.start = measured or follower.position
        #: Way of each axis to rest, what it is behind included [rad], [m].
        self.distance = tuple([way + abs(q - at) for way, q, at in zip(ways, follower.position, self.start)])
        #: Time until the corrections rest [s].
        self.time = cycles * CYCLE_NS / NANOSECONDS
        #: What it has taken so far [ns].
        self.elapsed = 0


class StopReport:
    """The last stop of one gateway.

    Parameters
    ----------
    linear : tuple of bool, shape (n,)
        Axes in m.
    """

    def __init__(self, linear: tuple[bool, ...]):
        self._linear = linear
        #: What the gateway braked for: ``silence``, ``refused``, ``stop``, ``speed_limit``, ``drift``; "" before the first stop.
        self.cause = ""
        #: Way of each axis and time to rest, as stated when braking began [rad], [m]; [s].
        self.distance: tuple[float, ...] = ()
        self.time = 0.0
        #: The same as it was in the end, from where the arm was to where it is told to rest; empty and None until then.
        self.moved: tuple[float, ...] = ()
        self.took: float | None = None
        self._braking: Braking | None = None

    def begin(self, cause: str, follower: Follower, measured: tuple[float, ...], begun: Braking | None = None) -> None:
        """State the way to rest; call it when braking begins, or with what has `begun` before anybody called it a stop."""
        braking = begun or Braking(follower, measured)
        self.cause, self._braking = cause, braking
        self.distance, self.time = braking.distance, braking.time
        self.moved, self.took = (), None
        if begun and follower.at_rest:
            self.end(follower)

    def advance(self, follower: Follower, elapsed: int) -> None:
        """Take note of a step of braking that took `elapsed` [ns] of the controller's time."""
        if self.took is not None:
            return
        self._braking.elapsed += elapsed
        if follower.at_rest:
            self.end(follower)

    def end(self, follower: Follower) -> None:
        """The arm is at rest."""
        self.moved = tuple([abs(end - start) for start, end in zip(self._braking.start, follower.position)])
        self.took = self._braking.elapsed / NANOSECONDS

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

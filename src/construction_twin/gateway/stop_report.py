"""What a stop does: the distance to rest, stated when braking begins, and what it was in the end.

Standard library only; rad, m, s.
"""

from __future__ import annotations

import math

from construction_twin.core.follower import Follower
from construction_twin.core.units import NANOSECONDS


class Braking:
    """Braking of a follower from its present step on, as the arm will carry it out.

    Args:
        measured: Shape (n,). Where the arm is, behind the follower by what its servos trail [rad], [m]; empty when it does not do
            what the follower does, or is not known: then the distance is the follower's.
    """

    def __init__(self, follower: Follower, measured: tuple[float, ...]):
        distances, cycles = follower.braking()
        #: Where the arm was when it began [rad], [m].
        self.start = measured or follower.position
        #: Distance of each axis to rest, including the lag behind the correction [rad], [m].
        self.distance = tuple(
            [distance + abs(q - at) for distance, q, at in zip(distances, follower.position, self.start)]
        )
        #: Time until the corrections rest [s].
        self.time = cycles * follower.cycle
        #: What it has taken so far [ns].
        self.elapsed = 0


class StopReport:
    """The last stop of one gateway."""

    def __init__(self, linear: tuple[bool, ...]):
        self._linear = linear
        #: What the gateway braked for: ``silence``, ``refused``, ``stop``, ``speed_limit``, ``drift``; "" before the first stop.
        self.cause = ""
        #: Account whose stop it was, "" for every other cause and way.
        self.by = ""
        #: Distance of each axis and time to rest, as stated when braking began [rad], [m]; [s].
        self.distance: tuple[float, ...] = ()
        self.time = 0.0
        #: The same as it was in the end, from where the arm was to where it is told to rest; empty and None until then.
        self.moved: tuple[float, ...] = ()
        self.took: float | None = None
        self._braking: Braking | None = None

    def begin(
        self,
        cause: str,
        follower: Follower,
        measured: tuple[float, ...],
        under_way: Braking | None = None,
        by: str = "",
    ) -> None:
        """State the distance to rest; call it when braking begins, or with the braking that was `under_way` before."""
        braking = under_way or Braking(follower, measured)
        self.cause, self.by, self._braking = cause, by, braking
        self.distance, self.time = braking.distance, braking.time
        self.moved, self.took = (), None
        if under_way and follower.at_rest:
            self._end(braking, follower)

    def advance(self, follower: Follower, elapsed: int) -> None:
        """Take note of a step of braking that took `elapsed` [ns] of the controller's time."""
        braking = self._braking
        if self.took is not None or braking is None:
            return
        braking.elapsed += elapsed
        if follower.at_rest:
            self._end(braking, follower)

    def _end(self, braking: Braking, follower: Follower) -> None:
        self.moved = tuple([abs(end - start) for start, end in zip(braking.start, follower.position)])
        self.took = braking.elapsed / NANOSECONDS

    def report(self) -> dict:
        """Return what the status says: deg, mm for linear axes, and s."""
        return {
            "cause": self.cause,
            "by": self.by,
            "distance_deg": self._for_people(self.distance),
            "time_s": self.time,
            "moved_deg": self._for_people(self.moved),
            "took_s": self.took,
        }

    def _for_people(self, distances: tuple[float, ...]) -> list[float]:
        # rounded up: what is stated is never less than what it stands for
        return [
            math.ceil(1e6 * (1e3 * distance if linear else math.degrees(distance))) / 1e6
            for distance, linear in zip(distances, self._linear)
        ]

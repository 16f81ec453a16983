"""What a bad network does to its traffic: profiles, as data. For tests only; times in s."""

from __future__ import annotations

import random
from dataclasses import dataclass


@dataclass(frozen=True)
class Profile:
    """What a link does to its traffic, in both directions alike; of datagrams: only the cut.

    Attributes:
        delay, jitter: Travel time is uniform in delay +- jitter [s]. TCP keeps the order.
        stall: Period and length of the times in which nothing arrives, half a period after the begin for the first [s]; () for
            none.
        cut: Nothing passes for this long from the begin [s]: TCP brings it afterwards, datagrams are lost.
        rate: Bytes per second and direction; 0 for no bound.
    """

    delay: float = 0.0
    jitter: float = 0.0
    stall: tuple[float, float] = ()
    cut: float = 0.0
    rate: float = 0.0

    def travel(self, chance: random.Random) -> float:
        """Draw a travel time [s]."""
        return max(0.0, self.delay + self.jitter * chance.uniform(-1.0, 1.0))

    def released(self, at: float) -> float:
        """Return when what would arrive at `at` [s from the begin] really does, stalls and cut considered."""
        begun = self.stalled_since(at)
        if begun is not None:
            at = begun + self.stall[1]
        return max(at, self.cut)

    def stalled_since(self, at: float) -> float | None:
        """Return when the stall began in which `at` lies, both [s from the begin]; None outside of stalls."""
        if not self.stall or at < self.stall[0] / 2:
            return None
        period, length = self.stall
        into = (at - period / 2) % period
        return at - into if into < length else None


#: The issue's profiles by name, and a line that carries a fifth more than one robot's traffic.
TCP_PROFILES = {
    "delay_20_10": Profile(delay=0.02, jitter=0.01),
    "stall_50ms_1s": Profile(stall=(1.0, 0.05)),
    "stall_200ms_5s": Profile(stall=(5.0, 0.2)),
    "cut_1s": Profile(cut=1.0),
    "throttled": Profile(rate=80_000.0),
}


@dataclass
class Stall:
    """A stall that held something up, from `begin` to `end` [s, `time.monotonic`]: pieces that came in it, by direction."""

    begin: float
    end: float
    up: int = 0
    down: int = 0

"""What a bad network does to its traffic: profiles, as data. For tests only; times in s."""

from __future__ import annotations

import random
from dataclasses import dataclass


@dataclass(frozen=True)
class Profile:
    """What a link does to its traffic, in both directions alike.

    Attributes:
        delay, jitter: Travel time is uniform in delay +- jitter [s]. TCP keeps the order; datagrams overtake each other.
        stall: Period and length of the times in which nothing arrives, half a period after the begin for the first [s]; () for
            none.
        cut: Nothing passes for this long from the begin [s]: TCP brings it afterwards, datagrams are lost.
        rate: Bytes per second and direction of a TCP connection; 0 for no bound.
        loss, duplication, reordering: Fraction of datagrams that are lost; arrive twice; arrive `held_back` later than their travel
            time.
        held_back: [s]
    """

    delay: float = 0.0
    jitter: float = 0.0
    stall: tuple[float, float] = ()
    cut: float = 0.0
    rate: float = 0.0
    loss: float = 0.0
    duplication: float = 0.0
    reordering: float = 0.0
    held_back: float = 0.006

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

    @property
    def for_tcp(self) -> bool:
        """True when a TCP connection can behave like this."""
        return not (self.loss or self.duplication or self.reordering)


#: The issue's profiles by name, and a line that carries a fifth more than one robot's traffic.
TCP_PROFILES = {
    "delay_20_10": Profile(delay=0.02, jitter=0.01),
    "stall_50ms_1s": Profile(stall=(1.0, 0.05)),
    "stall_200ms_5s": Profile(stall=(5.0, 0.2)),
    "cut_1s": Profile(cut=1.0),
    "throttled": Profile(rate=80_000.0),
}
UDP_PROFILES = {
    "loss_1": Profile(loss=0.01),
    "loss_5": Profile(loss=0.05),
    "reordering": Profile(reordering=0.02),
    "duplication": Profile(duplication=0.05),
    "delay": Profile(delay=0.0005, jitter=0.0005),
}


@dataclass
class Stall:
    """A stall that held something up, from `begin` to `end` [s, `time.monotonic`]: pieces that came in it, by direction."""

    begin: float
    end: float
    up: int = 0
    down: int = 0

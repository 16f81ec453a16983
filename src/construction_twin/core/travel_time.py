"""How long messages travel, from stamps and times of reception on two clocks that are never compared [ns]."""

from __future__ import annotations

#: The shortest travel time is forgotten at this rate, so that clocks that drift apart never make fresh messages old.
MAX_DRIFT = 100e-6


class TravelTime:
    """Excess travel time of a stream's messages over the quickest one.

    The smallest difference between reception and stamp is the reference; it grows by `MAX_DRIFT`, to follow clocks that drift
    apart.
    """

    def __init__(self):
        self.restart()

    def restart(self) -> None:
        """Forget the quickest one: the sender's clock may have changed."""
        self._shortest: int | None = None
        self._at = 0

    def excess(self, stamp: int, received: int) -> int:
        """Return the excess of a stamp, received on a monotonic clock [ns], without storing it; negative: quicker than all."""
        if self._shortest is None:
            return 0
        return received - stamp - self._shortest - round((received - self._at) * MAX_DRIFT)

    def record(self, stamp: int, received: int) -> int:
        """Store a message and return its `excess`; the quickest one is the new reference."""
        travelled = received - stamp
        if self._shortest is None:
            shortest = travelled
        else:
            shortest = min(travelled, self._shortest + round((received - self._at) * MAX_DRIFT))
        self._shortest, self._at = shortest, received
        return travelled - shortest

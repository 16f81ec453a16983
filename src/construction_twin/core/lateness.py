"""How much later than the quickest one a setpoint is: what waited in a queue must not be taken for the present.

Pure. Stamps and reception are on two clocks that are never compared, only their difference with its own smallest value. [ns]
"""

from __future__ import annotations

from construction_twin.core.freshness import MAX_DRIFT


class Lateness:
    """Lateness of the members of one stream.

    Unlike `FreshnessCheck` it believes a member that is much earlier at once: the executor's grid moves on by itself, once, when
    its process was not run.
    """

    def __init__(self):
        self._quickest: int | None = None
        self._at = 0

    def of(self, stamp: int, now: int) -> int:
        """Return how much longer than the quickest one a member has travelled [ns].

        Parameters
        ----------
        stamp : int
            Nominal time, on the sender's clock [ns].
        now : int
            Time of reception, on a clock that nobody sets [ns].
        """
        travelled = now - stamp
        if self._quickest is None:
            self._quickest, self._at = travelled, now
        # forgotten slowly, so that clocks that drift apart make nothing late
        self._quickest = min(self._quickest + round((now - self._at) * MAX_DRIFT), travelled)
        self._at = now
        return travelled - self._quickest

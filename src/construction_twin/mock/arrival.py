"""When a datagram arrived, on the monotonic clock: the kernel stamps it with the wall clock, which may be set at any time.

Pure: the clocks are arguments. Standard library only; ns.
"""

from __future__ import annotations

from collections.abc import Callable

#: Two readings of the distance of the clocks differ by more than this only when the wall clock was set in between [ns]. A wall
#: clock that is corrected gradually moves by 2 us in a cycle.
_SET = 500_000
#: Tries for a reading that no switch to another process fell into.
_TRIES = 3
#: Good enough [ns].
_TIGHT = 2_000


class ArrivalClock:
    """Converts stamps of the wall clock to the monotonic one.

    Args:
        wall, monotonic: Return the time [ns].
    """

    def __init__(self, wall: Callable[[], int], monotonic: Callable[[], int]):
        self._wall = wall
        self._monotonic = monotonic
        self._ahead = self._before = self._measure()

    def measure(self) -> None:
        """Read again how far the monotonic clock is ahead of the wall clock; once per cycle."""
        self._before, self._ahead = self._ahead, self._measure()

    def arrival(self, stamp: int, read: int) -> int | None:
        """Return when a datagram arrived.

        Args:
            stamp: The kernel's, on the wall clock [ns].
            read: When it was read, on the monotonic clock [ns].

        Returns:
            On the monotonic clock [ns], not after `read`. None when the wall clock was set while the datagram may have waited: the
            stamp says nothing then.
        """
        now = self._measure()
        if abs(now - self._ahead) > _SET or abs(now - self._before) > _SET:
            return None
        return min(stamp + now, read)

    def _measure(self) -> int:
        best = narrowest = None
        for _ in range(_TRIES):
            begin = self._monotonic()
            wall = self._wall()
            width = self._monotonic() - begin
            if narrowest is None or width < narrowest:
                best, narrowest = begin + width // 2 - wall, width
            if width <= _TIGHT:
                break
        assert best is not None
        return best

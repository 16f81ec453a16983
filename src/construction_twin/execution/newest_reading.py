"""Until when a plan counts as asked for before a stop, on a wall clock that may have been set back.

A plan carries the time at which it was asked for. When the clock is set back while a plan is in the making, that time lies ahead
of the stop that came after it. Pure; times in ns.
"""

from __future__ import annotations

from construction_twin.core.units import NANOSECONDS

#: A clock that was set back is remembered for this long, at least, and so much earlier a plan may have been asked for at most [ns].
REMEMBERED = 30 * NANOSECONDS
#: A plan whose time lies further ahead than this was asked for on a clock that was set back since, or on another PC's [ns].
AHEAD = 5 * NANOSECONDS


class NewestReading:
    """What the wall clock would read if nobody had set it back.

    Args:
        wall, now: Wall clock, and monotonic clock.
    """

    def __init__(self, wall: int, now: int):
        # largest lead of the wall clock over the monotonic one, in the present and in the last `REMEMBERED`
        self._lead = self._lead_before = wall - now
        self._since = now

    def note(self, wall: int, now: int) -> None:
        """Take a reading of both clocks; to be called several times a second."""
        if now - self._since >= REMEMBERED:
            self._lead_before, self._lead, self._since = self._lead, wall - now, now
        self._lead = max(self._lead, wall - now)

    def asked_until(self, wall: int, now: int) -> int:
        """Return the latest time that a plan can carry which was asked for until this moment, at most `REMEMBERED` ahead."""
        self.note(wall, now)
        return min(now + max(self._lead, self._lead_before), wall + REMEMBERED)

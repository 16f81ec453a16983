"""Whether a person's screen had shown the last stop when the person asked to go on. Pure; standard library only.

A `reset` clears what was shown: between the moment that a screen repeats and the request somebody else may have stopped the arm.
"""

from __future__ import annotations

from dataclasses import replace

from construction_twin.core.freshness import Moment, is_newer
from construction_twin.core.units import NANOSECONDS

#: From the moment when a stop is known to the moment of the first `view` that surely shows it [ns]: the bridge's poll and `link`.
SHOWN_AFTER = NANOSECONDS // 4


class SeenStops:
    """When the last stop became known; it has to be noted at least as often as it is asked for."""

    def __init__(self) -> None:
        self._stop: object = None
        self._shown_from: Moment | None = None

    def note(self, stop: object, now: Moment) -> None:
        """Take which stop is the last one that is known, by anything that another one differs in."""
        if stop != self._stop:
            self._stop, self._shown_from = stop, replace(now, at=now.at + SHOWN_AFTER)

    def was_seen(self, seen: Moment) -> bool:
        """Return whether a view of this moment has shown the last stop."""
        return is_newer(seen, self._shown_from)

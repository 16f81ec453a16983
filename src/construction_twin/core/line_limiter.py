"""Which lines of a log are written: at most one of each kind per period. Standard library only."""

from __future__ import annotations

from dataclasses import dataclass

from construction_twin.core.units import NANOSECONDS


@dataclass(frozen=True, slots=True)
class _Written:
    """When a line was written last [ns], and how many of its kind were left out since."""

    at: int
    left_out: int = 0


class LineLimiter:
    """At most one line per reason and period: a sender of rubbish must neither fill the disk nor hide other lines.

    Args:
        period: [ns]
    """

    def __init__(self, period: int = NANOSECONDS):
        self._period = period
        self._lines: dict[str, _Written] = {}

    def note(self, reason: str, now: int) -> str | None:
        """Take a line that is to be written at `now` [ns].

        Args:
            reason: Its kind: one of few, never text that came from outside, because every kind is remembered.
            now: [ns]

        Returns:
            What to append to the line, "" or how many like it were left out before; None when it must not be written.
        """
        last = self._lines.get(reason, _Written(now - self._period))
        if now - last.at < self._period:
            self._lines[reason] = _Written(last.at, last.left_out + 1)
            return None
        self._lines[reason] = _Written(now)
        return f" ({last.left_out} more like this since the last such line)" if last.left_out else ""

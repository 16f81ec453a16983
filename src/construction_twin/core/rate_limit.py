"""Limits of how often something may happen; `now` in ns on a monotonic clock."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from construction_twin.core.units import NANOSECONDS


class LineLimiter:
    """Limits a log to one line per reason and period [ns]."""

    def __init__(self, period: int = NANOSECONDS):
        self._period = period
        # per reason: when a line was written last, and how many were left out since
        self._lines: dict[str, tuple[int, int]] = {}

    def admit(self, reason: str, now: int) -> str | None:
        """Return the suffix of an admitted line, with the number of suppressed ones; None: suppress it. `reason`: a fixed key."""
        written, left_out = self._lines.get(reason, (now - self._period, 0))
        if now - written < self._period:
            self._lines[reason] = written, left_out + 1
            return None
        self._lines[reason] = now, 0
        return f" ({left_out} more like this since the last such line)" if left_out else ""


#: Senders that are known at a time: anybody may call himself something new where a broker knows no accounts.
MOST_SENDERS = 64


@dataclass(frozen=True)
class Pace:
    """How often each sender may do something: `most` times in any `seconds`."""

    most: int
    seconds: float = 1.0

    def __str__(self) -> str:
        return f"{self.most} in {self.seconds:g} s"


class SenderLimits:
    """A pace for each of at most `MOST_SENDERS` senders, by any clock [ns]; others wait until one is forgotten."""

    def __init__(self, pace: Pace):
        self._most, self._span = pace.most, round(pace.seconds * NANOSECONDS)
        #: By sender: when it did something that still counts, oldest first.
        self._times: dict[str, deque[int]] = {}

    def admit(self, sender: str, now: int) -> bool:
        """Count an act of a sender at `now`; return False where its pace forbids it."""
        may = not self.waiting_time(sender, now)
        if may:
            self._times.setdefault(sender, deque()).append(now)
        return may

    def waiting_time(self, sender: str, now: int) -> float:
        """Return how long a sender has to wait from `now` on [ns]."""
        if sender not in self._times and len(self._times) >= MOST_SENDERS:
            self._times = {name: times for name, times in self._times.items() if now - times[-1] < self._span}
            if len(self._times) >= MOST_SENDERS:
                return self._span - (now - min(times[-1] for times in self._times.values()))
        times = self._times.get(sender, deque())
        while times and now - times[0] >= self._span:
            times.popleft()
        if len(times) >= self._most:
            return self._span - (now - times[0])
        if not times:
            self._times.pop(sender, None)
        return 0

"""How often something may happen: a bucket of tokens, a number in any span of time, and either of them for each sender.

Pure: `now` is an argument, in ns on a monotonic clock. Standard library only.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

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


#: Senders that are known at a time: anybody may call himself something new where a broker knows no accounts.
MOST_SENDERS = 64


class Limit(Protocol):
    """A limit on how often."""

    def take(self, now: int) -> bool:
        """Return whether it may happen at `now`, and count it if so."""

    def wait(self, now: int) -> float:
        """Return how long it may not happen from `now` on [ns]; 0: it may."""

    def rest(self, now: int) -> float:
        """Return how long something that was counted still counts from `now` on [ns]; 0: all is forgotten."""


class TokenBucket:
    """Tokens that are used up and come back at a rate.

    Args:
        rate: How many come back per second.
        burst: How many there are at first, and at most: so many may be used at once.
    """

    __slots__ = ("_burst", "_owed", "_rate", "_seen")

    def __init__(self, rate: float, burst: float):
        self._rate = rate
        # tokens are counted in ns, so that whole rates and bursts are exact
        self._burst = burst * NANOSECONDS
        self._owed: float = 0
        self._seen = 0

    def _still_owed(self, now: int) -> float:
        # a clock that goes back gives nothing
        return max(0, self._owed - max(0, now - self._seen) * self._rate)

    def take(self, now: int, amount: float = 1) -> bool:
        """Use up `amount` tokens; return False, and use up none, where there are fewer."""
        owed = self._still_owed(now) + amount * NANOSECONDS
        if owed > self._burst:
            return False
        self._owed, self._seen = owed, now
        return True

    def wait(self, now: int) -> float:
        """Return how long there is no token from `now` on [ns]."""
        return max(0, self._still_owed(now) + NANOSECONDS - self._burst) / self._rate

    def rest(self, now: int) -> float:
        """Return how long the bucket is not full from `now` on [ns]."""
        return self._still_owed(now) / self._rate


class RollingWindow:
    """At most so many in any span of time: a bucket of that size would let twice as many pass in its first one.

    Args:
        span: [ns]
    """

    __slots__ = ("_most", "_span", "_times")

    def __init__(self, most: int, span: int = NANOSECONDS):
        self._most, self._span = most, span
        self._times: deque[int] = deque()

    def _forget(self, now: int) -> None:
        while self._times and now - self._times[0] >= self._span:
            self._times.popleft()

    def take(self, now: int) -> bool:
        """Return whether one more may pass, and count it if so."""
        self._forget(now)
        if len(self._times) >= self._most:
            return False
        self._times.append(now)
        return True

    def wait(self, now: int) -> float:
        """Return how long none may pass from `now` on [ns]."""
        self._forget(now)
        return self._span - (now - self._times[0]) if len(self._times) >= self._most else 0

    def rest(self, now: int) -> float:
        """Return how long one that has passed still counts from `now` on [ns]."""
        self._forget(now)
        return self._span - (now - self._times[-1]) if self._times else 0


class SenderLimits:
    """A limit of its own for each sender; what is known of a sender is forgotten when nothing of it counts any more.

    While `MOST_SENDERS` are known, no other one may do anything.
    """

    def __init__(self, make: Callable[[], Limit]):
        self._make = make
        self._limits: dict[str, Limit] = {}

    def _limit(self, sender: str, now: int) -> Limit | None:
        if sender not in self._limits and len(self._limits) >= MOST_SENDERS:
            self._limits = {name: limit for name, limit in self._limits.items() if limit.rest(now)}
            if len(self._limits) >= MOST_SENDERS:
                return None
        return self._limits.setdefault(sender, self._make())

    def take(self, sender: str, now: int) -> bool:
        """Return whether it may happen for a sender at `now`, and count it if so."""
        limit = self._limit(sender, now)
        return limit is not None and limit.take(now)

    def wait(self, sender: str, now: int) -> float:
        """Return how long it may not happen for a sender from `now` on [ns]; 0: it may."""
        limit = self._limit(sender, now)
        return min(known.rest(now) for known in self._limits.values()) if limit is None else limit.wait(now)


@dataclass(frozen=True)
class Pace:
    """How often each sender may do something: `most` times in any `seconds`."""

    most: int
    seconds: float = 1.0

    def __str__(self) -> str:
        return f"{self.most} in {self.seconds:g} s"

    def limits(self) -> SenderLimits:
        """Return what keeps it, by any clock [ns]."""
        return SenderLimits(lambda: RollingWindow(self.most, round(self.seconds * NANOSECONDS)))

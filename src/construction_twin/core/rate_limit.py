"""How often something may happen: a bucket of tokens, and a number in any span of time, of each sender.

Pure: `now` is an argument, in ns on a monotonic clock. Standard library only.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from construction_twin.core.units import NANOSECONDS


class LineLimiter:
    """At most one line per reason and period [ns]: a sender of rubbish must neither fill the disk nor hide other lines."""

    def __init__(self, period: int = NANOSECONDS):
        self._period = period
        # per reason: when a line was written last, and how many were left out since
        self._lines: dict[str, tuple[int, int]] = {}

    def note(self, reason: str, now: int) -> str | None:
        """Take a line that is to be written at `now` [ns].

        Args:
            reason: Its kind: one of few, never text that came from outside, because every kind is remembered.

        Returns:
            What to append to the line, "" or how many like it were left out before; None when it must not be written.
        """
        written, left_out = self._lines.get(reason, (now - self._period, 0))
        if now - written < self._period:
            self._lines[reason] = written, left_out + 1
            return None
        self._lines[reason] = now, 0
        return f" ({left_out} more like this since the last such line)" if left_out else ""


#: Senders that are known at a time: anybody may call himself something new where a broker knows no accounts.
MOST_SENDERS = 64


class TokenBucket:
    """Tokens that are used up and come back at a rate."""

    __slots__ = ("_burst", "_owed", "_rate", "_seen")

    def __init__(self, rate: float, burst: float):
        self._rate = rate
        # tokens are counted in ns, so that whole rates and bursts are exact
        self._burst = burst * NANOSECONDS
        self._owed: float = 0
        self._seen = 0

    def take(self, now: int, amount: float = 1) -> bool:
        """Use up `amount` tokens; return False, and use up none, where there are fewer."""
        # a clock that goes back gives nothing
        owed = max(0, self._owed - max(0, now - self._seen) * self._rate) + amount * NANOSECONDS
        if owed > self._burst:
            return False
        self._owed, self._seen = owed, now
        return True


class RollingWindow:
    """At most so many in any span of time [ns]: a bucket of that size would let twice as many pass in its first one."""

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


@dataclass(frozen=True)
class Pace:
    """How often each sender may do something: `most` times in any `seconds`."""

    most: int
    seconds: float = 1.0

    def __str__(self) -> str:
        return f"{self.most} in {self.seconds:g} s"


class SenderLimits:
    """A pace for each sender, by any clock [ns]; what is known of a sender is forgotten when nothing of it counts any more.

    While `MOST_SENDERS` are known, no other one may do anything.
    """

    def __init__(self, pace: Pace):
        self._pace = pace
        self._windows: dict[str, RollingWindow] = {}

    def _window(self, sender: str, now: int) -> RollingWindow | None:
        if sender not in self._windows and len(self._windows) >= MOST_SENDERS:
            self._windows = {name: window for name, window in self._windows.items() if window.rest(now)}
            if len(self._windows) >= MOST_SENDERS:
                return None
        return self._windows.setdefault(sender, RollingWindow(self._pace.most, round(self._pace.seconds * NANOSECONDS)))

    def take(self, sender: str, now: int) -> bool:
        """Return whether it may happen for a sender at `now`, and count it if so."""
        window = self._window(sender, now)
        return window is not None and window.take(now)

    def wait(self, sender: str, now: int) -> float:
        """Return how long it may not happen for a sender from `now` on [ns]; 0: it may."""
        window = self._window(sender, now)
        return min(known.rest(now) for known in self._windows.values()) if window is None else window.wait(now)

"""How much one connection may send: a bucket that fills with time. Pure; time is an argument."""

from __future__ import annotations


class Allowance:
    """A number that is used up and grows again.

    Parameters
    ----------
    rate : float
        By how much it grows per second.
    burst : float
        Its largest value, and its first.
    """

    def __init__(self, rate: float, burst: float):
        self._rate = rate
        self._burst = burst
        self._left = burst
        self._seen: float | None = None

    def take(self, amount: float, now: float) -> bool:
        """Use up `amount` at `now` [s]; return False, and use up nothing, where there is less."""
        if self._seen is not None:
            self._left = min(self._burst, self._left + max(0.0, now - self._seen) * self._rate)
        self._seen = now
        if amount > self._left:
            return False
        self._left -= amount
        return True

"""A source of speed limits with a deadline: after it, a fraction for silence holds, or the last limit where that is lower.

Pure: times are arguments, in ns on a monotonic clock. Standard library only.
"""

from __future__ import annotations

from construction_twin.core.errors import PayloadError
from construction_twin.core.units import NANOSECONDS


class SpeedLimitSource:
    """The last speed limit that was heard, from whom, and whether the source is still heard.

    Parameters
    ----------
    deadline : float
        A source that was heard must be heard again within this time [s].
    silent : float, optional
        Fraction of the speed that counts after that, 0 to 1; or the last limit, where that was lower.

    Attributes
    ----------
    name : str
        Who was heard last; "" before the first time.
    fraction : float
        What it asked for, 0 to 1; 1 before the first time.
    """

    __slots__ = ("_deadline", "_heard_at", "_silent", "fraction", "name")

    def __init__(self, deadline: float, silent: float = 0.0):
        self._deadline = round(deadline * NANOSECONDS)
        self._silent = silent
        self._heard_at = 0
        self.name = ""
        self.fraction = 1.0

    @property
    def deadline(self) -> float:
        """The deadline [s]."""
        return self._deadline / NANOSECONDS

    def hear(self, fraction: float, name: str, now: int) -> None:
        """Take what a source says at `now` [ns]; it counts until the deadline. The caller has checked both."""
        self.fraction, self.name, self._heard_at = fraction, name, now

    def accept(self, fraction: float, name: str, now: int) -> None:
        """Take what a source says, unless another source is heard.

        Parameters
        ----------
        fraction : float
            0 to 1.
        name : str
            The source. While one is heard, another one is refused: two alternating sources would change the speed all
            the time.
        now : int
            Time of reception [ns].

        Raises
        ------
        PayloadError
            ``speed_limit`` or ``speed_limit_source``; nothing has changed then, and the deadline runs on.
        """
        # written so that a nan does not pass
        if not 0.0 <= fraction <= 1.0:
            raise PayloadError(
                "speed_limit", f"{name} sent the speed limit {fraction}; expected a fraction from 0 to 1"
            )
        if not name:
            raise PayloadError(
                "speed_limit_source", "a speed limit came without its sender's name; expected a node's name"
            )
        if name != self.name and self.is_heard(now):
            raise PayloadError(
                "speed_limit_source", f"{name} sent a speed limit while {self.name} does; let only one of them"
            )
        self.hear(fraction, name, now)

    def is_heard(self, now: int) -> bool:
        """Return whether a source was heard within the deadline, as of `now` [ns]."""
        return bool(self.name) and now - self._heard_at <= self._deadline

    def is_silent(self, now: int) -> bool:
        """Return whether a source was heard once, and has been silent for longer than the deadline at `now` [ns]."""
        return bool(self.name) and now - self._heard_at > self._deadline

    @property
    def fraction_when_silent(self) -> float:
        """What counts once the source is silent: its silence never lifts the limit that it gave last."""
        return min(self._silent, self.fraction)

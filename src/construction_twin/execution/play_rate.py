"""The largest allowed fraction of the planned speed: from a source on a topic, or the silent fraction when that source is late.

Pure; times are arguments, in ns on the monotonic clock. Not safety rated: it slows a motion down so that less often a safety
function must stop it.
"""

from __future__ import annotations

from enum import Enum

from construction_twin.core.errors import ExecutionError
from construction_twin.core.speed_limit import SpeedLimitSource


class LimitState(Enum):
    """Why the limit is what it is."""

    UNLIMITED = "unlimited"
    MISSING = "missing"
    HEARD = "heard"
    SILENT = "silent"


class SpeedLimit:
    """One source's limit, with a deadline: a source that falls silent is taken to ask for less, never for more.

    Parameters
    ----------
    deadline : float
        A source that was heard must be heard again within this time [s].
    silent : float
        Fraction of the planned speed while it is not, 0 to 1; or the last limit, where that was lower.
    required : bool
        Whether the silent fraction holds before any source was heard.

    Attributes
    ----------
    state : LimitState
        As of the last `update`.
    limit : float
        Fraction of the planned speed that is allowed, 0 to 1.
    reason : str
        One sentence for the operator.
    """

    def __init__(self, deadline: float, silent: float, required: bool):
        self._source = SpeedLimitSource(deadline, silent)
        self._silent = silent
        self._required = required
        self._words = ""
        self.state, self.limit, self.reason = LimitState.UNLIMITED, 1.0, ""
        self.update(0)

    def on_limit(self, limit: float, reason: str, source: str, now: int) -> None:
        """Take what a source says; it counts until the deadline.

        Parameters
        ----------
        limit : float
            0 to 1.
        reason : str
            The source's sentence.
        source : str
            Its name. While one is heard, another one is refused: two alternating sources would change the speed all
            the time.
        now : int
            Time of reception [ns].

        Raises
        ------
        PayloadError
            ``speed_limit`` or ``speed_limit_source``; nothing has changed then, and the deadline runs on.
        """
        self._source.accept(limit, source, now)
        self._words, self.reason = reason.strip() or "no reason given", ""
        self.update(now)

    def update(self, now: int) -> float:
        """Return the fraction of the planned speed that is allowed at `now` [ns]."""
        source = self._source
        if not source.name:
            state = LimitState.MISSING if self._required else LimitState.UNLIMITED
            asked = self._silent if self._required else 1.0
        elif source.is_heard(now):
            state, asked = LimitState.HEARD, source.fraction
        else:
            state, asked = LimitState.SILENT, source.fraction_when_silent
        # called every cycle: a sentence only when there is something new to say
        if state is not self.state or asked != self.limit or not self.reason:
            self.state, self.limit = state, asked
            self.reason = self._sentence()
        return self.limit

    def _sentence(self) -> str:
        if self.state is LimitState.UNLIMITED:
            return "no speed limit: no source of `speed_limit` was heard"
        if self.state is LimitState.HEARD:
            return f"speed limit {self.limit:g} by {self._source.name}: {self._words}"
        if self.state is LimitState.MISSING:
            return f"speed limit {self.limit:g}: none was heard, and one is required; start a source of `speed_limit`"
        limit, source = f"speed limit {self.limit:g}", self._source
        return (
            f"{limit}: {source.name} is silent for more than {source.deadline:g} s; check it, or start another source"
        )


class PlayRate:
    """The newest limit on a plan's speed.

    Attributes
    ----------
    fraction : float
        0 to 1; 0: it stands still until the limit is raised.
    reason : str
        Why it is what it is, for the operator.
    standing : bool
        Whether the plan has come to rest because of it.
    """

    def __init__(self):
        self.fraction = 1.0
        self.standing = False
        self.reason = ""

    def take(self, fraction: float, reason: str) -> bool:
        """Take a limit and why it is there; return whether there is something new to say.

        Raises
        ------
        ExecutionError
            When it is no fraction; nothing has changed then.
        """
        if fraction == self.fraction and reason == self.reason:
            return False
        # written so that a nan does not pass
        if not 0.0 <= fraction <= 1.0:
            raise ExecutionError(
                f"a rate of {fraction} was asked for; expected a fraction of the planned speed, 0 to 1"
            )
        self.fraction, self.reason = fraction, reason
        return True

    def sentence(self, cause: str) -> str:
        """Return what a playing plan does, and why: always of the present limit. `cause` is why it plays."""
        if self.standing:
            return f"stands still on the path, goes on by itself: {self.reason}"
        if self.fraction < 1.0:
            return f"{cause}; at {self.fraction:.0%} of the planned speed: {self.reason}"
        return cause

"""The largest allowed fraction of the speed: what a source asks for, or the fraction for silence when that source is late.

Pure: times are arguments, in ns on a monotonic clock. Standard library only. Not safety rated: it slows a motion down so that less
often a safety function must stop it.
"""

from __future__ import annotations

from enum import Enum

from construction_twin.core.errors import PayloadError
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS


class LimitState(Enum):
    """Why the limit is what it is."""

    UNLIMITED = "unlimited"
    MISSING = "missing"
    HEARD = "heard"
    SILENT = "silent"


class SpeedLimit:
    """One source's limit, with a deadline: a source that falls silent is taken to ask for less, never for more.

    Args:
        deadline: A source that was heard must be heard again within this time [s].
        silent: Fraction of the speed while it is not, 0 to 1; or the last limit, where that was lower.
        required: Whether that fraction holds before any source was heard.

    Attributes:
        name: Who was heard last; "" before the first time.
        fraction: What it asked for, 0 to 1; 1 before the first time.
        state, limit, reason: As of the last `update`: why, what is allowed, and one sentence for the operator.
    """

    __slots__ = (
        "_heard_at",
        "_required",
        "_sentence_given",
        "_silent",
        "_within",
        "_words",
        "fraction",
        "limit",
        "name",
        "reason",
        "state",
    )

    def __init__(self, deadline: float, silent: float = 0.0, required: bool = False):
        self._within = round(deadline * NANOSECONDS)
        self._silent, self._required = silent, required
        self._heard_at = 0
        self._words = self._sentence_given = ""
        self.name, self.fraction = "", 1.0
        self.state, self.limit, self.reason = LimitState.UNLIMITED, 1.0, ""
        self.update(0)

    @property
    def deadline(self) -> float:
        """The deadline [s]."""
        return self._within / NANOSECONDS

    def hear(self, fraction: float, name: str, now: int) -> None:
        """Take what a source says at `now` [ns]; it counts until the deadline. The caller has checked both."""
        self.fraction, self.name, self._heard_at = fraction, name, now

    def accept(self, fraction: float, name: str, now: int, words: str = "", sentence: str = "") -> None:
        """Take what a source says, unless another source is heard.

        Args:
            fraction: 0 to 1.
            name: The source. While one is heard, another one is refused: two alternating sources would change the speed all the
                time.
            now: Time of reception [ns].
            words: Why, as the source says it.
            sentence: Said in place of the sentence with name and words, of a source that says whose limit it passes on.

        Raises:
            PayloadError: ``speed_limit`` or ``speed_limit_source``; nothing has changed then, and the deadline runs on.
        """
        # written so that a nan does not pass
        if not 0.0 <= fraction <= 1.0:
            raise PayloadError(
                "speed_limit", Sentence("executor.refused.limit_fraction", sender=name, fraction=fraction)
            )
        if not name:
            raise PayloadError("speed_limit_source", Sentence("executor.refused.limit_unnamed"))
        if name != self.name and self.is_heard(now):
            raise PayloadError(
                "speed_limit_source", Sentence("executor.refused.limit_two", sender=name, other=self.name)
            )
        self.hear(fraction, name, now)
        self._words, self._sentence_given, self.reason = words.strip(), sentence, ""
        self.update(now)

    def is_heard(self, now: int) -> bool:
        """Return whether a source was heard within the deadline, as of `now` [ns]."""
        return bool(self.name) and now - self._heard_at <= self._within

    def is_silent(self, now: int) -> bool:
        """Return whether a source was heard once, and has been silent for longer than the deadline at `now` [ns]."""
        return bool(self.name) and now - self._heard_at > self._within

    @property
    def fraction_when_silent(self) -> float:
        """What counts once the source is silent: its silence never lifts the limit that it gave last."""
        return min(self._silent, self.fraction)

    def update(self, now: int) -> float:
        """Return the fraction of the planned speed that is allowed at `now` [ns]."""
        if not self.name:
            state = LimitState.MISSING if self._required else LimitState.UNLIMITED
            asked = self._silent if self._required else 1.0
        elif self.is_heard(now):
            state, asked = LimitState.HEARD, self.fraction
        else:
            state, asked = LimitState.SILENT, self.fraction_when_silent
        # called every cycle: a sentence only when there is something new to say
        if state is not self.state or asked != self.limit or not self.reason:
            self.state, self.limit = state, asked
            self.reason = self._sentence()
        return self.limit

    def _sentence(self) -> str:
        if self.state is LimitState.UNLIMITED:
            return Sentence("executor.speed.unlimited")
        if self.state is LimitState.HEARD:
            words = self._words or Sentence("executor.speed.no_words")
            said = Sentence("executor.speed.limit", limit=self.limit, name=self.name, words=words)
            return self._sentence_given or said
        if self.state is LimitState.MISSING:
            return Sentence("executor.speed.missing", limit=self.limit)
        return Sentence("executor.speed.silent", limit=self.limit, name=self.name, deadline=self.deadline)

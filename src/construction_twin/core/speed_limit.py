"""The largest allowed fraction of the speed, by one source, with a deadline; times in ns, monotonic. Not safety rated."""

from __future__ import annotations

from enum import Enum

from construction_twin.core.errors import PayloadError
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS


class LimitState(Enum):
    """Source of the present limit."""

    UNLIMITED = "unlimited"
    MISSING = "missing"
    FRESH = "fresh"
    SILENT = "silent"


class SpeedLimit:
    """One source's limit, with a deadline [s]: silence asks for `silent`, or less where its last limit was lower.

    `name` and `fraction` are of the last source ("" and 1 before the first), `state`, `limit`, `reason` of the last `update`.
    """

    def __init__(self, deadline: float, silent: float = 0.0, required: bool = False):
        self.deadline, self._deadline_ns = deadline, round(deadline * NANOSECONDS)
        self._silent, self._required = silent, required
        self.name, self.fraction, self._received_at, self._received_sentence = "", 1.0, 0, ""
        self.state, self.limit, self.reason = LimitState.UNLIMITED, 1.0, ""
        self.update(0)

    def record(self, fraction: float, name: str, now: int) -> None:
        """Store a limit that the caller has checked."""
        self.fraction, self.name, self._received_at = fraction, name, now

    def accept(self, fraction: float, name: str, now: int, words: str = "", sentence: str = "") -> None:
        """Check and store a source's limit; refuse it while another source is fresh.

        `words` say why; `sentence` replaces the one made of them. PayloadError (``speed_limit``, ``speed_limit_source``): nothing
        changed.
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
        if name != self.name and self.is_fresh(now):
            two = f"{name} sent a speed limit while {self.name} does; let only one of them"
            raise PayloadError("speed_limit_source", two)
        self.record(fraction, name, now)
        words = words.strip() or Sentence("no reason given")
        own = Sentence("speed limit {limit:g} by {name}: {words}", limit=fraction, name=name, words=words)
        self._received_sentence, self.reason = sentence or own, ""
        self.update(now)

    def is_fresh(self, now: int) -> bool:
        """Return whether a source was received within the deadline, as of `now` [ns]."""
        return bool(self.name) and now - self._received_at <= self._deadline_ns

    def is_silent(self, now: int) -> bool:
        """Return whether a known source has exceeded the deadline at `now` [ns]."""
        return bool(self.name) and not self.is_fresh(now)

    @property
    def fraction_when_silent(self) -> float:
        """The limit during silence: at most the source's last one."""
        return min(self._silent, self.fraction)

    def update(self, now: int) -> float:
        """Return the fraction of the planned speed that is allowed at `now` [ns]."""
        if self.is_fresh(now):
            state, asked = LimitState.FRESH, self.fraction
        elif self.name:
            state, asked = LimitState.SILENT, self.fraction_when_silent
        elif self._required:
            state, asked = LimitState.MISSING, self._silent
        else:
            state, asked = LimitState.UNLIMITED, 1.0
        # called every cycle: a sentence only when there is something new to say
        if state is not self.state or asked != self.limit or not self.reason:
            self.state, self.limit, self.reason = state, asked, self._sentence(state, asked)
        return asked

    def _sentence(self, state: LimitState, limit: float) -> str:
        if state is LimitState.UNLIMITED:
            return Sentence("no speed limit: no source of `speed_limit` has sent one")
        if state is LimitState.MISSING:
            return Sentence(
                "speed limit {limit:g}: none has come, and one is required; start a source of `speed_limit`",
                limit=limit,
            )
        if state is LimitState.FRESH:
            return self._received_sentence
        return Sentence(
            "speed limit {limit:g}: {name} is silent for more than {deadline:g} s; check it, or start another source",
            limit=limit,
            name=self.name,
            deadline=self.deadline,
        )

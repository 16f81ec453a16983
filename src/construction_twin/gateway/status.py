"""What the gateway's `status` says of refusals, and when it is due."""

from __future__ import annotations

import math
from collections import Counter

from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS

#: Without a telegram for this long no controller waits for an answer [s].
QUIET = 0.05
#: What is quoted of a refused message in `status` [characters]: the status stays small, whatever was sent.
LONGEST_REFUSAL = 300


class Refusals:
    """Counts refusals and keeps the last one's sentence."""

    def __init__(self, counters: Counter[str]):
        self._counters = counters
        #: Reason and sentence of the last one that is no mere consequence of a stop; of the one that stopped the arm, until
        #: `forgive`; "" for none yet.
        self.last = ""
        #: Of the last one since the one that stopped the arm; "" for none.
        self.later = ""
        #: Datagrams refused since the last telegram that could be read; the last one's reason and sentence, "" before the first.
        self.unread, self.unread_reason, self.unread_why = 0, "", ""
        self._keeps = self._stopped = False
        self._told_at = -NANOSECONDS
        self.begin_session()

    def begin_session(self) -> None:
        """Begin anew with what cannot be read: a telegram could be."""
        self._told_reason, self._told_count = "", 0

    def message(self, reason: str, why: object, follows: bool = False) -> None:
        """Count a message on MQTT as ``refused_<reason>``.

        Args:
            why: The sentence.
            follows: It is refused only because nobody is armed, as what is still under way when a stop comes: its sentence takes
                the place of no other.
        """
        if follows and self._keeps:
            self._counters[f"refused_{reason}"] += 1
            return
        self._note(f"refused_{reason}", reason, why)
        self._keeps = not follows

    def stopped(self) -> None:
        """Keep the last one: the arm was stopped for it."""
        self._stopped, self.later = True, ""

    def telegram(self, reason: str, why: object) -> None:
        """Count a datagram on RSI's port as ``telegram_refused_<reason>``."""
        self._note(f"telegram_refused_{reason}", f"telegram {reason}", why)
        self._keeps = True
        self.unread += 1
        self.unread_reason, self.unread_why = reason, str(why)[:LONGEST_REFUSAL]

    def forgive(self) -> None:
        """After a reset, or with another command session: what stopped the one before is no longer the cause of anything."""
        self.last, self.later = self.later or self.last, ""
        self._keeps = self._stopped = False

    def unread_news(self, now: int) -> tuple[str, bool]:
        """Return what cannot be read, once a second, "" for nothing, and whether it is refused for another reason than before."""
        if now < self._told_at + NANOSECONDS or self.unread == self._told_count:
            return "", False
        reason, is_new = self.unread_reason, self.unread_reason != self._told_reason
        self._told_at, self._told_count, self._told_reason = now, self.unread, reason
        count, why = self.unread, self.unread_why
        said = Sentence(
            "datagrams refused: {count}, the last one for {reason}: {why}", count=count, reason=reason, why=why
        )
        return said, is_new

    def _note(self, counter: str, reason: str, why: object) -> None:
        self._counters[counter] += 1
        said = f"{reason}: {why}"[:LONGEST_REFUSAL]
        if self._stopped:
            self.later = said
        else:
            self.last = said


class StatusClock:
    """When the periodic status is sent: in the pause after an answer, because putting it together takes part of a cycle."""

    def __init__(self, period: float):
        self._period = period
        self._due_at = -math.inf
        self._heard_at = -math.inf

    def sent(self, now: float) -> None:
        """Take note of a status, also of one out of turn, at `now` [s]."""
        self._due_at = now + self._period

    def hurry(self) -> None:
        """Send the next one as soon as possible."""
        self._due_at = -math.inf

    def is_due(self, now: float, answered: bool) -> bool:
        """Return whether to send one now [s]: after a telegram was `answered` in this turn, or when none has come for 50 ms."""
        if answered:
            self._heard_at = now
        return now >= self._due_at and (answered or now - self._heard_at >= QUIET)

"""The count of what the gateway refuses, and the last refusal's sentence. Standard library only."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS

#: What is quoted of a refused message in `status` [characters]: the status stays small, whatever was sent.
LONGEST_REFUSAL = 300


@dataclass(frozen=True)
class Unread:
    """Why a datagram was refused: the reason it is counted under, and a sentence; both empty before the first."""

    reason: str = ""
    why: str = ""


class Refusals:
    """Counts refusals and keeps the last one's sentence."""

    def __init__(self, counters: Counter[str]):
        self._counters = counters
        #: Reason and sentence of the last one that is no mere consequence of a stop; of the one that stopped the arm, until
        #: `forgive`; "" for none yet.
        self.last = ""
        #: Of the last one since the one that stopped the arm; "" for none.
        self.later = ""
        #: Datagrams refused since the last telegram that could be read, and the last one's reason and sentence.
        self.unread = 0
        self.last_unread = Unread()
        self._keeps = self._stopped = False

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
        self.last_unread = Unread(reason, str(why)[:LONGEST_REFUSAL])

    def forgive(self) -> None:
        """After a reset, or with another command session: what stopped the one before is no longer the cause of anything."""
        self.last, self.later = self.later or self.last, ""
        self._keeps = self._stopped = False

    def _note(self, counter: str, reason: str, why: object) -> None:
        self._counters[counter] += 1
        said = f"{reason}: {why}"[:LONGEST_REFUSAL]
        if self._stopped:
            self.later = said
        else:
            self.last = said


@dataclass(frozen=True, slots=True)
class UnreadNote:
    """What is to be reported of datagrams that cannot be read.

    Attributes:
        is_new: They are refused for another reason than those reported before.
    """

    sentence: str
    is_new: bool


class UnreadReport:
    """Reports that something sends of which nothing can be read: once a second, while it sends."""

    def __init__(self, refusals: Refusals):
        self._refusals = refusals
        self._reported_at = -NANOSECONDS
        self.restart()

    def restart(self) -> None:
        """A telegram could be read."""
        self._reason = ""
        self._count = 0

    def take(self, now: int) -> UnreadNote | None:
        """Return what is to be reported at `now` [ns]; None for nothing."""
        if now < self._reported_at + NANOSECONDS:
            return None
        refusals, last = self._refusals, self._refusals.last_unread
        if refusals.unread == self._count:
            return None
        self._count, self._reported_at = refusals.unread, now
        before, self._reason = self._reason, last.reason
        sentence = Sentence(
            "datagrams refused: {count}, the last one for {reason}: {why}",
            count=refusals.unread,
            reason=last.reason,
            why=last.why,
        )
        return UnreadNote(sentence, last.reason != before)

"""The count of what the gateway refuses, and the last refusal's sentence. Standard library only."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

#: What is quoted of a refused message in `status` [characters]: the status stays small, whatever was sent.
LONGEST_REFUSAL = 300
#: Refusals that follow a stop as long as the sender goes on: none of them takes the place of what the sender was stopped for.
CONSEQUENCES = ("not_armed",)


@dataclass(frozen=True)
class Unread:
    """Why a datagram was refused: the reason it is counted under, and a sentence; both empty before the first."""

    reason: str = ""
    why: str = ""


class Refusals:
    """Counts refusals and keeps the last one's sentence.

    Parameters
    ----------
    counters : Counter
        The gateway's.
    """

    def __init__(self, counters: Counter[str]):
        self._counters = counters
        #: Reason and sentence of the last one that is no mere consequence of a stop; "" for none yet.
        self.last = ""
        #: Datagrams refused since the last telegram that could be read, and the last one's reason and sentence.
        self.unread = 0
        self.last_unread = Unread()
        self._keeps = False

    def message(self, reason: str, why: object) -> None:
        """Count a message on MQTT as ``refused_<reason>``."""
        consequence = reason in CONSEQUENCES
        if consequence and self._keeps:
            self._counters[f"refused_{reason}"] += 1
            return
        self._note(f"refused_{reason}", reason, why)
        self._keeps = not consequence

    def telegram(self, reason: str, why: object) -> None:
        """Count a datagram on RSI's port as ``telegram_refused_<reason>``."""
        self._note(f"telegram_refused_{reason}", f"telegram {reason}", why)
        self._keeps = True
        self.unread += 1
        self.last_unread = Unread(reason, str(why)[:LONGEST_REFUSAL])

    def forgive(self) -> None:
        """Begin with another command session: what stopped the one before is no longer the cause of anything."""
        self._keeps = False

    def _note(self, counter: str, reason: str, why: object) -> None:
        self._counters[counter] += 1
        self.last = f"{reason}: {why}"[:LONGEST_REFUSAL]

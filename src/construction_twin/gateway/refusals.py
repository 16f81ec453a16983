"""The count of what the gateway refuses, and the last refusal's sentence. Standard library only."""

from __future__ import annotations

from collections import Counter

#: What is quoted of a refused message in `status` [characters]: the status stays small, whatever was sent.
LONGEST_REFUSAL = 300


class Refusals:
    """Counts refusals and keeps the last one's sentence.

    Parameters
    ----------
    counters : Counter
        The gateway's.
    """

    def __init__(self, counters: Counter[str]):
        self._counters = counters
        #: Reason and sentence of the last one; "" for none yet.
        self.last = ""

    def message(self, reason: str, why: object) -> None:
        """Count a message on MQTT as ``refused_<reason>``."""
        self._note(f"refused_{reason}", reason, why)

    def telegram(self, reason: str, why: object) -> None:
        """Count a datagram on RSI's port as ``telegram_refused_<reason>``."""
        self._note(f"telegram_refused_{reason}", f"telegram {reason}", why)

    def _note(self, counter: str, reason: str, why: object) -> None:
        self._counters[counter] += 1
        self.last = f"{reason}: {why}"[:LONGEST_REFUSAL]

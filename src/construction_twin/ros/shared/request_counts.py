"""What became of the requests of one kind, for `/diagnostics`, and how often an account is told that it sent what cannot be read.

Who floods a topic must cost no more than the reading.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable

from construction_twin.mqtt.requests import answer_limits


class RequestCounts:
    """Counts requests of a kind. Used by several threads.

    Args:
        kind: Of the requests: "verdicts".
        done, not_done: What is counted of a request that was carried out, and of one that was not.
        clock: Returns a time from any origin [ns].
    """

    def __init__(
        self,
        kind: str,
        done: str = "taken",
        not_done: str = "not taken",
        clock: Callable[[], int] = time.monotonic_ns,
    ):
        self._kind = kind
        self._words = {True: done, False: not_done}
        self._clock = clock
        self._answers = answer_limits()
        self._lock = threading.Lock()
        self._unanswered = 0
        self._counts: Counter[str] = Counter()

    def is_due(self, account: str) -> bool:
        """Return whether a malformed message of an account is to be answered, and count it where it is not."""
        with self._lock:
            due = self._answers.take(account, self._clock())
            self._unanswered += not due
            return due

    def add(self, ok: bool, word: str = "") -> None:
        """Count a request that was carried out, or not; as `word` where there is one."""
        with self._lock:
            self._counts[word or self._words[ok]] += 1

    def report(self) -> dict[str, int]:
        """Return the counts; what never happened is left out."""
        with self._lock:
            found = {f"{self._kind} {word}": count for word, count in sorted(self._counts.items())}
            return found | ({f"{self._kind} malformed, not answered": self._unanswered} if self._unanswered else {})

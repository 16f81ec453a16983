"""How often an account is told that what it sent cannot be read: who floods a topic must cost no more than the reading.

What can be read is not counted here: a person's verdict, stop, pause or resume is always answered.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from construction_twin.core.rate_limit import SenderLimits, TokenBucket
from construction_twin.core.units import NANOSECONDS

#: Answers to one account have this time between them [ns] in the long run, and so many come at once; as the gateway's.
PERIOD, AT_ONCE = NANOSECONDS // 10, 10


class MalformedAnswers:
    """Decides for each malformed message whether it is answered. Used by several threads.

    Args:
        kind: Of the messages, for `/diagnostics`.
        clock: Returns a time from any origin [ns].
    """

    def __init__(self, kind: str, clock: Callable[[], int] = time.monotonic_ns):
        self._kind = kind
        self._clock = clock
        self._answers = SenderLimits(lambda: TokenBucket(NANOSECONDS // PERIOD, AT_ONCE))
        self._lock = threading.Lock()
        self._unanswered = 0

    def take(self, account: str) -> bool:
        """Return whether a malformed message of an account is to be answered, and count it where it is not."""
        with self._lock:
            due = self._answers.take(account, self._clock())
            self._unanswered += not due
            return due

    def report(self) -> dict[str, int]:
        """Return how many were not answered, for `/diagnostics`; empty where all were."""
        with self._lock:
            return {f"{self._kind} malformed, not answered": self._unanswered} if self._unanswered else {}

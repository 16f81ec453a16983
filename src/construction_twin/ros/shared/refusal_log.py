"""Which refusals are worth a line in the log: a stranger is named once per stream, everything else at most every 5 s per reason."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable

import rospy

from construction_twin.ros.transport.subscriber import PUBLISHER

#: Between two lines for one reason [s].
PERIOD = 5.0
#: Strangers that are known; those that come later are told of as everything else is.
KEPT = 100


class RefusalLog:
    """Decides for each refusal whether it is written; for use from several threads.

    Args:
        clock: Returns a time from any origin [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self._lock = threading.Lock()
        self._said: dict[str, float] = {}
        #: How often each stranger was refused, by the sentence that names it, its stream and who may publish that.
        self._strangers: Counter[str] = Counter()

    def take(self, reason: str, sentence: str) -> bool:
        """Count a refusal; return whether it is to be written."""
        now = self._clock()
        with self._lock:
            if reason == PUBLISHER and (sentence in self._strangers or len(self._strangers) < KEPT):
                self._strangers[sentence] += 1
                return self._strangers[sentence] == 1
            last = self._said.get(reason)
            if last is not None and now - last < PERIOD:
                return False
            self._said[reason] = now
            return True

    def strangers(self) -> dict[str, int]:
        """Return how often each stranger was refused, by its sentence."""
        with self._lock:
            return dict(self._strangers)


def warn_of_refusals() -> Callable[[str, str], None]:
    """Return what takes the refusals of a program without `/diagnostics`: they are said in its log alone."""
    log = RefusalLog()

    def refuse(reason: str, sentence: str) -> None:
        if log.take(reason, sentence):
            rospy.logwarn("%s refused (%s): %s", rospy.get_name(), reason, sentence)

    return refuse

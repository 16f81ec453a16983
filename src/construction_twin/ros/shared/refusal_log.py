"""Which refusals are worth a line in the log: a stranger is named once per stream, everything else at most every 5 s per reason."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable

import rospy

from construction_twin.core.rate_limit import LineLimiter
from construction_twin.core.units import NANOSECONDS
from construction_twin.ros.transport.subscriber import PUBLISHER

#: Between two lines for one reason [ns].
PERIOD = 5 * NANOSECONDS
#: Strangers that are known; those that come later are told of as everything else is.
KEPT = 100


class RefusalLog:
    """Decides for each refusal whether it is written; for use from several threads.

    Args:
        clock: Returns a time from any origin [ns].
    """

    def __init__(self, clock: Callable[[], int] = time.monotonic_ns):
        self._clock = clock
        self._lock = threading.Lock()
        self._lines = LineLimiter(PERIOD)
        #: How often each stranger was refused, by the sentence that names it, its stream and who may publish that.
        self._strangers: Counter[str] = Counter()

    def note(self, reason: str, sentence: str) -> str | None:
        """Count a refusal; return what to append to its line, None when none is to be written (`LineLimiter.note`)."""
        with self._lock:
            if reason == PUBLISHER and (sentence in self._strangers or len(self._strangers) < KEPT):
                self._strangers[sentence] += 1
                return "" if self._strangers[sentence] == 1 else None
            return self._lines.note(reason, self._clock())

    def strangers(self) -> dict[str, int]:
        """Return how often each stranger was refused, by its sentence."""
        with self._lock:
            return dict(self._strangers)


def warn_of_refusals() -> Callable[[str, str], None]:
    """Return what takes the refusals of a program without `/diagnostics`: they are said in its log alone."""
    log = RefusalLog()

    def refuse(reason: str, sentence: str) -> None:
        if (more := log.note(reason, sentence)) is not None:
            rospy.logwarn("%s refused (%s): %s%s", rospy.get_name(), reason, sentence, more)

    return refuse

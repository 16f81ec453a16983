"""A node's log of refusals, for threads that must not wait, and its state on `/diagnostics`."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import diagnostic_updater
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from construction_twin.core.rate_limit import LineLimiter
from construction_twin.core.units import NANOSECONDS
from construction_twin.ros.transport.publisher import Publisher
from construction_twin.ros.transport.subscriber import PUBLISHER

OK = DiagnosticStatus.OK
WARN = DiagnosticStatus.WARN
ERROR = DiagnosticStatus.ERROR
#: Lines kept; of more the oldest are dropped.
MAX_LINES = 1000
#: Between two lines for one reason [ns].
PERIOD = 5 * NANOSECONDS
#: Strangers that are named once each; later ones are logged as everything else is.
MAX_STRANGERS = 100


class DeferredLog:
    """Queues log lines for a background thread."""

    def __init__(self):
        self._writing = threading.Lock()
        self._lines: deque[tuple[Callable[..., None], tuple]] = deque(maxlen=MAX_LINES)

    def add(self, write: Callable[..., None], *words) -> None:
        """Queue a line; `write` is `rospy.loginfo` or one of its kind, `words` its arguments."""
        self._lines.append((write, words))

    def flush(self) -> None:
        """Write queued lines, oldest first."""
        with self._writing:
            while self._lines:
                write, words = self._lines.popleft()
                write(*words)


class RefusalLog:
    """Decides which refusals are written: a stranger once per stream, others at most every 5 s per reason; from several threads."""

    def __init__(self, clock: Callable[[], int] = time.monotonic_ns):
        self._clock = clock
        self._lock = threading.Lock()
        self._lines = LineLimiter(PERIOD)
        #: By the sentence that names it, its stream and who may publish that.
        self._strangers: set[str] = set()

    def admit(self, reason: str, sentence: str) -> str | None:
        """Return what to append to a refusal's line; None: write none (`LineLimiter.admit`)."""
        with self._lock:
            if reason != PUBLISHER or (sentence not in self._strangers and len(self._strangers) >= MAX_STRANGERS):
                return self._lines.admit(reason, self._clock())
            is_known = sentence in self._strangers
            self._strangers.add(sentence)
            return None if is_known else ""


def warn_of_refusals() -> Callable[[str, str], None]:
    """Return a log of the refusals of a program without `/diagnostics`."""
    log = RefusalLog()

    def refuse(reason: str, sentence: str) -> None:
        if (more := log.admit(reason, sentence)) is not None:
            rospy.logwarn("%s refused (%s): %s%s", rospy.get_name(), reason, sentence, more)

    return refuse


@dataclass(frozen=True)
class Diagnosis:
    """A node's state."""

    level: int
    sentence: str
    values: Mapping[str, object] = field(default_factory=dict)


class NodeDiagnostics:
    """Counts refusals and reports them with a node's state, from several threads, and never has one of them wait for the log."""

    def __init__(self, hardware_id: str, diagnose: Callable[[], Diagnosis]):
        self._lock = threading.Lock()
        self._refused: Counter[str] = Counter()
        #: The last sentence of each reason.
        self._sentences: dict[str, str] = {}
        self._log = RefusalLog()
        self._log_queue, self._news = DeferredLog(), threading.Event()
        threading.Thread(target=self._write, name="refusals", daemon=True).start()
        rospy.on_shutdown(self._log_queue.flush)
        self._diagnose = diagnose
        self._updater = diagnostic_updater.Updater()
        # quiet at shutdown, as every publisher of ours
        self._updater.publisher = Publisher("/diagnostics", DiagnosticArray, queue_size=1)
        self._updater.setHardwareID(hardware_id)
        self._updater.add("state", self._fill)
        # `update` would ask the master for a period, and raise when the master is gone: a motion goes on without one
        self._timer = rospy.Timer(rospy.Duration(1.0), lambda _: self._updater.force_update())

    @property
    def refused(self) -> Counter[str]:
        """A copy of the counts by reason."""
        with self._lock:
            return Counter(self._refused)

    def refuse(self, reason: str, sentence: str) -> None:
        """Count a rejected input, and queue its line for the log (`RefusalLog`)."""
        self.count(reason, sentence)
        if (more := self._log.admit(reason, sentence)) is not None:
            self._log_queue.add(rospy.logwarn, "%s refused (%s): %s%s", rospy.get_name(), reason, sentence, more)
            self._news.set()

    def _write(self) -> None:
        while True:
            self._news.wait()
            self._news.clear()
            self._log_queue.flush()

    def count(self, reason: str, sentence: str) -> None:
        """Count a rejected input that the node itself writes to its log."""
        with self._lock:
            self._refused[reason] += 1
            self._sentences[reason] = sentence

    def _fill(self, stat):
        diagnosis = self._diagnose()
        stat.summary(diagnosis.level, diagnosis.sentence)
        for key, value in diagnosis.values.items():
            stat.add(key, str(value))
        with self._lock:
            refused, sentences = sorted(self._refused.items()), dict(self._sentences)
        for reason, count in refused:
            stat.add(f"refused {reason}", str(count))
            stat.add(f"last refused {reason}", sentences[reason])
        return stat

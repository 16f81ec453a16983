"""Counters and states of a node on `/diagnostics`, once a second."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import diagnostic_updater
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from construction_twin.ros.shared.deferred_log import DeferredLog
from construction_twin.ros.shared.refusal_log import RefusalLog
from construction_twin.ros.transport.publisher import Publisher


@dataclass(frozen=True)
class Report:
    """A node's state.

    Attributes:
        level: A DiagnosticStatus level: `OK`, `WARN` or `ERROR`.
        values: Further values by name.
    """

    level: int
    sentence: str
    values: Mapping[str, object] = field(default_factory=dict)


class NodeDiagnostics:
    """Counts refusals and reports them with a node's state; for use from several threads.

    Who refuses may hold the lock of a cycle, or be the thread in which the next stop comes: it never waits for the log.

    Args:
        hardware_id: Name of the robot.
        report: Returns the node's Report.
    """

    def __init__(self, hardware_id: str, report: Callable[[], Report]):
        self._lock = threading.Lock()
        self._refused: Counter[str] = Counter()
        #: The last sentence of each reason.
        self._sentences: dict[str, str] = {}
        self._log = RefusalLog()
        self._said, self._news = DeferredLog(), threading.Event()
        threading.Thread(target=self._write, name="refusals", daemon=True).start()
        rospy.on_shutdown(self._said.flush)
        self._report = report
        self._updater = diagnostic_updater.Updater()
        # quiet at shutdown, as every publisher of ours
        self._updater.publisher = Publisher("/diagnostics", DiagnosticArray, queue_size=1)
        self._updater.setHardwareID(hardware_id)
        self._updater.add("state", self._fill)
        # `update` would ask the master for a period, and raise when the master is gone: a motion goes on without one
        self._timer = rospy.Timer(rospy.Duration(1.0), lambda _: self._updater.force_update())

    @property
    def refused(self) -> Counter[str]:
        """How often each reason was counted: a copy, because other threads go on counting."""
        with self._lock:
            return Counter(self._refused)

    def refuse(self, reason: str, sentence: str) -> None:
        """Count a rejected input, and have it said in the log with this node's name (`RefusalLog`), in a thread that may wait.

        `/diagnostics` shows the last one.
        """
        self.count(reason, sentence)
        if (more := self._log.note(reason, sentence)) is not None:
            self._said.add(rospy.logwarn, "%s refused (%s): %s%s", rospy.get_name(), reason, sentence, more)
            self._news.set()

    def _write(self) -> None:
        while True:
            self._news.wait()
            self._news.clear()
            self._said.flush()

    def count(self, reason: str, sentence: str) -> None:
        """Count a rejected input that the node itself writes to its log."""
        with self._lock:
            self._refused[reason] += 1
            self._sentences[reason] = sentence

    def _fill(self, stat):
        report = self._report()
        stat.summary(report.level, report.sentence)
        for key, value in report.values.items():
            stat.add(key, str(value))
        with self._lock:
            refused, sentences = sorted(self._refused.items()), dict(self._sentences)
        for reason, count in refused:
            stat.add(f"refused {reason}", str(count))
            stat.add(f"last refused {reason}", sentences[reason])
        for sentence, count in self._log.strangers().items():
            stat.add(f"refused: {sentence}", str(count))
        return stat


OK = DiagnosticStatus.OK
WARN = DiagnosticStatus.WARN
ERROR = DiagnosticStatus.ERROR

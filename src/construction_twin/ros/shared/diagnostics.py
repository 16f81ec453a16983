"""Counters and states of a node on `/diagnostics`, once a second."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import diagnostic_updater
import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from construction_twin.ros.transport.publisher import Publisher


class NodeDiagnostics:
    """Counts refusals and reports them with a node's state.

    Parameters
    ----------
    hardware_id : str
        Name of the robot.
    report : callable
        Returns (level, sentence, values): a DiagnosticStatus level, one sentence and a dict of further values.
    """

    def __init__(self, hardware_id: str, report: Callable[[], tuple[int, str, dict]]):
        self.refused: Counter[str] = Counter()
        self._report = report
        self._updater = diagnostic_updater.Updater()
        # quiet at shutdown, as every publisher of ours
        self._updater.publisher = Publisher("/diagnostics", DiagnosticArray, queue_size=1)
        self._updater.setHardwareID(hardware_id)
        self._updater.add("state", self._fill)
        self._timer = rospy.Timer(rospy.Duration(1.0), lambda _: self._updater.update())

    def refuse(self, reason: str, sentence: str) -> None:
        """Count a rejected input; the operator hears of it at most every 5 s."""
        self.refused[reason] += 1
        rospy.logwarn_throttle(5.0, "refused (%s): %s", reason, sentence)

    def _fill(self, stat):
        level, sentence, values = self._report()
        stat.summary(level, sentence)
        for key, value in values.items():
            stat.add(key, str(value))
        for reason, count in sorted(self.refused.items()):
            stat.add(f"refused {reason}", str(count))
        return stat


OK = DiagnosticStatus.OK
WARN = DiagnosticStatus.WARN
ERROR = DiagnosticStatus.ERROR

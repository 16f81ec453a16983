"""separation: turns a separation distance into `speed_limit`. An example of a source of it, not a safety function."""

from __future__ import annotations

import threading
import time

import pydantic
import rospy
from construction_twin.msg import SpeedLimit
from distance_to_speed import SeparationLimit, SpeedTable
from sensor_msgs.msg import Range

from construction_twin.core.errors import PayloadError
from construction_twin.ros.shared.diagnostics import OK, WARN, NodeDiagnostics, Report
from construction_twin.ros.shared.node import run_node
from construction_twin.ros.shared.params import read_parameters
from construction_twin.ros.transport.joint_stream import from_time
from construction_twin.ros.transport.publisher import Publisher
from construction_twin.ros.transport.subscriber import Subscriber


class Settings(pydantic.BaseModel):
    """Private parameters; see config/separation.yaml."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    table: list[list[float]]
    deadline: float = pydantic.Field(gt=0)
    rate: float = pydantic.Field(ge=1, le=100)


class SeparationNode:
    """ROS around a SeparationLimit."""

    def __init__(self):
        settings = read_parameters(Settings)
        self._separation = SeparationLimit(SpeedTable(settings.table), settings.deadline)
        self._lock = threading.Lock()
        self._measured = rospy.Time()
        self._said = ("", 0.0)
        self._diagnostics = NodeDiagnostics(rospy.get_namespace().strip("/"), self._report)
        self._publisher = Publisher("speed_limit", SpeedLimit, queue_size=1, latch=True, tcp_nodelay=True)
        refuse = self._diagnostics.refuse
        Subscriber("separation_distance", Range, self._on_range, refuse, queue_size=1, tcp_nodelay=True)
        self._timer = rospy.Timer(rospy.Duration(1.0 / settings.rate), self._on_timer)

    def _on_range(self, message: Range) -> None:
        stamp = message.header.stamp
        try:
            with self._lock:
                self._separation.on_range(
                    message.range, message.min_range, message.max_range, from_time(stamp), time.monotonic_ns()
                )
                self._measured = stamp
        except PayloadError as error:
            self._diagnostics.refuse(error.reason, str(error))

    def _on_timer(self, _event) -> None:
        with self._lock:
            limit, reason = self._separation.update(time.monotonic_ns())
            message = SpeedLimit(limit=limit, reason=reason)
            message.header.stamp = self._measured
        self._publisher.publish(message)
        self._said = (reason, limit)

    def _report(self) -> Report:
        reason, limit = self._said
        level = OK if limit >= 1.0 else WARN
        return Report(level, f"speed limit {limit:g}: {reason}", {"speed limit": f"{limit:.3f}"})


def main() -> None:
    """Run the node."""
    run_node("separation", SeparationNode)

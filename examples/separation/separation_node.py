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
from construction_twin.robot.description import RobotModel
from construction_twin.ros.shared.diagnostics import OK, WARN, Diagnosis, NodeDiagnostics
from construction_twin.ros.shared.node_shell import Interface, NodeIO, NodeShell, NodeTimer, Publication, Subscription
from construction_twin.ros.transport.joint_stream import from_time
from construction_twin.ros.transport.publisher import AnyPublisher
from construction_twin.validation import StrictModel


class Settings(StrictModel):
    """Private parameters; see config/separation.yaml."""

    table: list[list[float]]
    deadline: float = pydantic.Field(gt=0)
    rate: float = pydantic.Field(ge=1, le=100)


class SeparationNode:
    """ROS around a SeparationLimit; `start` gives it parameters and topics.

    Args:
        diagnostics: Counts what is refused.
    """

    def __init__(
        self,
        separation: SeparationLimit,
        speed_limit: AnyPublisher,
        diagnostics: NodeDiagnostics,
    ):
        self._separation = separation
        self._lock = threading.Lock()
        self._measured = rospy.Time()
        self._said = ("", 0.0)
        self._publisher = speed_limit
        self._diagnostics = diagnostics

    def on_range(self, message: Range) -> None:
        """Take a separation distance."""
        stamp = message.header.stamp
        try:
            with self._lock:
                self._separation.on_range(
                    message.range, message.min_range, message.max_range, from_time(stamp), time.monotonic_ns()
                )
                self._measured = stamp
        except PayloadError as error:
            self._diagnostics.refuse(error.reason, str(error))

    def update(self) -> None:
        """Publish the limit as of now; to be called at `rate`."""
        with self._lock:
            limit, reason = self._separation.update(time.monotonic_ns())
            message = SpeedLimit(limit=limit, reason=reason)
            message.header.stamp = self._measured
        self._publisher.publish(message)
        self._said = (reason, limit)

    def diagnose(self) -> Diagnosis:
        """Return the state for `/diagnostics`."""
        reason, limit = self._said
        level = OK if limit >= 1.0 else WARN
        return Diagnosis(level, f"speed limit {limit:g}: {reason}", {"speed limit": f"{limit:.3f}"})


def start(settings: Settings, robot: RobotModel, node_io: NodeIO) -> SeparationNode:
    """Return the node with its parameters and topics."""
    limit = SeparationLimit(SpeedTable(settings.table), settings.deadline)
    return SeparationNode(limit, node_io.publishers["speed_limit"], node_io.diagnostics)


INTERFACE = Interface(
    diagnose=SeparationNode.diagnose,
    publishes=(Publication("speed_limit", SpeedLimit, queue_size=1, latch=True, tcp_nodelay=True),),
    subscribes=(Subscription("separation_distance", Range, SeparationNode.on_range, queue_size=1, tcp_nodelay=True),),
    timers=(NodeTimer(lambda settings: 1.0 / settings.rate, SeparationNode.update),),
)
NODE = NodeShell("separation", Settings, start, INTERFACE, lambda settings, _robot, _shared: SpeedTable(settings.table))


def main() -> None:
    """Run the node."""
    NODE.run()

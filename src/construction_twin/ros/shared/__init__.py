"""What several nodes need, and parts of large nodes.

Parameters, diagnostics, the MQTT connection, the gateway's configuration, listeners, the operator's client.

In: a node's parameters and topics. Out: checked settings, counters on ``/diagnostics``, the latest reports of a robot. May
import the library, ``ros.transport`` and ``ros.messages``.
"""

from typing import TYPE_CHECKING

from construction_twin.core.exports import lazy_exports

if TYPE_CHECKING:
    from construction_twin.ros.shared.arm_listener import ArmListener as ArmListener
    from construction_twin.ros.shared.deferred_log import DeferredLog as DeferredLog
    from construction_twin.ros.shared.diagnostics import NodeDiagnostics as NodeDiagnostics
    from construction_twin.ros.shared.diagnostics import Report as Report
    from construction_twin.ros.shared.frames import Frames as Frames
    from construction_twin.ros.shared.frames import listen_to_frames as listen_to_frames
    from construction_twin.ros.shared.known_bag import open_bag as open_bag
    from construction_twin.ros.shared.mqtt_connection import MqttSettings as MqttSettings
    from construction_twin.ros.shared.mqtt_connection import connect as connect
    from construction_twin.ros.shared.node import Service as Service
    from construction_twin.ros.shared.operator_client import OperatorClient as OperatorClient
    from construction_twin.ros.shared.params import NodeSettings as NodeSettings
    from construction_twin.ros.shared.params import read_parameters as read_parameters
    from construction_twin.ros.shared.params import robot_from_parameters as robot_from_parameters
    from construction_twin.ros.shared.robot_listener import RobotListener as RobotListener
    from construction_twin.ros.shared.work_follower import WorkFollower as WorkFollower
    from construction_twin.ros.shared.work_listener import WorkListener as WorkListener
else:
    __getattr__, __dir__, __all__ = lazy_exports(__name__)

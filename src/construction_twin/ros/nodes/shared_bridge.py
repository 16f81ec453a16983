"""shared_bridge: the bridges of several robots in one process, each with its own account, connection, topics and services.

It takes less memory than a process per robot. When it ends, by whatever cause, the links of all of them end: each gateway brakes
its arm and holds, and each robot is back once the process is.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import pydantic
import rospy

from construction_twin.ros.nodes import mqtt_bridge
from construction_twin.ros.nodes.mqtt_bridge import MqttBridge, run_bridges
from construction_twin.ros.shared.node import run_node
from construction_twin.ros.shared.params import NodeSettings, read_parameters
from construction_twin.ros.transport.subscriber import OWN_BRIDGE


class Settings(NodeSettings):
    """Private parameters; see launch/shared_bridge.launch.

    Attributes:
        robots: Namespaces of the robots, each with the parameters that its own bridge would have.
    """

    robots: tuple[str, ...] = pydantic.Field(min_length=1)


class SharedBridge:
    """The bridges of several robots; `run` polls them all in one thread."""

    def __init__(self, bridges: Sequence[MqttBridge]):
        self._bridges = bridges

    def run(self) -> None:
        """Poll the links until shutdown."""
        run_bridges(self._bridges)


def start() -> SharedBridge:
    """Return the bridges with their parameters, topics and services, connecting to their brokers."""
    names = [rospy.resolve_name(f"/{name.strip('/')}") for name in read_parameters(Settings).robots]
    places = [(f"{name}/", f"{name}/{OWN_BRIDGE}/") for name in names]
    # all are read before the first one connects: what is wrong with one must not make the others come and go
    read = [mqtt_bridge.NODE.read_in(*place) for place in places]
    return SharedBridge([mqtt_bridge.NODE.open(*values, *place) for values, place in zip(read, places)])


def main() -> None:
    """Run the node."""
    sys.setswitchinterval(0.001)
    run_node("shared_bridge", start)

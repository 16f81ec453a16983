"""Subscriptions of this package's nodes: each stream has one publisher, and an error in a callback ends the node."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable

import rospy

from construction_twin.core.errors import ConfigurationError, ProtocolError

#: The node that publishes a stream, by its name in the robot's namespace. The parameter `publishers` there names others. A topic
#: that is neither here nor in `FOR_ANYBODY` any node may publish.
PUBLISHERS = {
    "next/joint_states": "executor",
    "command/joint_states": "pca_monitor",
    "twin/joint_states": "virtual_robot",
    "twin/commanded": "virtual_robot",
    "gazebo/joint_states": "gazebo_arm",
    "physical/joint_states": "mqtt_bridge",
    "physical/feedback": "mqtt_bridge",
    "link": "mqtt_bridge",
    "session_request": "mqtt_bridge",
    "sync": "pca_monitor",
    "hold": "pca_monitor",
    "plan": "planner",
    "plan_caller": "follow_joint_trajectory",
    "rehearsal": "rehearsal",
    "scene": "scene",
    "execution": "executor",
    "engagement": "executor",
    "tool_command": "executor",
    "tool": "mqtt_bridge",
    "review": "executor",
    "work/tasks": "work",
    "conflict": "neighbour",
    "plan_outcome": "planner",
    "transitions": "pca_monitor",
    "velocities/joint_states": "display",
    "speed_limit_in_force": "pca_monitor",
    "speed_change": "pca_monitor",
}
#: Requests that any program may make, unless `publishers` names one node.
FOR_ANYBODY = ("joint_trajectory", "speed_limit")
#: Reason under which a message from another node than a stream's publisher is refused.
PUBLISHER = "publisher"


def publisher_of(topic: str) -> str | None:
    """Return the only node that may publish a topic; None: everybody. ConfigurationError where `publishers` is no mapping."""
    streams = (*PUBLISHERS, *FOR_ANYBODY)
    stream = next((name for name in streams if topic == name or topic.endswith(f"/{name}")), None)
    if stream is None:
        return None
    namespace = topic.removesuffix(stream)
    named = rospy.get_param(f"{namespace}publishers", {})
    known = isinstance(named, dict) and named.keys() <= set(streams)
    if not known or not all(isinstance(name, str) and name for name in named.values()):
        expected = f"a mapping from streams ({', '.join(streams)}) to names of nodes"
        raise ConfigurationError(rospy.resolve_name(f"{namespace}publishers"), named, expected)
    name = named.get(stream, PUBLISHERS.get(stream))
    if name is None:
        return None
    return rospy.resolve_name(name if name.startswith("/") else namespace + name)


def caller_of(message) -> str:
    """Return the name of the node that sent a message, "" when it did not say."""
    return message._connection_header.get("callerid", "")


def report_uncaught() -> None:
    """Report the handled exception to `threading.excepthook`, as if uncaught."""
    threading.excepthook(threading.ExceptHookArgs((*sys.exc_info(), threading.current_thread())))


class Subscriber:
    """As `rospy.Subscriber`, for one publisher, `publisher`; None: for any.

    A ProtocolError of the callback, and another node's message, are refused; any other exception goes to `threading.excepthook`.
    """

    def __init__(
        self,
        topic: str,
        kind: type,
        callback: Callable,
        refused: Callable[[str, str], None],
        queue_size: int,
        tcp_nodelay: bool = False,
    ):
        self.publisher = publisher_of(topic)
        self._callback = callback
        self._refused = refused
        self._subscriber = rospy.Subscriber(topic, kind, self._receive, queue_size=queue_size, tcp_nodelay=tcp_nodelay)

    @property
    def resolved_name(self) -> str:
        """The topic with its namespace."""
        return self._subscriber.resolved_name

    def get_num_connections(self) -> int:
        """Return the number of connected publishers that count."""
        if self.publisher is None:
            return self._subscriber.get_num_connections()
        return sum(connection.callerid_pub == self.publisher for connection in self._subscriber.impl.connections)

    def is_connected_to(self, name: str) -> bool:
        """Return whether the node of this resolved name is connected now."""
        return any(connection.callerid_pub == name for connection in self._subscriber.impl.connections)

    def unregister(self) -> None:
        """Unsubscribe."""
        self._subscriber.unregister()

    def _receive(self, message) -> None:
        try:
            # only a client that is none of ROS's own sends no name
            if self.publisher is None or caller_of(message) == self.publisher:
                self._callback(message)
            else:
                caller = caller_of(message) or "a node without a name"
                sentence = f"message from {caller}; only {self.publisher} may publish {self.resolved_name}"
                self._refused(PUBLISHER, sentence)
        except ProtocolError as error:
            self._refused(error.reason, str(error))
        except Exception:  # noqa: BLE001 (handed on to the excepthook)
            report_uncaught()

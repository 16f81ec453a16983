"""The floor of the link benchmark: bare rospy and bare paho, which hand each other bytes and do nothing in between.

Neither decodes or checks a message. Both sockets have TCP_NODELAY; the length of the ROS publisher's queue, the interpreter's
switch interval and the priority are the bridge's. Without these settings the floor would be up to 40 ms slower than the bridge.
"""

from __future__ import annotations

import socket
import sys

import rospy
from construction_twin.msg import Feedback
from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from construction_twin.core.realtime import request_realtime
from construction_twin.ros.transport.joint_stream import QUEUE


class Forwarded(Feedback):
    """A message that is serialised already."""

    raw = b""
    __slots__ = ()

    def serialize(self, buff) -> None:
        """Write the bytes."""
        buff.write(Forwarded.raw)


def main() -> None:
    """Forward `command/joint_states` to MQTT and `state` from MQTT to `physical/feedback` until shutdown."""
    port, prefix, realtime = rospy.myargv(sys.argv)[1:]
    sys.setswitchinterval(0.001)
    rospy.init_node("link_floor")
    publisher = rospy.Publisher("physical/feedback", Feedback, queue_size=QUEUE, tcp_nodelay=True)
    client = paho.Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
    client.on_socket_open = lambda client, userdata, sock: sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    message = Forwarded()

    def to_ros(client, userdata, received) -> None:
        Forwarded.raw = received.payload
        publisher.publish(message)

    client.on_message = to_ros
    client.on_connect = lambda client, *_: client.subscribe(f"{prefix}/state", 0)
    client.connect("127.0.0.1", int(port))
    client.loop_start()
    topic = f"{prefix}/command"
    rospy.Subscriber(
        "command/joint_states",
        rospy.AnyMsg,
        lambda received: client.publish(topic, received._buff),
        queue_size=QUEUE,
        tcp_nodelay=True,
    )
    request_realtime(int(realtime))
    rospy.spin()
    client.disconnect()
    client.loop_stop()


if __name__ == "__main__":
    main()

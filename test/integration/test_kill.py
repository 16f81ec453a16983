#!/usr/bin/env python3
"""The path of commands is interrupted in mid-motion: the arm brakes within its limits and holds; `reset` brings the system back."""

import os
import signal
import sys
import uuid
from pathlib import Path

import rospy
import rostest
from interruption import Interruption
from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from twin_client import HOME, wait

#: What is retained below twin/kr120/ while no plan waits for review.
RETAINED = ("status", "bridge/status", "scene")


def listens(pid: int, port: int) -> bool:
    """Return whether a process has the listening socket of a TCP port."""
    try:
        sockets = {os.readlink(entry.path) for entry in os.scandir(f"/proc/{pid}/fd")}
        rows = [row.split() for row in Path(f"/proc/{pid}/net/tcp").read_text().splitlines()[1:]]
    except OSError:
        return False
    return any(row[1].endswith(f":{port:04X}") and row[3] == "0A" and f"socket:[{row[9]}]" in sockets for row in rows)


def retained(port: int) -> dict[str, bytes]:
    """Return the payload of each message that a broker of this machine retains now, by topic; nothing while there is no broker."""
    found: dict[str, bytes] = {}
    client = paho.Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
    # what is retained comes before what is published after the subscription
    end, over = f"retained_until/{uuid.uuid4()}", []
    client.on_subscribe = lambda c, *_: c.publish(end, qos=1)

    def take(_client: paho.Client, _data: object, message: paho.MQTTMessage) -> None:
        if message.topic == end:
            over.append(True)
        elif message.retain:
            found[message.topic] = message.payload

    client.on_message = take
    try:
        client.connect("127.0.0.1", port)
    except OSError:
        return {}
    client.subscribe("#", 1)
    while not over and client.loop(1.0) == paho.MQTT_ERR_SUCCESS:
        pass
    client.disconnect()
    return found if over else {}


class KillTest(Interruption):
    """One interruption per test, each in the middle of a motion from home."""

    def test_killed_monitor(self):
        self.interrupt_and_recover(lambda: self.kill("pca_monitor"))
        self.assert_said("silence: no command for")

    def test_killed_bridge(self):
        self.interrupt_and_recover(lambda: self.kill("mqtt_bridge"))
        self.assert_said("silence: no command for")

    def test_killed_executor(self):
        self.interrupt_and_recover(lambda: self.kill("executor"))
        # nothing is forwarded any more, and the gate repeats nothing
        self.assert_said("silence: no command for")

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.port = rospy.get_param("mqtt_bridge/port")

    def test_killed_broker(self):
        self.interrupt_and_recover(self.kill_broker)
        self.assert_said("silence: no command for")

    def test_killed_broker_comes_back_with_everything_that_is_retained(self):
        # a plan under review is not among it: the new session drops it
        before = retained(self.port)
        self.assertLessEqual({f"twin/kr120/{name}" for name in RETAINED}, set(before))
        self.kill_broker()
        wait(lambda: set(retained(self.port)) == set(before), "the retained topics to be back", 30.0)
        self.assertEqual(retained(self.port)["twin/kr120/scene"], before["twin/kr120/scene"])
        self.client.wait_until_ready()
        self.client.go_to(HOME)

    def kill_broker(self):
        """Kill mosquitto, and wait until roslaunch has started it again."""
        before = self.broker()
        os.kill(before, signal.SIGKILL)
        wait(lambda: self.broker() not in (0, before), "the broker to be started again")

    def broker(self) -> int:
        """Return the process that listens on the broker's port; 0 when there is none."""
        names = Path("/proc").glob("[0-9]*/comm")
        pids = [int(file.parent.name) for file in names if file.read_text().strip() == "mosquitto"]
        return next((pid for pid in pids if listens(pid, self.port)), 0)


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "kill", KillTest, sys.argv)

#!/usr/bin/env python3
"""Garbage on MQTT, on the RSI port and from a bag moves nothing, is counted, and disturbs neither link nor motion."""

import json
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
import rospy
import rostest
from construction_twin.msg import (
    Engagement,
    PlanCaller,
    SessionRequest,
    SpeedChange,
    SpeedLimitInForce,
    ToolCommand,
    ToolState,
)
from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from played_bag import RefusalLog, excerpt, play, subscribers, write
from twin_client import HOME, LEFT, RIGHT, RobotTest, Stream

from construction_twin.core.units import radians
from construction_twin.gateway.command_intake import REMEMBERED
from construction_twin.mqtt.fast_client import UserProperties
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import Topics
from construction_twin.ros.transport.subscriber import PUBLISHERS
from construction_twin.rsi.controller_codec import RobotEncoder

FAR = JointStringCodec(6).encode(radians(RIGHT))
#: A joint string of the right length, to spoil one byte or field of.
GOOD = JointStringCodec(6).encode(radians(HOME))
NOW = "1795000000000000000"
#: The nodes whose work a strange message could disturb; others only show what they hear.
ACTING = {"pca_monitor", "executor", "virtual_robot", "mqtt_bridge", "planner", "scene"}
#: Who of them hears what could open the gate, keep it open, start a motion or switch a tool; `conflict` is a matter of two
#: robots, `twin/commanded` and `gazebo/joint_states` of a twin with mass, and `work/tasks` is only shown.
HEARD_BY = {
    "twin/joint_states": {"pca_monitor", "executor", "planner", "scene"},
    "physical/feedback": {"pca_monitor"},
    "physical/joint_states": {"virtual_robot"},
    "next/joint_states": {"pca_monitor"},
    "command/joint_states": {"virtual_robot", "mqtt_bridge"},
    "plan": {"pca_monitor", "executor"},
    "execution": {"pca_monitor", "mqtt_bridge"},
    "engagement": {"planner"},
    "tool_command": {"mqtt_bridge"},
    "tool": {"executor"},
    "review": {"planner"},
    "sync": {"executor", "mqtt_bridge"},
    "hold": set(),
    "link": {"pca_monitor", "executor", "virtual_robot"},
    "session_request": {"executor"},
    "speed_change": {"executor"},
    "speed_limit_in_force": {"executor", "mqtt_bridge"},
    "scene": {"executor", "planner"},
    "plan_outcome": set(),
    "plan_caller": set(),
    "rehearsal": {"executor"},
    "transitions": set(),
    "velocities/joint_states": set(),
}
#: Who of them acts on tf.
FRAMES = {"planner", "scene"}
#: What an arm without a tool, that nobody resets or limits, does not publish while it moves.
MADE = {
    "tool_command": ToolCommand(verb=ToolCommand.VOID),
    "tool": ToolState(),
    "engagement": Engagement(),
    "plan_caller": PlanCaller(),
    "session_request": SessionRequest(),
    "speed_change": SpeedChange(),
    "speed_limit_in_force": SpeedLimitInForce(),
}
#: Cycles over which an arm that must not move is watched.
WATCH = 250


class GarbageTest(RobotTest):
    """A hostile participant beside the running system."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.topics = Topics(rospy.get_param("mqtt_bridge/prefix"), "kr120")
        cls.mqtt = paho.Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        cls.heard_seq = 0
        cls.mqtt.on_connect = lambda client, *_: client.subscribe(cls.topics.command)
        cls.mqtt.on_message = cls.listen
        cls.mqtt.connect("127.0.0.1", rospy.get_param("mqtt_bridge/port"))
        cls.mqtt.loop_start()
        cls.log = RefusalLog()
        cls.udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        cls.gateway = ("127.0.0.1", rospy.get_param("mock_rsi/gateway_port"))

    @classmethod
    def tearDownClass(cls):
        cls.mqtt.disconnect()
        cls.mqtt.loop_stop()
        cls.udp.close()

    @classmethod
    def listen(cls, client, userdata, message):
        """Remember the stream's last sequence number, which a stranger can hear too."""
        pairs = dict(getattr(message.properties, "UserProperty", ()))
        if pairs.get("stamp", NOW) != NOW:
            cls.heard_seq = int(pairs["seq"])

    def setUp(self):
        self.begin()
        self.client.wait(lambda: type(self).heard_seq > 2 * REMEMBERED, "a stream that has gone on for a while")
        self.client.go_to(HOME)
        self.session = self.client.link.session
        self.changes = len(self.client.syncs)

    # -- the tests

    def test_garbage_is_counted_and_moves_nothing(self):
        sessions = self.client.gateway_counters()["rsi_sessions"]
        with Stream("mock_rsi/joint_states") as arm, Stream("twin/joint_states") as twin:
            before = self.counters()
            for name, count in self.send_garbage().items():
                expected = int(before.get(name, 0)) + count
                self.client.wait(lambda: int(self.counters().get(name, 0)) >= expected, f"{name} to rise by {count}")
                self.assertEqual(int(self.counters()[name]), expected, name)
            arm.wait_for_more(WATCH)
            for stream in (arm, twin):
                positions = stream.positions()
                np.testing.assert_array_equal(positions, np.broadcast_to(positions[0], positions.shape))
        self.assertGreater(self.client.link.states_refused, 0)
        self.assertEqual(self.client.gateway_counters()["rsi_sessions"], sessions, "a foreign datagram began a session")
        self.assert_undisturbed()

    def test_motion_in_the_middle_of_garbage(self):
        missed = self.client.mock_counter("missed")
        with Stream("mock_rsi/joint_states") as arm, Stream("twin/joint_states") as twin:
            plan = self.client.start(LEFT)

            next_burst = [0.0]

            def finished() -> bool:
                # about 80 messages ten times a second among the real ones; a flood is `make test ARGS=fuzz`
                if time.monotonic() >= next_burst[0]:
                    next_burst[0] = time.monotonic() + 0.1
                    self.send_garbage()
                return self.client.execution.plan_id == plan.plan_id and self.client.execution.outcome == "finished"

            self.client.wait(finished, "the plan to be finished")
            self.client.assert_at(LEFT, twin, arm)
            self.client.assert_within_limits(arm, missed)
        self.assert_undisturbed()

    def test_played_bag_is_refused(self):
        self.assertEqual(
            set(HEARD_BY), set(PUBLISHERS) - {"conflict", "work/tasks", "twin/commanded", "gazebo/joint_states"}
        )
        with tempfile.TemporaryDirectory() as folder:
            bag = Path(folder) / "motion.bag"
            self.record_motion(bag)
            self.client.go_to(HOME)
            violations = self.client.diagnostics("pca_monitor")["violations"]
            with Stream("mock_rsi/joint_states") as arm:
                self.assert_refused(bag)
                positions = arm.positions()
                np.testing.assert_array_equal(positions, np.broadcast_to(positions[0], positions.shape))
        self.assertEqual(self.client.diagnostics("pca_monitor")["violations"], violations)
        # and the system goes on
        self.client.wait_until_ready()
        self.client.go_to(LEFT)

    def assert_refused(self, bag: Path) -> None:
        """Play a bag; every node counts what it hears of it, and names each stream and the one who may publish it."""
        names = {topic: rospy.resolve_name(topic) for topic in HEARD_BY}
        for topic, name in names.items():
            heard_by = {node.removeprefix("/kr120/") for node in subscribers(name)} & ACTING
            self.assertEqual(heard_by, HEARD_BY[topic], topic)
        # who acts on tf refuses the frames of the robot's own trees
        self.assertLessEqual({f"/kr120/{node}" for node in FRAMES}, subscribers("/tf"))
        rules = [
            (node, rf"/kr120/{PUBLISHERS[topic]} may publish {names[topic]}")
            for topic in HEARD_BY
            for node in HEARD_BY[topic]
        ]
        frames = "/kr120/robot_state_publisher and /kr120/display may publish frames of kr120/twin on /tf"
        rules += [(node, frames) for node in FRAMES]
        streams = Counter(node for node, _ in rules)
        before = {node: self.refused(node) for node in streams}
        made = {names[topic]: [message] for topic, message in MADE.items()}
        recorded = excerpt(bag, [*(name for name in names.values() if name not in made), "/tf"])
        play(write(bag.with_name("all.bag"), recorded | made))
        for node, number in streams.items():
            self.client.wait(lambda: self.refused(node) >= before[node] + number, f"{node} to count what a bag holds")
            self.assertRegex(
                self.client.diagnostics(node)["last refused publisher"], r"^message from \S*/play_\d+; only /kr120/"
            )
        for node, rule in rules:
            self.log.assert_named_once(f"/kr120/{node}", rule)

    def refused(self, node: str) -> int:
        """The messages of another publisher that a node has counted."""
        return int(self.client.diagnostics(node).get("refused publisher", 0))

    def record_motion(self, bag: Path) -> None:
        """Record a motion to another pose."""
        topics = [rospy.resolve_name(topic) for topic in HEARD_BY if topic not in MADE] + ["/tf"]
        rehearsals: list = []
        heard = rospy.Subscriber("rehearsal", rospy.AnyMsg, rehearsals.append)
        recorder = subprocess.Popen(["rosbag", "record", "--quiet", "-O", bag, *topics])
        try:
            for topic in topics:
                self.client.wait(
                    lambda: any("/record_" in node for node in subscribers(topic)), f"the recorder to hear {topic}"
                )
            self.client.go_to(LEFT)
            # the first one begins with a start of its process, behind everything else: it may end after the motion
            self.client.wait(lambda: rehearsals, "the rehearsal of the motion", 40.0)
        finally:
            heard.unregister()
            recorder.send_signal(signal.SIGINT)
            recorder.wait(10)

    # -- what is sent

    def send_garbage(self) -> Counter:
        """Send all of it; return what gateway and bridge must count."""
        return self.send_commands() + self.send_controls() + self.send_states() + self.send_datagrams()

    def counters(self) -> dict[str, str]:
        """Return what gateway and bridge have counted."""
        return self.client.gateway_counters() | self.client.diagnostics("mqtt_bridge")

    def send_commands(self) -> Counter:
        """Publish on `command`; return what the gateway must count."""
        # as close to valid as a stranger gets who listens: session and a sequence number to come
        mine = [("session", self.session), ("seq", str(self.heard_seq + 200)), ("stamp", NOW)]
        cases = [
            ("refused_length", b"", mine),
            ("refused_length", GOOD[:-1], mine),
            ("refused_length", GOOD + b",+000.000", mine),
            ("refused_length", bytes(10000), mine),
            ("refused_decimals", JointStringCodec(6, 4).encode(radians(RIGHT)), mine),
            ("refused_format", b"+000.nan" + GOOD[8:], mine),
            ("refused_format", b"+000,000" + GOOD[8:], mine),
            ("refused_format", "+00ä.00".encode() + GOOD[8:], mine),
            ("refused_format", "+00٣.00".encode() + GOOD[8:], mine),
            ("refused_format", b"\x00" * len(GOOD), mine),
            ("refused_properties", FAR, None),
            ("refused_properties", FAR, mine[:2]),
            ("refused_properties", FAR, mine + mine[:1]),
            ("refused_properties", FAR, [*mine[:2], ("stamp", "nan")]),
            ("refused_properties", FAR, [*mine[:2], ("stamp", "9" * 40)]),
            ("refused_session", FAR, [("session", "another"), *mine[1:]]),
            ("refused_sequence", FAR, [mine[0], ("seq", "1"), mine[2]]),
            ("refused_sequence", FAR, [mine[0], ("seq", "999999999999"), mine[2]]),
        ]
        for _, payload, properties in cases:
            self.publish(self.topics.command, payload, properties)
        self.publish(self.topics.command, FAR, mine, retain=True)
        self.publish(self.topics.command, b"", None, retain=True)
        return Counter(name for name, _, _ in cases) + Counter(refused_retained=2)

    def send_controls(self) -> Counter:
        """Publish on `control`; return what the gateway must count."""
        known = {"id": "1", "session": "another", "value": "0" * 64}
        garbage = [b"", b"{", b"[]", b"\xff\xfe", b"[" * 2000, b'"stop"', json.dumps(known).encode(), b" " * 5000]
        for payload in (
            *garbage,
            json.dumps(known | {"verb": 1}).encode(),
            json.dumps(known | {"verb": "stop", "x": 1}).encode(),
        ):
            self.publish(self.topics.control, payload)
        for verb in ("fly", "STOP", "arm"):
            self.publish(self.topics.control, json.dumps(known | {"verb": verb}).encode())
        for payload in (json.dumps(known | {"verb": "stop"}).encode(), b""):
            self.publish(self.topics.control, payload, retain=True)
        return Counter(refused_control=len(garbage) + 2, refused_verb=2, refused_arm=1, refused_retained=2)

    def send_states(self) -> Counter:
        """Publish on `state`, `status` and `control/ack`; return what the bridge must count."""
        old = [("seq", "2"), ("stamp", NOW), ("command_stamp", NOW)]
        states = [
            ("refused state_length", b"", old),
            ("refused state_length", FAR[:-1], old),
            ("refused state_decimals", JointStringCodec(6, 4).encode(radians(RIGHT)), old),
            ("refused state_format", b"+000.nan" + GOOD[8:], old),
            ("refused state_format", b"\xff" * len(GOOD), old),
            ("refused state_properties", FAR, None),
            ("refused state_properties", FAR, old[:2]),
            ("refused state_properties", FAR, [("seq", "-1"), *old[1:]]),
            ("refused state_sequence", FAR, old),
            # if this one were accepted, every real one would count as old from then on
            ("refused state_sequence", FAR, [("seq", "999999999999"), *old[1:]]),
            ("refused state_sequence", FAR, [("seq", str(4 * 10**18)), ("stamp", "0"), old[2]]),
        ]
        for _, payload, properties in states:
            self.publish(self.topics.state, payload, properties)
        self.publish(self.topics.state, FAR, old, retain=True)
        self.publish(self.topics.state, b"", None, retain=True)
        statuses = [
            b"",
            b"{",
            b"[]",
            b"\xff",
            b'{"state": 5}',
            b'{"state": "armed", "counters": [1]}',
            b'{"reply_us": {"bins": [NaN]}}',
        ]
        for payload in statuses:
            self.publish(self.topics.status, payload)
        for payload in statuses[:4]:
            self.publish(self.topics.control_ack, payload)
        self.publish(self.topics.control_ack, b'{"id": "1", "ok": true}')
        return Counter(name for name, _, _ in states) + Counter(
            {"refused state_retained": 2, "refused status": len(statuses) + 4}
        )

    def send_datagrams(self) -> Counter:
        """Send to the RSI port from another socket, well-formed telegrams too; return what the gateway must count."""
        pose, elsewhere = (1.0, 0.0, 1.0, 0.0, 0.0, 0.0), radians(RIGHT)
        encoder = RobotEncoder(("A1", "A2", "A3", "A4", "A5", "A6"), 6)
        telegrams = [encoder.encode(1000 + 4 * k, elsewhere, elsewhere, pose, pose, 0) for k in range(20)]
        garbage = [b"", b"\x00" * 60, b"<Rob", b"<Rob Type='KUKA'><IPOC>x</IPOC></Rob>", bytes(range(256)) * 200]
        for data in (*garbage, *telegrams):
            self.udp.sendto(data, self.gateway)
        return Counter(telegram_refused_source=len(garbage) + len(telegrams))

    # -- how it is judged

    def publish(
        self, topic: str, payload: bytes, properties: list[tuple[str, str]] | None = None, retain: bool = False
    ):
        """Publish one message."""
        beside = UserProperties(properties) if properties else None
        self.mqtt.publish(topic, payload, qos=1, retain=retain, properties=beside)

    def assert_undisturbed(self):
        """The link was never lost: same session, armed, in sync."""
        self.assertEqual(self.client.link.session, self.session)
        self.assertTrue(self.client.armed() and self.client.in_sync(), self.client.describe())
        self.assertEqual(len(self.client.syncs), self.changes, [sync.text for sync in self.client.syncs])


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "garbage", GarbageTest, sys.argv)

#!/usr/bin/env python3
"""After bringup: every topic at its rate, tf, diagnostics, twin and arm in the same pose."""

import struct
import sys

import numpy as np
import rosgraph
import rospy
import rostest
import tf2_ros
from construction_twin.msg import Feedback, Sync
from sensor_msgs.msg import JointState
from started import Started
from twin_client import HOME, RobotTest, Stream, case, wait

from construction_twin.core.units import NANOSECONDS, radians
from construction_twin.ros.shared.master import running

STREAMS = (
    "next/joint_states",
    "command/joint_states",
    "twin/joint_states",
    "physical/joint_states",
    "physical/feedback",
)
NODES = ("planner", "executor", "pca_monitor", "virtual_robot", "mqtt_bridge", "mock_rsi")
#: Length over which a rate is counted [s].
WINDOW = 5


class Rate:
    """A topic's rate by the stamps of its messages, which are not unpacked: whoever counts here may be late."""

    def __init__(self, topic: str):
        self.stamps: list[int] = []
        self._subscriber = rospy.Subscriber(topic, rospy.AnyMsg, self._on_message, tcp_nodelay=True)

    def _on_message(self, message: rospy.AnyMsg) -> None:
        _, seconds, nanoseconds = struct.unpack_from("<3I", message._buff)
        self.stamps.append(seconds * NANOSECONDS + nanoseconds)

    def value(self, seconds: float) -> float:
        """Wait for messages over that time; return their rate [Hz]."""
        over = lambda: len(self.stamps) > 1 and self.stamps[-1] - self.stamps[0] > seconds * NANOSECONDS  # noqa: E731
        wait(over, "messages to count", 40.0)
        self._subscriber.unregister()
        stamps = list(self.stamps)
        return (len(stamps) - 1) * NANOSECONDS / (stamps[-1] - stamps[0])


class BringupTest(RobotTest):
    """The idle system."""

    def setUp(self):
        self.begin()

    def test_streams_run_at_250_hz(self):
        # and what is made of them for planners and rviz
        expected = dict.fromkeys(STREAMS, 250.0) | {"joint_states": 50.0}
        rates = {topic: Rate(topic) for topic in expected}
        for topic, rate in rates.items():
            with case(topic):
                self.assertAlmostEqual(rate.value(WINDOW), expected[topic], delta=5.0)

    def test_joint_states_tell_planners_velocities(self):
        with Stream("joint_states") as shown:
            shown.wait_for_more(10)
        last = shown.messages[-1]
        self.assertEqual(tuple(last.name), self.client.robot.joint_names)
        self.assertEqual(tuple(last.velocity), (0.0,) * 6)

    def test_sync_reports_every_joint(self):
        sync = rospy.wait_for_message("sync", Sync, 5.0)
        self.assertEqual(sync.text, "IN_SYNC")
        self.assertEqual(sync.comparison, "aligned")
        self.assertEqual(tuple(sync.name), self.client.robot.joint_names)
        self.assertEqual(len(sync.error), 6)
        self.assertTrue(0.0 < sync.round_trip < 0.25, sync.round_trip)

    def test_twin_and_arm_are_at_home(self):
        for topic in ("twin/joint_states", "physical/joint_states", "mock_rsi/joint_states"):
            with case(topic), Stream(topic) as stream:
                np.testing.assert_array_equal(np.round(stream.positions()[-1] - radians(HOME), 12), 0.0)

    def test_names_and_headers(self):
        feedback = rospy.wait_for_message("physical/feedback", Feedback, 5.0)
        self.assertEqual(tuple(feedback.name), self.client.robot.joint_names)
        self.assertGreater(feedback.seq, 0)
        self.assertGreater(feedback.command_stamp.to_nsec(), 0)
        command = rospy.wait_for_message("command/joint_states", JointState, 5.0)
        self.assertEqual(command.header.stamp.to_nsec() % 4_000_000, 0)

    def test_tf_reaches_both_tools(self):
        buffer = tf2_ros.Buffer()
        listener = tf2_ros.TransformListener(buffer)
        places = []
        for side in ("twin", "physical"):
            transform = buffer.lookup_transform("world", f"kr120/{side}/tool0", rospy.Time(0), rospy.Duration(10.0))
            place = transform.transform.translation
            places.append((place.x, place.y, place.z))
        np.testing.assert_allclose(places[0], places[1], atol=1e-9)
        listener.unregister()

    def test_every_node_reports_diagnostics(self):
        try:
            self.client.wait(lambda: self.client.diagnosed_nodes() >= set(NODES), f"diagnostics of each of {NODES}")
        except AssertionError as error:
            self.fail(f"{error}; heard of {sorted(self.client.diagnosed_nodes())}")

    def test_gateway_and_bridge_count_one_session(self):
        counters = self.client.gateway_counters
        self.client.wait(lambda: int(counters().get("commands_received", 0)) > 250, "the gateway to count commands")
        self.assertTrue(self.client.link.session)
        self.assertEqual(self.client.link.gateway_state, "following")
        self.assertEqual(int(counters().get("commands_lost", 0)), 0)
        self.assertEqual(self.client.link.commands_refused, 0)
        self.assertEqual(self.client.link.states_refused, 0)

    def test_a_second_start_of_the_same_robot_is_refused_and_takes_nothing_over(self):
        nodes = [f"/kr120/{name}" for name in NODES]
        uri = rosgraph.get_master_uri()
        wait(lambda: [node.name for node in running(nodes, uri) if node.pid] == nodes, f"{nodes} to answer", 30.0)
        before, session = running(nodes, uri), self.client.link.session
        # it replaces them before it is refused, and other tests of this bringup read them
        self.addCleanup(rospy.set_param, "/kr120", rospy.get_param("/kr120"))
        second = Started("roslaunch", "construction_twin", "bringup.launch", "broker:=false", "gateway:=false")
        said, why = second.finish(60.0), "cannot start: /kr120/startup: found '/kr120/startup on "
        self.assertEqual(second.process.returncode, 1)
        self.assertEqual((said.count("cannot start: "), said.count(why)), (1, 1), said)
        self.assertNotIn("Traceback", said)
        self.assertEqual(running(nodes, uri), before)
        self.assertEqual(self.client.link.session, session)


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "bringup", BringupTest, sys.argv)

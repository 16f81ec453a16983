#!/usr/bin/env python3
"""One process is the bridge of two robots and is killed in mid-motion: each arm brakes within its limits, holds, and comes back.

The gates are this test's: a node per robot publishes commands under the gate's name, from where the arm stands.
"""

import math
import os
import signal
import sys
import time
import unittest
from collections import deque

import numpy as np
import rospy
import rostest
from construction_twin.msg import Feedback, Link
from diagnostic_msgs.msg import DiagnosticArray
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger
from twin_client import node_pid, wait

from construction_twin.core.realtime import release_realtime, request_realtime
from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS
from construction_twin.gateway.states import State
from construction_twin.gateway.trace import read_trace
from construction_twin.ros.shared.gateway_config import config_from_parameters
from construction_twin.ros.shared.params import robot_from_parameters
from construction_twin.ros.transport.joint_stream import QUEUE, JointPublisher
from construction_twin.scenario.trace_check import trace_excesses

ROBOTS = ("left", "right")
#: The first axis swings by this much [rad], so often [1/s]: at 0.5 rad/s at most.
SWING, RATE = 0.25, 2.0


class Gate:
    """Publishes commands of one robot under its gate's name: at rest where the arm is, or swinging, as /swings says."""

    def __init__(self):
        rospy.init_node("pca_monitor")
        robot = robot_from_parameters()
        self._newest = self._rest = tuple(robot.home)
        self._cycle, self._swings = 0, False
        self._publisher = JointPublisher("command/joint_states", robot.joint_names)
        rospy.Subscriber("physical/feedback", Feedback, self._on_feedback, queue_size=QUEUE, tcp_nodelay=True)
        rospy.Subscriber("/swings", Bool, self._on_order)
        request_realtime(40)

    def _on_feedback(self, message: Feedback) -> None:
        self._newest = tuple(message.position)

    def _on_order(self, message: Bool) -> None:
        self._rest, self._cycle, self._swings = self._newest, 0, message.data

    def run(self) -> None:
        """Publish on a grid until shutdown."""
        due = time.monotonic_ns()
        while not rospy.is_shutdown():
            self._cycle += self._swings
            turned = SWING * (1.0 - math.cos(RATE * self._cycle * CYCLE))
            self._publisher.publish(due, (self._rest[0] + turned, *self._rest[1:]))
            due += CYCLE_NS
            time.sleep(max(0, due - time.monotonic_ns()) / NANOSECONDS)
        release_realtime()


class SharedBridgeTest(unittest.TestCase):
    """The links of two robots, of one process."""

    @classmethod
    def setUpClass(cls):
        rospy.init_node("shared_bridge_test")
        cls.swings = rospy.Publisher("/swings", Bool, queue_size=1, latch=True)
        cls.links = {}
        #: Names of what was reported on /diagnostics.
        cls.reports = set()
        rospy.Subscriber(
            "/diagnostics", DiagnosticArray, lambda told: cls.reports.update(one.name for one in told.status)
        )
        #: Where the first axis of each arm was in the last second [rad].
        cls.turned = {name: deque(maxlen=250) for name in ROBOTS}
        for name in ROBOTS:
            take = cls.turned[name].append
            rospy.Subscriber(
                f"/{name}/mock_rsi/joint_states", JointState, lambda message, take=take: take(message.position[0])
            )
            rospy.Subscriber(f"/{name}/link", Link, lambda message, name=name: cls.links.update({name: message}))

    def test_killed_while_both_arms_move(self):
        self.wait_for_all("following", 25.0)
        told = {f"{name}/mqtt_bridge: state" for name in ROBOTS}
        wait(lambda: told <= self.reports, "each robot's bridge on /diagnostics, as if it had a process")
        self.assertEqual(len({self.links[name].session for name in ROBOTS}), 2)
        self.order("swing")
        wait(lambda: all(self.moved(name, 0.1) for name in ROBOTS), "both arms to move")
        killed = node_pid("/shared_bridge")
        self.assertGreater(killed, 0)
        marks = {name: len(self.trace(name)) for name in ROBOTS}
        os.kill(killed, signal.SIGKILL)
        for name in ROBOTS:
            wait(lambda name=name: self.trace(name)[-1].state is State.HOLDING, f"{name} to hold", period=0.5)
            entries = self.trace(name)[marks[name] :]
            self.assertIn(State.BRAKING, {entry.state for entry in entries})
            self.assertEqual(entries[-1].position, entries[-2].position)
        wait(lambda: node_pid("/shared_bridge") not in (0, killed), "the bridges to be started again", 30.0)
        for name in ROBOTS:
            wait(lambda name=name: self.links[name].state == Link.NEEDS_RESET, f"{name} to need a reset", 30.0)
        stood = {name: self.trace(name)[-1].position for name in ROBOTS}
        # refused until the new process has seen the arm at rest; one whose gate is there already comes back by itself
        for name in ROBOTS:
            wait(lambda name=name: self.is_back(name), f"{name} to be back", period=0.5)
        self.wait_for_all("following", 30.0)
        for name in ROBOTS:
            tolerance = rospy.get_param(f"/{name}/gateway/start_tolerance")
            self.assertLessEqual(np.abs(np.subtract(self.trace(name)[-1].position, stood[name])).max(), tolerance)
        self.order("swing")
        wait(lambda: all(self.moved(name, 0.1) for name in ROBOTS), "both arms to move again")
        for name in ROBOTS:
            self.assert_within_limits(name)

    def order(self, what: str) -> None:
        """Have both gates do something, from where their arms are."""
        self.swings.publish(what == "swing")

    def is_back(self, name: str) -> bool:
        """Have the gates take the arms' poses, as twins do, and return whether a robot's link is armed; ask for a reset if not."""
        self.order("rest")
        return self.links[name].state == Link.ARMED or rospy.ServiceProxy(f"/{name}/reset", Trigger)().success

    def wait_for_all(self, state: str, timeout: float) -> None:
        """Wait until both gateways are in a state, by the words of their links."""

        def reached() -> bool:
            return all(name in self.links and self.links[name].gateway_state == state for name in ROBOTS)

        try:
            wait(reached, f"both gateways to be {state}", timeout)
        except AssertionError as error:
            said = {name: f"{link.gateway_state}, {link.text}: {link.reason}" for name, link in self.links.items()}
            raise AssertionError(f"{error}; {said}") from None

    def moved(self, name: str, angle: float) -> bool:
        """Return whether the first axis has turned by an angle [rad] within the last second."""
        turned = list(self.turned[name])
        return len(turned) == 250 and max(turned) - min(turned) > angle

    def trace(self, name: str) -> list:
        """Return what a robot's gateway has sent so far."""
        return read_trace(f"{rospy.get_param('~traces')}{name}.trace")

    def assert_within_limits(self, name: str) -> None:
        """Assert that what a robot's gateway has sent is inside the limits in every cycle."""
        config = config_from_parameters(f"/{name}/")
        found = trace_excesses(self.trace(name), config.limits, config.decimals, config.period)
        self.assertFalse(found, "; ".join(map(str, found[:5])))


if __name__ == "__main__":
    if "gate" in sys.argv:
        Gate().run()
    else:
        rostest.rosrun("construction_twin", "shared_bridge_killed", SharedBridgeTest, sys.argv)

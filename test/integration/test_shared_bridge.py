#!/usr/bin/env python3
"""One process is the bridge of two robots and is killed in mid-motion: each arm brakes within its limits, holds, and comes back.

The gates are this test's: a process per robot publishes commands under the gate's name, from where the arm stands.
"""

import math
import multiprocessing
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
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger
from twin_client import node_pid, wait

from construction_twin.core.realtime import request_realtime
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


def gate(robot: str, names: tuple[str, ...], home: tuple[float, ...], orders) -> None:
    """Publish commands of one robot as its gate: at rest where the arm is, or swinging, as `orders` say; None ends it."""
    os.environ["ROS_NAMESPACE"] = robot
    rospy.names._set_caller_id(f"/{robot}/unnamed")
    rospy.init_node("pca_monitor", argv=[], disable_signals=True, disable_rosout=True)
    request_realtime(40)
    newest = [home]
    rospy.Subscriber(
        f"/{robot}/physical/feedback",
        Feedback,
        lambda message: newest.append(tuple(message.position)) or newest.pop(0),
        queue_size=QUEUE,
        tcp_nodelay=True,
    )
    publisher = JointPublisher(f"/{robot}/command/joint_states", names)
    due, rest, cycle, swings = time.monotonic_ns(), home, 0, False
    while True:
        if orders.poll():
            order = orders.recv()
            if order is None:
                rospy.signal_shutdown("over")
                return
            swings, cycle, rest = order == "swing", 0, newest[0]
        cycle += swings
        turned = SWING * (1.0 - math.cos(RATE * cycle * CYCLE))
        publisher.publish(due, (rest[0] + turned, *rest[1:]))
        due += CYCLE_NS
        time.sleep(max(0, due - time.monotonic_ns()) / NANOSECONDS)


class SharedBridgeTest(unittest.TestCase):
    """The links of two robots, of one process."""

    @classmethod
    def setUpClass(cls):
        cls.robot = robot_from_parameters("/left/")
        context = multiprocessing.get_context("fork")  # rospy has no thread in here yet
        cls.orders, cls.gates = {}, []
        for name in ROBOTS:
            cls.orders[name], far = context.Pipe()
            arguments = name, cls.robot.joint_names, tuple(cls.robot.home), far
            cls.gates.append(context.Process(target=gate, args=arguments, daemon=True))
            cls.gates[-1].start()
        rospy.init_node("shared_bridge_test")
        cls.links = {}
        #: Where the first axis of each arm was in the last second [rad].
        cls.turned = {name: deque(maxlen=250) for name in ROBOTS}
        for name in ROBOTS:
            take = cls.turned[name].append
            rospy.Subscriber(f"/{name}/mock_rsi/joint_states", JointState, lambda message, take=take: take(message.position[0]))
            rospy.Subscriber(f"/{name}/link", Link, lambda message, name=name: cls.links.update({name: message}))

    @classmethod
    def tearDownClass(cls):
        for name, process in zip(ROBOTS, cls.gates):
            cls.orders[name].send(None)
            process.join(5.0)

    def test_killed_while_both_arms_move(self):
        self.wait_for_all("following", 60.0)
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
        self.order("rest")
        for name in ROBOTS:
            wait(lambda name=name: self.links[name].state == Link.NEEDS_RESET, f"{name} to need a reset", 30.0)
            stood = self.trace(name)[-1].position
            answer = rospy.ServiceProxy(f"/{name}/reset", Trigger)()
            self.assertTrue(answer.success, answer.message)
            tolerance = rospy.get_param(f"/{name}/gateway/start_tolerance")
            self.assertLessEqual(np.abs(np.subtract(self.trace(name)[-1].position, stood)).max(), tolerance)
        self.wait_for_all("following", 30.0)
        self.order("swing")
        wait(lambda: all(self.moved(name, 0.1) for name in ROBOTS), "both arms to move again")
        for name in ROBOTS:
            self.assert_within_limits(name)

    def order(self, what: str) -> None:
        """Have both gates do something, from where their arms are."""
        for pipe in self.orders.values():
            pipe.send(what)

    def wait_for_all(self, state: str, timeout: float) -> None:
        """Wait until both gateways are in a state, by the words of their links."""

        def reached() -> bool:
            return all(name in self.links and self.links[name].gateway_state == state for name in ROBOTS)

        try:
            wait(reached, f"both gateways to be {state}", timeout)
        except AssertionError as error:
            said = {name: f"{link.gateway_state}, {link.name}: {link.reason}" for name, link in self.links.items()}
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
    rostest.rosrun("construction_twin", "shared_bridge_killed", SharedBridgeTest, sys.argv)

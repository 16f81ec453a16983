#!/usr/bin/env python3
"""The ROS master dies in mid-motion: what is connected stays connected, the motion is finished, and both directions go on."""

import ctypes
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
import unittest
import xmlrpc.client

import rosgraph
import rospy
import rostest
from construction_twin.msg import Link
from construction_twin.srv import PlanToJoints
from twin_client import LEFT, Stream, TwinClient, wait

BROKER_PORT, RSI_PORT = 18843, 49213
#: Option of prctl(2): which signal to get when the parent ends.
_PDEATHSIG = 1


class FaultMasterTest(unittest.TestCase):
    """A bringup of its own on a master of its own."""

    @classmethod
    def setUpClass(cls):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        os.environ["ROS_MASTER_URI"] = f"http://localhost:{port}"
        cls.folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(cls.folder.cleanup)
        cls.trace = os.path.join(cls.folder.name, "trace")
        cls.master = start("rosmaster", "--core", "-p", str(port))
        cls.addClassCleanup(cls.master.kill)
        wait_for(master_answers, "the master")
        cls.bringup = start(
            *(
                "roslaunch",
                "construction_twin",
                "bringup.launch",
                f"broker_port:={BROKER_PORT}",
                f"rsi_port:={RSI_PORT}",
            ),
            f"gateway_trace:={cls.trace}",
        )
        cls.addClassCleanup(cls.end_bringup)
        wait_for(lambda: rosgraph.Master("/test").hasParam("/kr120/gateway/ethernet_xml"), "the bringup's parameters")
        rospy.init_node("fault_master")
        cls.client = TwinClient()

    @classmethod
    def end_bringup(cls):
        """End roslaunch and with it the nodes."""
        cls.bringup.send_signal(signal.SIGINT)
        try:
            cls.bringup.wait(40.0)
        finally:
            cls.bringup.kill()

    def test_a_motion_is_finished_without_a_master(self):
        client = self.client
        client.wait_until_ready(60.0)
        rospy.wait_for_service("plan_to_joints", 60.0)
        with (
            Stream("mock_rsi/joint_states") as arm,
            Stream("twin/joint_states") as twin,
            Stream("physical/joint_states") as physical,
        ):
            plan = client.start(LEFT, duration=3.0)
            wait(lambda: arm.moved(5.0), "the arm to move")
            session = client.link.session
            self.master.kill()
            self.master.wait(10.0)
            client.wait_for_outcome(plan.plan_id, "finished")
            client.assert_at(LEFT, twin, physical, arm)
            # nothing came to a stop: commands go out, states come in, the gate is open
            for stream in (arm, twin, physical):
                stream.wait_for_more(250)
            self.assertTrue(client.armed() and client.in_sync() and client.idle(), client.describe())
            self.assertEqual(client.link.session, session)
            self.assertIsNone(self.bringup.poll(), "roslaunch has ended")
            client.assert_trace_within_limits(self.trace)
        self.assertFalse(master_answers())
        # without a master no client finds a service: a new motion begins with a new start of the ROS PC
        with self.assertRaises(rospy.ROSException):
            rospy.ServiceProxy("plan_to_joints", PlanToJoints).wait_for_service(1.0)
        self.assertEqual(client.link.state, Link.ARMED)


def start(*command: str) -> subprocess.Popen:
    """Start a process that ends with this one, also when this one is killed at its time limit."""
    prctl = ctypes.CDLL(None).prctl
    # the namespace is this test's own
    environment = {name: value for name, value in os.environ.items() if name != "ROS_NAMESPACE"}
    return subprocess.Popen(
        command,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        preexec_fn=lambda: prctl(_PDEATHSIG, signal.SIGINT),
    )


def master_answers() -> bool:
    """Return whether a master is there."""
    try:
        return bool(rosgraph.Master("/test").getPid())
    except (rosgraph.MasterException, OSError, xmlrpc.client.Error):
        return False


def wait_for(condition, what: str, timeout: float = 40.0) -> None:
    """Wait as `twin_client.wait`, before there is a node."""
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline, f"waited {timeout:g} s in vain for {what}"
        time.sleep(0.05)


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "fault_master", FaultMasterTest, sys.argv)

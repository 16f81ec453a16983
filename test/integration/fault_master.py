#!/usr/bin/env python3
"""The ROS master dies in mid-motion: what is connected stays connected, the motion is finished, and both directions go on."""

import os
import sys
import tempfile
import unittest
import xmlrpc.client

import rosgraph
import rospy
import rostest
from construction_twin.msg import Link
from construction_twin.srv import PlanToJoints
from started import Started
from twin_client import LEFT, Stream, TwinClient, wait

MASTER_PORT = "18842"


class FaultMasterTest(unittest.TestCase):
    """A bringup of its own on a master of its own."""

    @classmethod
    def setUpClass(cls):
        os.environ["ROS_MASTER_URI"] = f"http://localhost:{MASTER_PORT}"
        folder = tempfile.TemporaryDirectory()
        cls.addClassCleanup(folder.cleanup)
        cls.trace = f"{folder.name}/trace"
        cls.master = Started("rosmaster", "--core", "-p", MASTER_PORT).process
        cls.addClassCleanup(cls.master.kill)
        wait(master_answers, "the master")
        words = ("broker_port:=18843", "rsi_port:=49213", f"gateway_trace:={cls.trace}")
        cls.bringup = Started("roslaunch", "construction_twin", "bringup.launch", *words)
        cls.addClassCleanup(cls.bringup.end)
        wait(lambda: rosgraph.Master("/test").hasParam("/kr120/gateway/ethernet_xml"), "the bringup's parameters", 40.0)
        rospy.init_node("fault_master")
        cls.client = TwinClient()

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
            self.assertIsNone(self.bringup.process.poll(), "roslaunch has ended")
            client.assert_trace_within_limits(self.trace)
        self.assertFalse(master_answers())
        # without a master no client finds a service: a new motion begins with a new start of the ROS PC
        with self.assertRaises(rospy.ROSException):
            rospy.ServiceProxy("plan_to_joints", PlanToJoints).wait_for_service(1.0)
        self.assertEqual(client.link.state, Link.ARMED)


def master_answers() -> bool:
    """Return whether a master is there."""
    try:
        return bool(rosgraph.Master("/test").getPid())
    except (rosgraph.MasterException, OSError, xmlrpc.client.Error):
        return False


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "fault_master", FaultMasterTest, sys.argv)

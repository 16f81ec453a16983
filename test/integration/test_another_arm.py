#!/usr/bin/env python3
"""An arm that is not a KUKA through the whole chain: plan to joints, to a pose and along a line; approve; execute; at the goal."""

import sys

import numpy as np
import rospy
import rostest
import tf2_ros
from construction_twin.msg import CartesianWaypoint
from construction_twin.srv import PlanCartesian, PlanToPose
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion
from sensor_msgs.msg import JointState
from twin_client import RobotTest, Stream, TwinClient

from construction_twin.kinematics.chain import Chain
from construction_twin.robot.frames import rotation_to_quaternion

#: In the robot's order, pan to wrist_3 [deg].
HOME = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)
GOAL = (35.0, -75.0, 80.0, -20.0, 70.0, 40.0)


class AnotherArmTest(RobotTest):
    """Every test begins at rest at home."""

    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_another_arm")
        cls.client = TwinClient()
        for service in ("plan_to_pose", "plan_cartesian"):
            rospy.wait_for_service(service, 60.0)
        cls.chain = Chain(cls.client.robot)
        cls.tf = tf2_ros.Buffer()
        cls.tf_listener = tf2_ros.TransformListener(cls.tf)

    def setUp(self):
        self.begin(60.0)
        self.client.go_to(HOME)

    def test_the_joints_are_those_of_its_urdf_and_begin_at_its_home(self):
        shown = rospy.wait_for_message("joint_states", JointState, 20.0)
        chain = {"pan", "lift", "elbow", "wrist_1", "wrist_2", "wrist_3"}
        self.assertEqual(set(shown.name), chain | {"slide_left", "slide_right", "hinge"})
        zeros = rospy.get_param("joint_state_publisher/zeros")
        np.testing.assert_allclose([zeros[name] for name in self.client.robot.joint_names], self.client.si(HOME))

    def test_the_fingers_stand_where_the_yaml_says_in_all_three_trees(self):
        tool = self.chain.forward(self.client.si(HOME))
        wanted = {"finger_left": (0.03, 0.0, 0.06), "finger_right": (-0.03, 0.0, 0.06), "camera": (0.0, 0.03, 0.03)}
        for tree in ("twin", "physical", "preview"):
            for link, place in wanted.items():
                with self.subTest(tree=tree, link=link):
                    frame = f"ur_like/{tree}/{link}"
                    found = self.tf.lookup_transform("world", frame, rospy.Time(0), rospy.Duration(20.0)).transform
                    position = (found.translation.x, found.translation.y, found.translation.z)
                    np.testing.assert_allclose(position, tool.position + tool.rotation @ place, atol=1e-4)

    def test_to_joints(self):
        missed = self.client.mock_counter("missed")
        with Stream("mock_rsi/joint_states") as arm, Stream("physical/joint_states") as physical:
            self.client.execute(self.client.plan_to(GOAL, 0.0), arm)
            self.client.assert_at(GOAL, arm, physical)
            self.client.assert_within_limits(arm, missed)

    def test_to_a_pose(self):
        wanted = self.chain.forward(self.client.si(GOAL))
        pose = Pose(Point(*wanted.position), Quaternion(*rotation_to_quaternion(wanted.rotation)))
        answer = rospy.ServiceProxy("plan_to_pose", PlanToPose)(goal=PoseStamped(pose=pose), source="test")
        with Stream("mock_rsi/joint_states") as arm:
            q = self.client.execute(answer, arm)
        np.testing.assert_allclose(self.chain.forward(q).position, wanted.position, atol=1e-4)

    def test_along_a_line(self):
        start = self.chain.forward(self.client.si(HOME))
        end = start.position + np.array((0.0, 0.25, -0.1))
        pose = Pose(Point(*end), Quaternion(*rotation_to_quaternion(start.rotation)))
        service = rospy.ServiceProxy("plan_cartesian", PlanCartesian)
        answer = service(waypoints=[CartesianWaypoint(pose=pose)], speed=0.1, source="test")
        self.assertEqual(answer.fraction, 1.0, answer.message)
        with Stream("mock_rsi/joint_states") as arm:
            q = self.client.execute(answer, arm)
        np.testing.assert_allclose(self.chain.forward(q).position, end, atol=1e-4)


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "another_arm", AnotherArmTest, sys.argv)

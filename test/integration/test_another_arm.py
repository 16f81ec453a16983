#!/usr/bin/env python3
"""An arm that is not a KUKA, from its xacro: `new_arm`, the launch file it wrote, plans that are approved and reach the goal."""

import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
import rospkg
import rospy
import rostest
import tf2_ros
import yaml
from goal_client import goal_message, reach
from sensor_msgs.msg import JointState
from started import Started
from twin_client import RobotTest, Stream, TwinClient, wait

from construction_twin.kinematics.chain import Chain
from construction_twin.ros.commands import new_arm

#: In the robot's order, pan to wrist_3 [deg]. Where a person would rather have its home than where `new_arm` has put it.
HOME = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)
GOAL = (35.0, -75.0, 80.0, -20.0, 70.0, 40.0)
XACRO_ARGS = "finger_length=0.08"
#: Random poses for self_collision: the arm is simple.
SAMPLES = "3000"
#: Two cores run everything here: what starved real-time tasks add for a moment is not what this test is about.
PATIENT_MONITOR = """<launch>
  <rosparam ns="ur_like/pca_monitor">{lag_allowance: 0.2, lag_margin: 0.2, feedback_timeout: 0.3}</rosparam>
</launch>
"""


def make_arm(folder: Path) -> Path:
    """Write what `new_arm` writes for an arm in a foreign folder, fill in what a person would; return the launch file."""
    source = Path(rospkg.RosPack().get_path("construction_twin"), "test", "data", "ur_like_gripper.urdf.xacro")
    xacro = Path(shutil.copy(source, folder))
    made = folder / "made"
    common = ["--samples", SAMPLES]
    options = ["--tip", "tool0", "--xacro-args", XACRO_ARGS, "--full-speed-in", "0.5", "--output", str(made), *common]
    assert new_arm.main([str(xacro), *options]) == 0
    config = made / "ur_like.yaml"
    description = yaml.safe_load(config.read_text())
    # the gripper a little open, which changes the arm's shape: self_collision is made again
    description["other_joints"] = {"slide_left": 0.03}
    for joint, angle in zip(description["joints"].values(), HOME):
        joint["home_deg"] = angle
    config.write_text(yaml.safe_dump(description))
    pairs = made / "ur_like_self_collision.yaml"
    again = [str(xacro), str(config), str(pairs), "--robot-xacro-args", XACRO_ARGS, *common]
    new_arm.sample_pairs(again)
    return made / "ur_like.launch"


class AnotherArmTest(RobotTest):
    """Every test begins at rest at home. The last one, by its name, ends the launch."""

    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_another_arm")
        cls.folder = Path(tempfile.mkdtemp())
        cls.addClassCleanup(shutil.rmtree, cls.folder)
        launch, monitor = make_arm(cls.folder), cls.folder / "monitor.launch"
        monitor.write_text(PATIENT_MONITOR)
        given = [f"{name}:={rospy.get_param(f'~{name}')}" for name in ("broker_port", "rsi_port", "gateway_trace")]
        cls.launch = Started("roslaunch", str(launch), str(monitor), "gui:=marker", *given)
        cls.addClassCleanup(cls.launch.end)
        try:
            for service in ("plan_to_pose", "plan_cartesian"):
                rospy.wait_for_service(service, 60.0)
        except rospy.ROSException as error:
            raise AssertionError(f"{error}; the launch said: {cls.launch.said()[-2000:]}") from error
        cls.client = TwinClient()
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
                frame, there = f"ur_like/{tree}/{link}", tool.position + tool.rotation @ place
                wait(lambda frame=frame, there=there: np.allclose(self.place_of(frame), there, atol=1e-4), frame)

    def place_of(self, frame: str) -> tuple[float, ...]:
        """Return where tf has a frame in the world [m]."""
        found = self.tf.lookup_transform("world", frame, rospy.Time(0), rospy.Duration(20.0)).transform.translation
        return found.x, found.y, found.z

    def test_to_joints(self):
        missed = self.client.mock_counter("missed")
        with (
            Stream("mock_rsi/joint_states") as arm,
            Stream("physical/joint_states") as physical,
            Stream("velocities/joint_states") as twin,
            Stream("joint_states") as shown,
        ):
            self.client.execute(self.client.plan_to(GOAL, 0.0), arm)
            self.client.assert_at(GOAL, arm, physical)
            self.client.assert_within_limits(arm, missed)
            wait(lambda: not any(shown.messages[-1].velocity), "joint_states to be at rest")
        self.assert_velocities_are_the_motion_s(twin.messages)
        # joint_state_publisher passes them on
        self.assertGreater(max(np.abs(message.velocity).max() for message in shown.messages), 0.1)

    def assert_velocities_are_the_motion_s(self, messages) -> None:
        """Each message has the velocity by which its pose differs from the one before."""
        fastest = 0.0
        for before, after in zip(messages, messages[1:]):
            period = (after.header.stamp - before.header.stamp).to_sec()
            # one that is repeated, because no newer one has come, has moved nothing
            moved = np.subtract(after.position, before.position) / (period or 1.0)
            np.testing.assert_allclose(after.velocity, moved, atol=1e-6)
            fastest = max(fastest, float(np.abs(after.velocity).max()))
        self.assertGreater(fastest, 0.1)
        np.testing.assert_array_equal(messages[-1].velocity, 0.0)

    def test_by_a_goal_of_another_planner(self):
        names = list(self.client.robot.joint_names)[::-1]
        with Stream("physical/joint_states") as physical:
            reach(self.client, goal_message(names, [(3.0, self.client.si(GOAL)[::-1])]))
            self.client.assert_at(GOAL, physical)

    def test_when_all_is_ended_by_ctrl_c_nobody_warns(self):
        nodes = self.client.diagnosed_nodes()
        self.assertGreaterEqual(nodes, {"executor", "pca_monitor", "planner", "mqtt_bridge", "scene", "tool_marker"})
        said = self.launch.end()
        self.assertIn("done", said)
        for word in ("WARN", "ERROR", "FATAL", "Traceback", "Exception", "escalating"):
            self.assertNotIn(word, said)


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "another_arm", AnotherArmTest, sys.argv)

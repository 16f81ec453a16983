#!/usr/bin/env python3
"""Nothing moves without a person's approval, an approval covers one execution, `stop` brakes, a second commander is refused."""

import sys

import numpy as np
import rosnode
import rospy
import rostest
from sensor_msgs.msg import JointState
from twin_client import HOME, LEFT, RIGHT, RobotTest, Stream, case, wait

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.extensions import import_extension, node_modules
from construction_twin.core.units import radians

#: Cycles over which an arm that must not move is watched.
WATCH = 100


class ReviewTest(RobotTest):
    """Plans, verdicts and what the arm makes of them. Every test begins at rest at home."""

    def setUp(self):
        self.begin()
        self.client.go_to(HOME)

    def test_no_extension_is_there(self):
        """Whatever else these tests show, it holds without extensions: none of their nodes is one of ROS."""
        with self.assertRaisesRegex(ConfigurationError, "which this installation is without"):
            import_extension("planners.waypoint_file")
        of_extensions = {name for name, module in node_modules().items() if ".extensions." in module}
        running = {name.rpartition("/")[2] for name in rosnode.get_node_names()}
        self.assertFalse(of_extensions & running)
        self.assertIn("executor", running)

    def test_the_controller_has_the_cycle_of_the_launch_argument(self):
        self.client.wait_until_ready()
        shown = {pair.key: pair.value for pair in self.client.link.gateway_counters}
        self.assertEqual((shown["cycle_expected_ms"], shown["cycle_ipoc_step_ms"]), ("12", "12"))

    def test_plan_without_approval_moves_nothing(self):
        with Stream("mock_rsi/joint_states") as arm:
            plan = self.client.plan_to(RIGHT)
            arm.assert_still(WATCH)
            self.assertTrue(self.client.review(plan.plan_id, plan.plan_hash, approve=False).success)
            arm.assert_still(WATCH)
            self.assertFalse(self.client.review(plan.plan_id, plan.plan_hash).success, "a rejected plan was approved")
            arm.assert_still(WATCH)

    def test_approved_plan_is_executed_once(self):
        missed = self.client.mock_counter("missed")
        with (
            Stream("mock_rsi/joint_states") as arm,
            Stream("twin/joint_states") as twin,
            Stream("physical/joint_states") as physical,
        ):
            plan = self.client.start(LEFT)
            self.client.wait_for_outcome(plan.plan_id, "finished")
            self.client.assert_at(LEFT, twin, physical, arm)
            again = self.client.review(plan.plan_id, plan.plan_hash)
            self.assertFalse(again.success)
            self.assertIn("decided already", again.message)
            arm.assert_still(WATCH)
            self.client.assert_within_limits(arm, missed)
        self.client.assert_late_replies_were_late()
        self.client.wait_until_ready()

    def test_stop_brakes_within_limits(self):
        missed = self.client.mock_counter("missed")
        with Stream("mock_rsi/joint_states") as arm, Stream("twin/joint_states") as twin:
            plan = self.client.start(LEFT, duration=2.0)
            wait(lambda: arm.moved(5.0), "the arm to move")
            self.assertTrue(self.client.call("stop").success)
            self.client.wait_for_outcome(plan.plan_id, "stopped")
            wait(arm.at_rest, "the arm to rest")
            self.assertGreater(
                np.abs(arm.positions(-1)[0] - radians(LEFT)).max(), np.deg2rad(5.0), "it was not stopped early"
            )
            self.client.assert_within_limits(arm, missed)
            np.testing.assert_allclose(arm.positions(-1), twin.positions(-1), atol=1e-5)
        self.client.wait_until_ready()

    def test_second_commander_is_refused(self):
        far = JointState(name=self.client.robot.joint_names, position=radians(LEFT))
        for topic, nodes in {
            "next/joint_states": ("pca_monitor",),
            "command/joint_states": ("virtual_robot", "mqtt_bridge"),
        }.items():
            with case(topic), Stream("mock_rsi/joint_states") as arm, Stream("twin/joint_states") as twin:
                before = {node: self.refused(node) for node in nodes}
                publisher = rospy.Publisher(topic, JointState, queue_size=10)
                wait(lambda: publisher.get_num_connections() >= len(nodes), f"subscribers of {topic}")
                for node in nodes:
                    self.publish_until(publisher, far, lambda: self.refused(node) > before[node])
                arm.assert_still(WATCH)
                self.assertTrue(twin.at_rest())
                publisher.unregister()
        self.assertTrue(self.client.armed() and self.client.in_sync(), self.client.describe())

    def refused(self, node: str) -> int:
        """Messages of a second commander that a node has counted."""
        return int(self.client.diagnostics(node).get("refused publisher", 0))

    @staticmethod
    def publish_until(publisher: rospy.Publisher, message: JointState, counted):
        def publish_and_ask() -> bool:
            message.header.stamp = rospy.Time.now()
            publisher.publish(message)
            return counted()

        wait(publish_and_ask, "the second commander to be counted on /diagnostics", 5.0)


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "review", ReviewTest, sys.argv)

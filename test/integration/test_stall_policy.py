#!/usr/bin/env python3
"""A stalled joint under each policy that was set live: `resume` ends the approved path, `stop` waits for a person's reset."""

import sys

import rospy
import rostest
from construction_twin.msg import Execution, Sync, Transition
from dynamic_reconfigure.client import Client
from twin_client import HOME, LEFT, RIGHT, RobotTest, Stream, TwinClient, wait

JOINT = "joint_a3"


class StallPolicyTest(RobotTest):
    """One stall per test, each in the middle of a motion that a person approved."""

    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_stall_policy")
        cls.client = TwinClient()
        cls.transitions: list[Transition] = []
        rospy.Subscriber("transitions", Transition, cls.transitions.append)
        cls.live = Client("pca_monitor/live", timeout=30.0)

    def setUp(self):
        # a busy machine's late feedback is not what is tested here
        self.live.update_configuration({"policy": "replan", "feedback_timeout": 2.0, "escalate_count": 100})
        self.begin()
        self.client.go_to(HOME)
        self.transitions.clear()

    def stall_in_motion(self, goal) -> str:
        """Approve a motion and block a joint in the middle of it; return the plan's id."""
        with Stream("mock_rsi/joint_states") as arm:
            plan = self.client.start(goal, duration=3.0)
            wait(lambda: arm.moved(5.0), "the arm to move")
            self.client.stall(JOINT, True)
        self.client.wait(lambda: self.events("pose_differs"), "the gate to hold")
        return plan.plan_id

    def events(self, name: str) -> list[Transition]:
        return [change for change in self.transitions if change.event == name]

    def test_resume_goes_on_along_the_approved_path(self):
        self.live.update_configuration({"policy": "resume"})
        plans = len(self.client.plans)
        with Stream("twin/joint_states") as twin, Stream("physical/joint_states") as physical:
            plan = self.stall_in_motion(LEFT)
            self.client.wait(lambda: self.client.execution.state == Execution.HELD, "the executor to hold the plan")
            self.client.stall(JOINT, False)
            self.client.wait_for_outcome(plan, "finished")
            self.client.assert_at(LEFT, twin, physical)
        self.assertEqual(len(self.client.plans), plans + 1, "nobody asked for another plan")
        self.assertEqual([change.to_text for change in self.transitions], ["HOLDING", "IN_SYNC"])

    def test_stop_waits_for_a_reset(self):
        self.live.update_configuration({"policy": "stop"})
        self.stall_in_motion(RIGHT)
        self.client.wait(lambda: self.client.sync.state == Sync.STOPPED, "the state STOPPED")
        self.assertEqual([change.event for change in self.transitions], ["pose_differs", "policy_stop"])
        self.client.stall(JOINT, False)
        with Stream("twin/joint_states") as twin:
            twin.wait_for_more(250)
            self.assertTrue(twin.at_rest(250))
        self.assertEqual(self.client.sync.text, "STOPPED")
        answer = self.client.call("reset")
        self.assertTrue(answer.success, answer.message)
        self.client.wait_until_ready()
        self.assertEqual([change.event for change in self.transitions][2:4], ["new_session", "opened"])

    def test_thresholds_are_live_and_nonsense_is_refused(self):
        name = f"threshold_{JOINT}"
        self.live.update_configuration({name: 0.02, "agree_time": 0.2})
        index = list(self.client.sync.name).index(JOINT)
        self.client.wait(lambda: self.client.sync.threshold[index] == 0.02, "the threshold of one joint to change")
        self.assertEqual([limit for i, limit in enumerate(self.client.sync.threshold) if i != index], [0.01] * 5)
        held = self.live.update_configuration({"policy": "hope"})
        self.assertEqual((held["policy"], held[name]), ("replan", 0.02))
        self.client.wait(
            lambda: self.client.diagnostics("pca_monitor").get("refused live_setting") == "1",
            "the refusal to be counted",
        )
        self.live.update_configuration({name: 0.01, "agree_time": 0.1})


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "stall_policy", StallPolicyTest, sys.argv)

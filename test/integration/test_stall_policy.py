#!/usr/bin/env python3
"""A stalled joint under each policy that was set at rest: `resume` ends the approved path, `stop` waits for a person's reset."""

import sys

import rospy
import rostest
from construction_twin.msg import Execution, Sync, Transition
from construction_twin.srv import ConfigureGate
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
        rospy.wait_for_service("configure_gate", 30.0)
        cls.gate = rospy.ServiceProxy("configure_gate", ConfigureGate)

    def setUp(self):
        # a busy machine's late feedback is not what is tested here
        self.begin()
        self.client.go_to(HOME)
        self.configure("{policy: replan, feedback_timeout: 2.0, escalate_count: 100}")
        self.transitions.clear()

    def configure(self, settings: str):
        """Change settings as soon as the gate has seen the arm at rest; its transition may come after the answer."""
        before = len(self.events("configured"))
        self.client.wait(lambda: self.gate(settings, "tester").success, f"the gate to take {settings}")
        self.client.wait(lambda: len(self.events("configured")) > before, "the transition of the change")

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
        self.configure("{policy: resume}")
        self.transitions.clear()
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
        self.configure("{policy: stop}")
        self.transitions.clear()
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


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "stall_policy", StallPolicyTest, sys.argv)

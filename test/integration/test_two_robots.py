#!/usr/bin/env python3
"""Two arms at once: both move, and neither enters the other's path."""

import sys
import unittest

import numpy as np
import rospy
import rostest
import tf2_ros
import yaml
from construction_twin.msg import Conflict, Execution, Plan, Sync
from construction_twin.srv import PlanToJoints, ReviewPlan
from std_srvs.srv import Trigger
from twin_client import BOUND, wait

from construction_twin.core.units import radians
from construction_twin.ros.shared.params import robot_from_parameters
from construction_twin.ros.transport.latest_pose import LatestPose

ONE, TWO = "kr120_1", "kr120_2"
HOME = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)
#: Turned away from the other arm; stretched out into the space between them. A1 turns clockwise.
AWAY = {ONE: (60.0, -75.0, 70.0, 20.0, 75.0, 30.0), TWO: (-60.0, -75.0, 70.0, 20.0, 75.0, 30.0)}
BETWEEN = {ONE: (-60.0, -50.0, 50.0, 0.0, 90.0, 0.0), TWO: (60.0, -50.0, 50.0, 0.0, 90.0, 0.0)}
#: Behind where the other arm is then.
BEYOND = (100.0, -50.0, 50.0, 0.0, 90.0, 0.0)
DURATION = 3.0


class Arm:
    """One of the robots, by absolute names."""

    def __init__(self, name: str):
        self.name = name
        self.robot = robot_from_parameters(f"/{name}/")
        self.newest: dict[type, object] = {}
        self.verdicts: dict[str, Conflict] = {}
        self.outcomes: dict[str, str] = {}
        for topic, kind in (("sync", Sync), ("plan", Plan)):
            rospy.Subscriber(f"/{name}/{topic}", kind, lambda message, kind=kind: self.newest.update({kind: message}))
        rospy.Subscriber(f"/{name}/execution", Execution, self._on_execution)
        rospy.Subscriber(f"/{name}/conflict", Conflict, lambda found: self.verdicts.update({found.plan_id: found}))

    def _on_execution(self, message: Execution) -> None:
        self.newest[Execution] = message
        if message.outcome:
            self.outcomes[message.plan_id] = f"{message.outcome}: {message.reason}"

    def state(self, kind: type) -> str:
        return self.newest[kind].text if kind in self.newest else "unknown"

    def describe(self) -> str:
        known = {kind.__name__: (m.text, m.reason) for kind, m in self.newest.items() if hasattr(m, "reason")}
        return f"{self.name}: {known}"

    def wait(self, condition, what: str, timeout: float = 30.0) -> None:
        try:
            wait(condition, f"{what} of {self.name}", timeout)
        except AssertionError as error:
            raise AssertionError(f"{error}; {self.describe()}; {self.verdicts}") from None

    def wait_until_ready(self) -> None:
        ready = ("IN_SYNC", "IDLE")
        self.wait(lambda: (self.state(Sync), self.state(Execution)) == ready, "sync IN_SYNC, execution IDLE", 60.0)

    def plan(self, goal_deg, duration: float = DURATION):
        rospy.wait_for_service(f"/{self.name}/plan_to_joints", 20.0)
        service = rospy.ServiceProxy(f"/{self.name}/plan_to_joints", PlanToJoints)
        return service(goal=radians(goal_deg), duration=duration, source="test")

    def plan_well(self, goal_deg, duration: float = DURATION):
        answer = self.plan(goal_deg, duration)
        assert answer.success, answer.message
        # the watch has compared it, and the executor has the plan soon
        self.wait(lambda: answer.plan_id in self.verdicts, "a verdict of the watch")
        return answer

    def approve(self, plan):
        """Approve; repeated only while plan and verdict have not reached the executor."""
        service = rospy.ServiceProxy(f"/{self.name}/review_plan", ReviewPlan)
        answers = []

        def answered() -> bool:
            answers.append(service(plan.plan_id, plan.plan_hash, True, "tester", "integration test", False, "", ""))
            not_yet = ("is not under review", "not checked against", "is being compared")
            return answers[-1].success or not any(text in answers[-1].message for text in not_yet)

        self.wait(answered, "the executor to know the plan", 5.0)
        return answers[-1]

    def start(self, goal_deg, duration: float = DURATION):
        plan = self.plan_well(goal_deg, duration)
        answer = self.approve(plan)
        assert answer.success, answer.message
        return plan

    def finish(self, plan, outcome: str = "finished") -> None:
        self.wait(lambda: plan.plan_id in self.outcomes, f"the end of plan {plan.plan_id}")
        found = self.outcomes[plan.plan_id]
        assert found.startswith(outcome), f"{self.name}: {found}; {self.describe()}"

    def go(self, goal_deg) -> None:
        self.finish(self.start(goal_deg))
        self.wait_until_ready()

    def settle(self) -> None:
        """Come to rest at home, whatever a part of the test that failed has left."""
        if self.state(Execution) not in ("unknown", "IDLE") or self.state(Sync) in ("HOLDING", "REPLANNING", "STOPPED"):
            answer = rospy.ServiceProxy(f"/{self.name}/stop", Trigger)()
            assert answer.success, f"stop of {self.name}: {answer.message}"
        self.wait_until_ready()
        twin = LatestPose(f"/{self.name}/twin/joint_states", self.robot.joint_names, print)
        try:
            away = np.abs(np.subtract(twin.pose(0.5, 5.0), radians(HOME))).max()
        finally:
            twin.close()
        if away > BOUND:
            self.go(HOME)


class TwoRobotsTest(unittest.TestCase):
    """One story in the order of its parts; each begins and ends with both arms at home."""

    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_two_robots")
        cls.one, cls.two = Arm(ONE), Arm(TWO)

    def setUp(self):
        for arm in (self.one, self.two):
            arm.settle()

    def test_0_one_tf_tree(self):
        buffer = tf2_ros.Buffer()
        self.addCleanup(tf2_ros.TransformListener(buffer).unregister)
        for name in (ONE, TWO):
            tool = f"{name}/twin/tool0"
            wait(lambda tool=tool: buffer.can_transform("world", tool, rospy.Time(0)), f"{tool} in the world")

        def parents() -> dict[str, str]:
            frames = yaml.safe_load(buffer.all_frames_as_yaml())
            return {name: frame["parent"] for name, frame in frames.items()}

        def roots() -> set[str]:
            known = parents()
            return set(known.values()) - set(known)

        # parts of a tree arrive one after the other
        wait(lambda: roots() == {"world"}, "one tree")
        self.assertEqual({name.split("/")[0] for name in parents()}, {ONE, TWO})

    def test_1_both_move_at_once(self):
        arms = self.one, self.two
        twins = [LatestPose(f"/{arm.name}/twin/joint_states", arm.robot.joint_names, print) for arm in arms]
        for twin in twins:
            self.addCleanup(twin.close)
        plans = [arm.plan_well(AWAY[arm.name]) for arm in arms]
        for arm, plan in zip(arms, plans):
            answer = arm.approve(plan)
            self.assertTrue(answer.success, answer.message)
        for arm, plan, twin in zip(arms, plans, twins):
            arm.finish(plan)
            arm.wait_until_ready()
            np.testing.assert_array_less(np.abs(np.subtract(twin.pose(0.5, 5.0), radians(AWAY[arm.name]))), BOUND)
        for arm in arms:
            arm.go(HOME)

    def test_2_a_plan_into_the_other_arm_is_refused_and_one_past_it_goes_around(self):
        self.one.go(BETWEEN[ONE])
        refused = self.two.plan((BETWEEN[TWO][0] - 5.0, *BETWEEN[TWO][1:]))
        self.assertFalse(refused.success)
        self.assertIn(f"{ONE}/", refused.message)
        around = self.two.plan_well(BEYOND, 0.0)
        self.two.wait(lambda: self.two.newest[Plan].id == around.plan_id, "the plan itself")
        made = self.two.newest[Plan]
        self.assertNotEqual(made.planner, "direct")
        self.assertGreaterEqual(made.clearance, 0.0)
        self.assertFalse(self.two.verdicts[around.plan_id].conflict, self.two.verdicts[around.plan_id].reason)
        self.one.go(HOME)

    def conflict(self, plan_id: str) -> bool:
        return self.two.verdicts[plan_id].conflict

    def test_3_of_two_plans_that_meet_only_the_first_runs(self):
        later = self.two.plan_well(BETWEEN[TWO])
        first = self.one.start(BETWEEN[ONE], 4.0)
        self.two.wait(lambda: self.conflict(later.plan_id), "a conflict")
        answer = self.two.approve(later)
        self.assertFalse(answer.success)
        self.assertIn(ONE, answer.message)
        self.assertIn("may not start", answer.message)
        self.one.finish(first)
        self.one.go(HOME)


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "two_robots", TwoRobotsTest, sys.argv)

#!/usr/bin/env python3
"""Work plans from end to end, without a tool: segment by segment in the scenes that were approved; engaged, and the way back."""

import sys
from dataclasses import replace

import numpy as np
import pinocchio
import rospy
import rostest
from construction_twin.msg import Execution, Scene, WorkSegment
from construction_twin.srv import EditScene, PlanToJoints, PlanWork
from std_srvs.srv import Trigger
from twin_client import HOME, LEFT, RIGHT, RobotTest, Stream, wait

from construction_twin.kinematics.chain import Chain
from construction_twin.planning.pipeline import PACE
from construction_twin.planning.timing import time_path
from construction_twin.robot.executed_path import WAY_BACK_TOLERANCE, nearest_on_lines
from construction_twin.ros.messages.convert import plan_from_msg, trajectory_to_msg
from construction_twin.ros.messages.scene_convert import object_to_msg
from construction_twin.scene.objects import SceneObject, product

#: Hangs on the tool while it is carried.
HELD = SceneObject("beam/0", "box", (0.1, 0.1, 0.6), (0.0, 0.0, 0.5), link="tool0")


def standing(chain: Chain, q) -> SceneObject:
    """Return the beam as it stands where the tool grips it, or lets it go."""
    pose = product(chain.forward(q), HELD.pose)
    quaternion = pinocchio.Quaternion(pose.rotation).normalized().coeffs()
    return replace(HELD, position=tuple(pose.position.tolist()), quaternion=tuple(quaternion.tolist()), link="")


class WorkPlanTest(RobotTest):
    """Every test begins at rest at home, with the beam in its stock."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        chain = Chain(cls.client.robot)
        cls.stock, cls.built = (standing(chain, cls.client.si(pose)) for pose in (RIGHT, HOME))
        cls.executions: list[Execution] = []
        cls.scenes: list[Scene] = []
        rospy.Subscriber("execution", Execution, cls.executions.append)
        rospy.Subscriber("scene", Scene, cls.scenes.append)
        for service in ("plan_work", "plan_way_back", "edit_scene", "review_plan"):
            rospy.wait_for_service(service, 40.0)

    def setUp(self):
        self.begin()
        self.edit([self.stock])
        self.client.go_to(HOME)
        self.executions.clear()

    def edit(self, put, after: str = "") -> None:
        answer = rospy.ServiceProxy("edit_scene", EditScene)(put=list(map(object_to_msg, put)), after=after)
        self.assertTrue(answer.success, answer.message)
        wait(lambda: self.scenes and self.scenes[-1].hash == answer.hash, "the scene after the edit")

    def segment(self, name: str, begin, end, put=(), **fields) -> WorkSegment:
        path = np.array([self.client.si(begin), self.client.si(end)])
        motion = trajectory_to_msg(time_path(path, self.client.robot, speed_scale=0.4))
        return WorkSegment(name=name, trajectory=motion, put=list(map(object_to_msg, put)), **fields)

    def task(self) -> list[WorkSegment]:
        return [
            self.segment("fetch", HOME, RIGHT, [HELD]),
            self.segment("carry", RIGHT, LEFT, engaged=True),
            self.segment("set down", LEFT, HOME, [self.built]),
        ]

    def approved(self):
        """Return a work plan that was just approved, once the planner has the present scene."""
        answers = []

        def planned() -> bool:
            answers.append(rospy.ServiceProxy("plan_work", PlanWork)("task-1", "test", self.task()))
            self.assertTrue(answers[-1].success, answers[-1].message)
            wait(lambda: self.client.plans and self.client.plans[-1].id == answers[-1].plan_id, "the plan on its topic")
            return self.client.plans[-1].scene == self.scenes[-1].hash

        self.client.wait(planned, "a plan in the present scene")
        plan = plan_from_msg(self.client.plans[-1])
        self.client.approve(plan)
        return plan

    def change_the_scene(self, put) -> str:
        """Wait until the executor wants another scene, and make it, as the node `work` does; return its hash."""
        wait(lambda: self.client.execution.wants_scene, "the executor to want the scene to change", 40.0)
        expected = self.client.execution.expected_scene
        self.edit(put, expected)
        # or the next change would be asked for by a report from before this one
        wait(lambda: self.client.execution.expected_scene != expected, "the executor to have the changed scene")
        return expected

    def refusal(self) -> str:
        """Return why no other motion is planned, once the planner has heard that the arm is engaged."""
        plan, answers = rospy.ServiceProxy("plan_to_joints", PlanToJoints), []

        def refused() -> bool:
            answers.append(plan(goal=self.client.si(HOME)))
            return not answers[-1].success

        wait(refused, "the planner to hear that the arm is engaged")
        return answers[-1].message

    def test_a_task_is_executed_segment_by_segment_in_the_approved_scenes(self):
        with Stream("twin/joint_states") as twin, Stream("mock_rsi/joint_states") as arm:
            plan = self.approved()
            self.assertEqual(self.change_the_scene([HELD]), plan.segments[0].scene_after)
            self.assertEqual(self.change_the_scene([self.built]), plan.segments[2].scene_after)
            self.client.wait_for_outcome(plan.id, "finished", 60.0)
            self.client.assert_at(HOME, twin, arm)
            self.client.assert_no_jump(twin)
        names = [report.segment_name for report in self.executions if report.plan_id == plan.id]
        self.assertEqual([name for name in dict.fromkeys(names) if name], ["fetch", "carry", "set down"])
        self.assertFalse(self.client.execution.engaged)

    def test_after_a_stop_while_engaged_only_the_way_back_is_possible(self):
        plan = self.approved()
        with Stream("twin/joint_states") as twin:
            self.change_the_scene([HELD])
            right, left = np.array(self.client.si(RIGHT)), np.array(self.client.si(LEFT))
            half = 0.5 * (right + left)
            wait(lambda: twin.positions(-1)[0][0] > half[0], "the arm to be half way", 30.0)
            self.assertTrue(self.client.call("stop").success)
            self.client.wait_for_outcome(plan.id, "stopped", 20.0)
            wait(lambda: self.client.execution.engaged, "the executor to say that the arm is engaged")
            refused = self.refusal()
            self.assertIn("left in 'carry' of task task-1", refused)
            self.assertIn("only the way back", refused)
            self.client.wait_until_ready()
            answer = rospy.ServiceProxy("plan_way_back", Trigger)()
            self.assertTrue(answer.success, answer.message)
            wait(lambda: self.client.plans[-1].planner == "way back", "the way back on the topic")
            back = plan_from_msg(self.client.plans[-1])
            self.assertEqual((back.task, back.segments[0].engaged), ("task-1", True))
            since = len(twin.messages)
            self.client.approve(back)
            self.client.wait_for_outcome(back.id, "finished", 1.0 / PACE * plan.trajectory.duration + 20.0)
            way = plan.trajectory.sample_many(np.arange(plan.segments[0].end, plan.segments[1].end, 0.002))[0]
            off = max(float(nearest_on_lines(way[:-1], way[1:], q)[1].min()) for q in twin.positions(since)[::20])
            self.assertLess(off, WAY_BACK_TOLERANCE + 1e-5)
            self.client.assert_at(RIGHT, twin)
        wait(lambda: not self.client.execution.engaged, "the arm to be free")
        self.client.wait_until_ready()
        self.client.go_to(HOME)


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "test_work_plan", WorkPlanTest, sys.argv)

#!/usr/bin/env python3
"""The action FollowJointTrajectory: planned, reviewed, executed, cancelled, rejected, replaced; clients that vanish."""

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import actionlib
import numpy as np
import rospy
import rostest
from actionlib_msgs.msg import GoalID, GoalStatus
from construction_twin.msg import Link, Review, Sync
from control_msgs.msg import (
    FollowJointTrajectoryAction,
    FollowJointTrajectoryActionFeedback,
    FollowJointTrajectoryActionResult,
    FollowJointTrajectoryResult,
)
from goal_client import goal_message
from twin_client import RobotTest, Stream, wait

ACTION = "follow_joint_trajectory"
#: A motion of this much on these joints [rad], in this time [s].
WAY = (0.17, 0.05, -0.1, 0.2, -0.1, 0.2)
DURATION = 1.5
Result = FollowJointTrajectoryResult
#: How far the clock of another PC is ahead [s], and where its planner goes [deg].
AHEAD = 10.0
NEAR, ASIDE = (12.0, -85.0, 85.0, 0.0, 80.0, 10.0), (-12.0, -85.0, 85.0, 0.0, 80.0, 10.0)


class MoveItHandle:
    """What moveit_simple_controller_manager does with a controller of type FollowJointTrajectory, call by call."""

    def __init__(self, name: str, action_ns: str):
        self.states, self.actives, self.feedbacks = [], 0, []
        self.last_execution, self.done = "SUCCEEDED", True
        self.client = actionlib.SimpleActionClient(
            f"{name}/{action_ns}" if action_ns else name, FollowJointTrajectoryAction
        )
        assert any(self.client.wait_for_server(rospy.Duration(15.0 / 3)) for _ in range(3))

    def send_trajectory(self, goal) -> None:
        """Send a trajectory as the controller handle does."""
        self.done, self.last_execution = False, "RUNNING"
        self.client.send_goal(goal, done_cb=self._done, active_cb=self._active, feedback_cb=self.feedbacks.append)

    def wait_for_execution(self, timeout: float = 0.0) -> bool:
        """Wait for the result, for ever with a time of 0."""
        return self.done or self.client.wait_for_result(rospy.Duration(timeout))

    def cancel_execution(self) -> None:
        """Cancel what was sent last."""
        if not self.done:
            self.client.cancel_goal()
            self.last_execution, self.done = "PREEMPTED", True

    def _active(self) -> None:
        self.actives += 1

    def _done(self, state, result) -> None:
        self.states.append((state, result))
        names = {GoalStatus.SUCCEEDED: "SUCCEEDED", GoalStatus.ABORTED: "ABORTED", GoalStatus.PREEMPTED: "PREEMPTED"}
        self.last_execution, self.done = names.get(state, "FAILED"), True


class FollowJointTrajectoryTest(RobotTest):
    """One bringup, one goal after the other."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.joints = list(cls.client.robot.joint_names)
        cls.action = actionlib.SimpleActionClient(ACTION, FollowJointTrajectoryAction)
        assert cls.action.wait_for_server(rospy.Duration(40.0))
        cls.reviews: list[Review] = []
        cls.feedbacks: list[FollowJointTrajectoryActionFeedback] = []
        cls.results: list[FollowJointTrajectoryActionResult] = []
        rospy.Subscriber(f"{ACTION}/result", FollowJointTrajectoryActionResult, cls.results.append)
        rospy.Subscriber("review", Review, cls.reviews.append)
        rospy.Subscriber(f"{ACTION}/feedback", FollowJointTrajectoryActionFeedback, cls.feedbacks.append)

    def setUp(self):
        self.begin()
        self.feedbacks.clear()
        with Stream("twin/joint_states") as twin:
            self.client.wait(lambda: twin.at_rest(5), "the twin to rest")
            self.pose = twin.positions(-1)[0]

    # -- goals

    def goal(self, way=WAY, duration: float = DURATION, start=None):
        """Return a goal from the present pose to somewhere [rad], in the robot's order of joints."""
        start = self.pose if start is None else start
        self.target = np.add(start, way)
        return goal_message(self.joints, [(0.0, start), (duration, self.target)])

    def back(self):
        """Return a goal that leads near where the last one began."""
        return self.goal(np.negative(WAY))

    def waiting(self, status, count: int):
        """Wait until a new plan waits for a person, and the client has been told; return the plan."""
        self.client.wait(lambda: len(self.client.plans) > count, "a plan")
        plan = self.client.plans[-1]
        wait(lambda: f"plan {plan.id} of" in status(), f"the status to name plan {plan.id}, it is {status()!r}")
        return plan

    def send(self, goal, action=None):
        """Send a goal; return its plan, which waits for a person."""
        count = len(self.client.plans)
        (action or self.action).send_goal(goal)
        return self.waiting(self.action.get_goal_status_text, count)

    def approve(self, plan):
        """Approve a plan and wait until it moves."""
        self.client.approve(plan)
        self.client.wait(lambda: self.client.execution.plan_id == plan.id, "the plan to be played")

    def assert_result(self, state: int, code: int, *words: str, action=None):
        """Wait for the result."""
        action = action or self.action
        self.assertTrue(action.wait_for_result(rospy.Duration(20.0)), action.get_goal_status_text())
        result = action.get_result()
        self.assertEqual((action.get_state(), result.error_code), (state, code), result.error_string)
        for each in words:
            self.assertIn(each, result.error_string)
        self.assertEqual(action.get_goal_status_text(), result.error_string)

    # -- tests

    def test_1_the_calls_of_moveit_lead_to_the_goal(self):
        handle = MoveItHandle("/kr120", ACTION)
        goal = self.goal()
        # MoveIt stamps its trajectories, by a clock that need not be ours, and has an order of its own
        goal.trajectory.header.stamp = rospy.Time.now() - rospy.Duration(10.0)
        goal.trajectory.joint_names.reverse()
        for point in goal.trajectory.points:
            point.positions = list(point.positions)[::-1]
        count = len(self.client.plans)
        handle.send_trajectory(goal)
        plan = self.waiting(handle.client.get_goal_status_text, count)
        self.assertEqual(plan.source, f"{ACTION} from {rospy.get_name()}")
        text = handle.client.get_goal_status_text()
        self.assertIn("waits for approval; a person gives or refuses it by /kr120/review_plan", text)
        self.client.wait(lambda: handle.feedbacks, "a feedback while it waits")
        self.assertEqual((handle.done, handle.last_execution, handle.actives), (False, "RUNNING", 1))
        self.approve(plan)
        self.assertTrue(handle.wait_for_execution())
        wait(lambda: handle.done, "the handle's callback")
        (state, result), *more = handle.states
        self.assertEqual((handle.last_execution, result.error_code, more), ("SUCCEEDED", Result.SUCCESSFUL, []))
        self.assertEqual(state, GoalStatus.SUCCEEDED)
        with Stream("physical/joint_states") as arm:
            self.client.wait(lambda: arm.at_rest(25), "the arm to rest")
            np.testing.assert_allclose(arm.positions(-1)[0], self.target, atol=1e-4)
        self.assert_feedback(handle.feedbacks, plan)

    def assert_feedback(self, feedbacks, plan):
        """The feedback has the goal's order of joints, and follows the plan at 50 Hz."""
        self.assertTrue(all(each.joint_names == self.joints[::-1] for each in feedbacks))
        moving = [each for each in feedbacks if each.desired.time_from_start > rospy.Duration(0.1)]
        self.assertGreater(len(moving), 0.5 * 50 * plan.duration)
        for each in moving:
            error = np.subtract(each.actual.positions, each.desired.positions)
            np.testing.assert_allclose(each.error.positions, error, atol=1e-12)
            self.assertLess(np.abs(error).max(), 0.05)
        speeds = np.abs([each.desired.velocities for each in moving]).max(axis=0)
        np.testing.assert_allclose(speeds, 1.875 * np.abs(WAY[::-1]) / DURATION, rtol=0.1)
        np.testing.assert_allclose(moving[-1].actual.positions, self.target[::-1], atol=0.01)

    def test_4_a_cancel_under_review_withdraws_the_plan(self):
        # MoveIt's accelerations jump: the same points in times of our own
        goal = self.goal()
        for point, acceleration in zip(goal.trajectory.points, (0.2, -0.2)):
            point.velocities, point.accelerations = [0.0] * len(WAY), [acceleration] * len(WAY)
        goal.trajectory.points[-1].time_from_start = rospy.Duration(0.2)
        plan = self.send(goal)
        self.assertIn("s instead of 0.200 s waits", self.action.get_goal_status_text())
        self.action.cancel_goal()
        self.assert_result(GoalStatus.PREEMPTED, Result.GOAL_TOLERANCE_VIOLATED, "cancelled by its client")
        answer = self.client.review(plan.id, plan.hash)
        self.assertFalse(answer.success)
        self.assertIn("was decided already or withdrawn", answer.message)
        self.client.wait(lambda: self.verdict_on(plan.id), f"the verdict on plan {plan.id}")
        self.assertEqual(self.verdict_on(plan.id).reviewer, f"client {rospy.get_name()}")

    def verdict_on(self, plan_id: str) -> Review | None:
        """Return the verdict on a plan; None while it has not been heard."""
        return next((review for review in reversed(self.reviews) if review.plan_id == plan_id), None)

    def test_5_a_cancel_while_moving_brakes_on_the_path(self):
        handle = MoveItHandle("joint_trajectory_action", "")
        with Stream("twin/joint_states") as twin:
            count = len(self.client.plans)
            handle.send_trajectory(self.back())
            plan = self.waiting(handle.client.get_goal_status_text, count)
            self.approve(plan)
            self.client.wait(lambda: twin.moved(2.0), "the twin to move")
            handle.cancel_execution()
            self.assertEqual(handle.last_execution, "PREEMPTED")
            wait(lambda: handle.states, "the result")
            self.client.wait_for_outcome(plan.id, "stopped")
            reached = twin.positions(-1)[0]
            # it has stood still when the client hears of it, on the line from start to goal
            self.client.wait(lambda: twin.at_rest(25), "the twin to rest")
            np.testing.assert_array_equal(twin.positions(-1)[0], reached)
        way = self.target - self.pose
        fraction = (reached - self.pose) / way
        self.assertTrue(0.05 < fraction[0] < 0.98, fraction)
        np.testing.assert_allclose(fraction, fraction[0], atol=1e-3)
        ((state, result),) = handle.states
        self.assertEqual((state, result.error_code), (GoalStatus.PREEMPTED, Result.GOAL_TOLERANCE_VIOLATED))
        self.assertTrue(result.error_string.startswith("cancelled by its client; the arm is at rest on its path"))

    def test_6_others_are_turned_away_and_the_same_client_replaces_its_goal(self):
        first = self.send(self.goal())
        other = self.other_client("stranger", self.goal())
        answer = json.loads(other.communicate(timeout=20.0)[0])
        self.assertEqual((answer["state"], answer["code"]), (GoalStatus.REJECTED, Result.INVALID_GOAL))
        self.assertIn(f"{rospy.get_name()} has the arm", answer["sentence"])
        with Stream("twin/joint_states") as twin:
            self.approve(first)
            self.client.wait(lambda: twin.moved(2.0), "the twin to move")
            replacing = actionlib.SimpleActionClient("joint_trajectory_action", FollowJointTrajectoryAction)
            replacing.wait_for_server()
            count = len(self.client.plans)
            replacing.send_goal(goal_message(self.joints, [(2.0, self.pose)]))
            words = "replaced by a newer goal; the arm is at rest on its path"
            self.assert_result(GoalStatus.PREEMPTED, Result.GOAL_TOLERANCE_VIOLATED, words)
            self.client.wait_for_outcome(first.id, "stopped")
            # it leads from where the arm came to rest, and is reviewed like any other
            plan = self.waiting(replacing.get_goal_status_text, count)
            self.assertTrue(twin.at_rest(5))
            np.testing.assert_array_equal(plan.trajectory.points[0].positions, twin.positions(-1)[0])
            self.approve(plan)
            self.assert_result(GoalStatus.SUCCEEDED, Result.SUCCESSFUL, action=replacing)

    def other_client(self, name: str, goal) -> subprocess.Popen:
        """Start a client of another name with a goal."""
        points = [
            [point.time_from_start.to_sec(), list(map(float, point.positions))] for point in goal.trajectory.points
        ]
        text = json.dumps({"joints": goal.trajectory.joint_names, "points": points})
        program = Path(__file__).parent / "goal_client.py"
        process = subprocess.Popen(
            [sys.executable, str(program), name, rospy.resolve_name(ACTION), text], stdout=subprocess.PIPE, text=True
        )
        self.addCleanup(process.stdout.close)
        self.addCleanup(process.wait)
        self.addCleanup(process.kill)
        return process

    def test_6_b_a_goal_that_is_repeated_at_10_hz_takes_the_plan_under_review_over(self):
        goal, count = self.goal(), len(self.client.plans)
        self.results.clear()
        timer = rospy.Timer(rospy.Duration(0.1), lambda _: self.action.send_goal(goal))
        self.client.wait(lambda: len(self.results) >= 25, "25 goals to be replaced")
        timer.shutdown()
        timer.join()
        plan = self.waiting(self.action.get_goal_status_text, count)
        self.assertEqual([each.id for each in self.client.plans[count:]], [plan.id])
        ends = {(each.status.status, each.result.error_string) for each in self.results}
        self.assertLessEqual({state for state, _ in ends}, {GoalStatus.PREEMPTED, GoalStatus.RECALLED})
        self.assertEqual({sentence for _, sentence in ends}, {"replaced by a newer goal"})
        self.approve(plan)
        self.assert_result(GoalStatus.SUCCEEDED, Result.SUCCESSFUL)
        self.client.wait_until_ready()

    def test_8_a_client_that_the_launch_file_trusts_needs_no_person(self):
        process = self.other_client("trusted", self.goal())
        answer = json.loads(process.communicate(timeout=30.0)[0])
        self.assertEqual(
            (answer["state"], answer["code"]), (GoalStatus.SUCCEEDED, Result.SUCCESSFUL), answer["sentence"]
        )
        verdict = next(review for review in reversed(self.reviews) if review.approved)
        self.assertEqual(verdict.reviewer, "auto_approve")
        self.assertIn("auto_approve_sources names /kr120/trusted", verdict.reason)

    # -- a planner on another PC, whose clock is ahead

    def reaching(self, folder: str, goal_deg, duration: float) -> subprocess.Popen:
        """Start matlab/reaching_task.py, what a person at MATLAB does, with a wall clock that is ahead."""
        library = f"{folder}/wall_clock.so"
        source = Path(__file__).with_name("wall_clock.c")
        subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", library, str(source)], check=True)
        words = ["--namespace", "/kr120", "--duration", f"{duration}", "--count", f"{int(20 * duration)}"]
        words += ["--output", folder, "--patience", "60", "--goal", *map(str, goal_deg)]
        program = Path(__file__).parents[2] / "matlab" / "reaching_task.py"
        process = subprocess.Popen(
            [sys.executable, str(program), *words],
            env=os.environ | {"LD_PRELOAD": library, "WALL_CLOCK_AHEAD": f"{AHEAD:g}"},
            stdout=subprocess.PIPE,
            text=True,
        )
        self.addCleanup(process.stdout.close)
        self.addCleanup(process.wait)
        self.addCleanup(process.kill)
        return process

    def test_9_a_planner_whose_clock_is_ahead_is_judged_by_its_content(self):
        # somebody whose clock is an hour ahead cancelled all goals up to his time; actionlib would drop what comes until then
        cancel = rospy.Publisher(f"{ACTION}/cancel", GoalID, queue_size=1)
        wait(cancel.get_num_connections, "the action's server")
        cancel.publish(GoalID(stamp=rospy.Time.now() + rospy.Duration(3600.0)))
        count, began = len(self.client.plans), time.time()
        with tempfile.TemporaryDirectory() as folder:
            process = self.reaching(folder, NEAR, 4.0)
            self.client.wait(lambda: len(self.client.plans) > count, "a plan", 40.0)
            plan = self.client.plans[-1]
            self.assertEqual((plan.source, plan.duration), (f"{ACTION} from /kr120/matlab", 4.0))
            # the plan's stamp is this PC's; the times in it are from its start, as they were sent
            self.assertTrue(began < plan.header.stamp.to_sec() < time.time())
            motion = np.loadtxt(f"{folder}/motion.csv", delimiter=",")
            points = plan.trajectory.points
            np.testing.assert_array_equal([point.positions for point in points[1:]], motion[1:, 1:7])
            np.testing.assert_allclose([point.time_from_start.to_sec() for point in points], motion[:, 0], atol=1e-9)
            self.approve(plan)
            output, _ = process.communicate(timeout=60.0)
            self.assertEqual(process.returncode, 0, output)
            sent = float(re.search(r"at (\S+) by this PC's clock", output)[1])
            self.assertAlmostEqual(sent - AHEAD, plan.header.stamp.to_sec(), delta=3.0)
            for name in ("virtual", "physical"):
                table = np.loadtxt(f"{folder}/{name}.csv", delimiter=",")
                # stamps are this PC's, and the arm really was where the plan says
                self.assertTrue(began < table[-1, 0] < time.time())
                np.testing.assert_allclose(table[-1, 1:], self.client.si(NEAR), atol=1e-4)

    def test_9_b_a_planner_that_vanishes_in_the_middle_of_a_motion_changes_nothing(self):
        count, syncs, links = len(self.client.plans), len(self.client.syncs), len(self.client.links)
        with tempfile.TemporaryDirectory() as folder:
            process = self.reaching(folder, ASIDE, 6.0)
            self.client.wait(lambda: len(self.client.plans) > count, "a plan", 40.0)
            plan = self.client.plans[-1]
            self.approve(plan)
            # as with a cut line: it reads nothing any more, and nobody is told
            process.send_signal(signal.SIGSTOP)
            self.client.wait_for_outcome(plan.id, "finished", 30.0)
            process.kill()
        self.client.wait_until_ready()
        self.assertTrue(all(sync.state == Sync.IN_SYNC for sync in self.client.syncs[syncs:]), self.client.describe())
        self.assertTrue(all(link.state == Link.ARMED for link in self.client.links[links:]), self.client.describe())


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "follow_joint_trajectory", FollowJointTrajectoryTest, sys.argv)

#!/usr/bin/env python3
"""A stalled joint: the gate holds, the twin waits, states and transitions say so; after the release a re-plan ends at the goal."""

import json
import sys

import numpy as np
import rospy
import rostest
from construction_twin.msg import Sync, Transition
from twin_client import LEFT, RobotTest, Stream, wait

from construction_twin.core.units import axis_name, radians
from construction_twin.ros.shared.params import robot_file

JOINT = "joint_a3"


class StallTest(RobotTest):
    """One stall in the middle of one motion."""

    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.transitions: list[Transition] = []
        rospy.Subscriber("transitions", Transition, cls.transitions.append)

    def setUp(self):
        self.begin()

    def test_stalled_joint_holds_replans_and_finishes(self):
        with (
            Stream("mock_rsi/joint_states") as arm,
            Stream("twin/joint_states") as twin,
            Stream("physical/joint_states") as physical,
        ):
            plan = self.client.start(LEFT, duration=3.0)
            wait(lambda: arm.moved(5.0), "the arm to move")
            self.client.stall(JOINT, True)
            # from here on: the blow with which a blocked joint stops is the fault itself
            with Stream("mock_rsi/joint_states") as blocked_arm:
                missed = self.client.mock_counter("missed")
                replan = self.assert_holds(plan, twin)
                held = self.client.sync.held_stamp
                self.client.stall(JOINT, False)
                self.assert_finishes(replan, twin)
                self.client.assert_at(LEFT, twin, physical, arm)
                self.client.assert_within_limits(blocked_arm, missed)
        self.client.wait_until_ready()
        self.assertEqual([sync.text for sync in self.client.syncs][-3:], ["IN_SYNC", "REPLANNING", "IN_SYNC"])
        self.assert_reported(held)

    def assert_finishes(self, replan, twin: Stream):
        """Released, the arm catches up; the re-plan is executed after a person's review (without: unit/chain/test_scenarios.py)."""
        self.client.wait(self.client.in_sync, "the poses to agree again")
        twin.assert_still()
        self.assertTrue(self.client.idle(), self.client.describe())
        self.client.approve(replan)
        self.client.wait_for_outcome(replan.id, "finished")

    def assert_holds(self, plan, twin: Stream):
        """The gate holds, the plan is dropped, the twin stands still, a re-plan to the same goal lies there. Returns it."""
        client = self.client
        client.wait(lambda: client.sync.state == Sync.REPLANNING, "the gate to hold")
        client.wait_for_outcome(plan.plan_id, "held")
        # setpoints that passed the gate before it closed may still be under way
        wait(lambda: twin.at_rest(3), "the twin to wait")
        twin.assert_still()
        self.assertEqual((client.sync.text, client.sync.policy), ("REPLANNING", "replan"))
        client.wait(lambda: len(client.plans) > 1, "a re-plan")
        replan = client.plans[-1]
        self.assertEqual(len(client.plans), 2, "it is asked for once")
        self.assertIn("re-plan", replan.source)
        np.testing.assert_allclose(replan.trajectory.points[0].positions, twin.positions(-1)[0], atol=1e-9)
        np.testing.assert_allclose(replan.trajectory.points[-1].positions, radians(LEFT), atol=1e-9)
        return replan

    def assert_reported(self, held):
        """Every change of state is on the topic, in the log and on /diagnostics, with reason, values and the held setpoint."""
        closing = next(i for i, change in enumerate(self.transitions) if change.event == "pose_differs")
        changes = self.transitions[closing:]
        states = [(change.from_text, change.event, change.to_text) for change in changes]
        self.assertEqual(
            states,
            [
                ("IN_SYNC", "pose_differs", "HOLDING"),
                ("HOLDING", "replan_asked", "REPLANNING"),
                ("REPLANNING", "opened", "IN_SYNC"),
            ],
        )
        first = changes[0]
        self.assertIn(f"{axis_name(JOINT)} differs by", first.reason)
        index = list(first.name).index(JOINT)
        self.assertGreater(first.error[index], first.threshold[index])
        # nobody has told the gate how the servos answer: it says so, and compares with the twin alone
        self.assertIn("none: ", self.client.diagnostics("pca_monitor")["servo model"])
        self.assertEqual(first.held_stamp, held)
        path = robot_file(rospy.get_param("pca_monitor/transition_file"), rospy.get_param("robot/name"))
        stamps = [change.header.stamp.to_nsec() for change in changes]

        def recorded() -> list:
            lines = map(json.loads, path.read_text().splitlines())
            return [(line["from"], line["event"], line["to"]) for line in lines if line["time_ns"] in stamps]

        wait(lambda: recorded() == states, f"these transitions in {path}")
        wait(
            lambda: first.reason in self.client.diagnostics("pca_monitor").get("transition 3", ""),
            "the transitions on /diagnostics",
        )


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "stall", StallTest, sys.argv)

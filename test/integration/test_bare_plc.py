#!/usr/bin/env python3
"""A bare PLC: armed by a person's name, a plan executed, halted in mid-motion, and what is not checked is recorded."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import rospy
import rostest
from construction_twin.msg import Feedback, Link
from construction_twin.srv import ActAsSeen
from twin_client import HOME, LEFT, RobotTest, Stream, wait

from construction_twin.link.supervisor import NOT_CHECKED


class BarePlcTest(RobotTest):
    """One PLC, a person named Ada, another named Grace."""

    def arm(self, name: str):
        """Arm by name as soon as the arm rests, then wait until a plan could be approved."""
        answers = []

        def armed() -> bool:
            answers.append(self.asked_to_arm(name))
            return answers[-1].success

        self.client.wait(armed, f"an armed PLC ({answers[-1:]})", 40.0)
        self.assertIn(f"{name} is responsible for what is not checked: configuration, ", answers[-1].message)
        self.client.wait_until_ready()

    def asked_to_arm(self, name: str):
        rospy.wait_for_service("mqtt_bridge/act_as_seen", 40.0)
        return rospy.ServiceProxy("mqtt_bridge/act_as_seen", ActAsSeen)(act="arm", person=name)

    def test_a_person_arms_by_name_plans_are_executed_and_a_halt_stops(self):
        client = self.client
        client.wait(
            lambda: client.link and client.link.state == Link.NEEDS_RESET, "a PLC that waits for a person", 60.0
        )
        self.assertIn("twin arm --responsible NAME", client.link.reason)
        self.refused_without_a_name()
        self.arm("Ada")
        self.assertEqual((client.link.gateway_kind, client.link.responsible), ("plc", "Ada"))
        self.assertEqual(tuple(client.link.not_checked), NOT_CHECKED)
        self.assertEqual(client.sync.comparison, "instant")
        self.assertEqual(rospy.wait_for_message("physical/feedback", Feedback, 5.0).command_stamp.to_nsec(), 0)
        with Stream("physical/joint_states") as physical, Stream("twin/joint_states") as twin:
            plan = client.start(LEFT)
            client.wait_for_outcome(plan.plan_id, "finished")
            client.assert_at(LEFT, twin, physical)
            self.halted_in_mid_motion(physical)
        self.arm("Grace")
        client.go_to(HOME)
        self.recorded(plan.plan_id)

    def refused_without_a_name(self):
        command = ["rosrun", "construction_twin", "twin", "--robot", "kr120", "arm"]
        run = subprocess.run(command, capture_output=True, text=True, timeout=60)
        self.assertEqual(run.returncode, 2)
        self.assertIn("arm needs --responsible NAME", run.stderr)
        answer = self.asked_to_arm("  ")
        self.assertFalse(answer.success)
        self.assertIn("is armed in a person's name", answer.message)
        answer = self.client.call("reset")
        self.assertFalse(answer.success)
        self.assertIn("cannot reset a bare PLC without a name", answer.message)
        self.assertEqual(self.client.link.state, Link.NEEDS_RESET)

    def halted_in_mid_motion(self, physical: Stream):
        """The strings end, the PLC brakes on silence, and only a person's name goes on."""
        client = self.client
        plan = client.start(HOME, duration=3.0)
        left = physical.positions(-1)[0]
        wait(lambda: np.abs(physical.positions(-1)[0] - left).max() > np.deg2rad(5.0), "the arm to move")
        answer = client.call("halt")
        self.assertTrue(answer.success)
        self.assertIn("brakes on silence", answer.message)
        client.wait(lambda: client.link.state == Link.NEEDS_RESET, "the link to wait for a person")
        client.wait_for_outcome(plan.plan_id, "dropped")
        client.wait(physical.at_rest, "the arm to rest")
        self.assertGreater(np.abs(physical.positions(-1)[0] - client.si(HOME)).max(), np.deg2rad(3.0))
        self.assertEqual(client.link.responsible, "")

    def recorded(self, plan_id: str):
        path = Path(rospy.get_param("~review_file"))
        lines = [json.loads(line) for line in path.read_text().splitlines()]
        verdict = next(line for line in lines if line.get("plan") == plan_id and line["record"] == "verdict")
        self.assertEqual((verdict["responsible"], tuple(verdict["not_checked"])), ("Ada", NOT_CHECKED))
        armed = [line["responsible"] for line in lines if line["record"] == "responsibility"]
        self.assertEqual((armed[0], armed[-1]), ("Ada", "Grace"))


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "bare_plc", BarePlcTest, sys.argv)

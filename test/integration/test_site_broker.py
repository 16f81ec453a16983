#!/usr/bin/env python3
"""The whole system on a site's broker: TLS, an account for each program, a person at a tablet, and a planner elsewhere."""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import unittest
from pathlib import Path

import rospy
import rostest
from remote_planner import RemotePlanner
from tablet import Tablet
from twin_client import HOME, LEFT, Stream, TwinClient, wait

from construction_twin.broker.make_site import main as make_site
from construction_twin.mqtt.messages import Control, Topics

PORT = 18860
TOPICS = Topics("twin", "kr120")


class SiteTest(unittest.TestCase):
    """Bringup with a site's accounts."""

    @classmethod
    def setUpClass(cls):
        cls.folder = Path(tempfile.mkdtemp())
        cls.addClassCleanup(shutil.rmtree, cls.folder)
        site = cls.folder / "site"
        arguments = ["--host", "localhost", "--robot", "kr120", "--port", str(PORT), "--listen", "127.0.0.1"]
        assert make_site([str(site), *arguments, "--person", "ada:operate", "--person", "anna:operate,approve"]) == 0
        command = ["roslaunch", "construction_twin", "bringup.launch", f"accounts:={site}/accounts",
                   "broker_host:=localhost", f"broker_port:={PORT}", "rsi_port:=49260"]  # fmt: skip
        cls.output: list[str] = []
        # the test's own namespace is not bringup's
        outside = {name: value for name, value in os.environ.items() if name != "ROS_NAMESPACE"}
        launch = subprocess.Popen(
            command, env=outside, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
        )
        threading.Thread(target=lambda: cls.output.extend(launch.stdout), daemon=True).start()
        cls.addClassCleanup(cls._end, launch)
        try:
            wait(lambda: rospy.has_param("gateway/decimals"), "bringup's parameters", 60.0)
        except AssertionError as error:
            raise AssertionError(f"{error}\n{''.join(cls.output)[-3000:]}") from None
        rospy.init_node("test_site")
        cls.client = TwinClient()
        cls.tablet = Tablet(site / "accounts/anna/account.json", PORT, TOPICS)
        cls.addClassCleanup(cls.tablet.client.disconnect)
        cls.planner = RemotePlanner(site / "accounts/ada/account.json", PORT, TOPICS)
        cls.addClassCleanup(cls.planner.client.disconnect)

    @staticmethod
    def _end(launch: subprocess.Popen) -> None:
        launch.send_signal(signal.SIGINT)
        launch.wait(30.0)

    def setUp(self):
        try:
            self.client.wait_until_ready()
        except AssertionError as error:
            self.fail(f"{error}\n{''.join(self.output)[-3000:]}")
        wait(self.tablet.client.is_connected, "the tablet's connection")
        wait(self.sees_all, "a view with everything in it")
        rospy.wait_for_service("plan_trajectory", 20.0)

    def sees_all(self) -> bool:
        """Return whether the planner elsewhere sees the whole robot, at rest and ready."""
        view = self.planner.views[-1] if self.planner.views else {}
        states = [(view.get(part) or {}).get("state") for part in ("link", "sync", "execution")]
        return states == ["ARMED", "IN_SYNC", "IDLE"] and bool(view["twin"] and view["arm"])

    def test_a_motion_planned_elsewhere_is_reviewed_and_executed(self):
        goal = tuple(0.5 * (a + b) for a, b in zip(HOME, LEFT))
        with Stream("physical/joint_states") as arm, Stream("twin/joint_states") as twin:
            still = arm.positions()
            answer = self.planner.send(self.planner.motion(goal, source="facade 7", speed_scale=0.3))
            self.assertTrue(answer["ok"], answer)
            wait(lambda: (self.tablet.plan or {}).get("id") == answer["plan_id"], "the plan at the tablet")
            plan = self.tablet.plan
            self.assertEqual(plan["hash"], answer["plan_hash"])
            self.assertEqual(plan["source"], "MQTT account ada, which says it is 'facade 7'")
            self.assertTrue((arm.positions() == still[0]).all(), "the arm moved before anybody had approved")
            seen = len(self.planner.views)
            self.assertTrue(self.tablet.verdict(plan, "approved")["ok"])
            self.client.wait_for_outcome(answer["plan_id"], "finished")
            self.client.assert_at(goal, twin, arm)
            wait(
                lambda: self.planner.views[-1]["execution"]["outcome"] == "finished" and self.sees_all(),
                "the end in view",
            )
            last = self.planner.views[-1]
            for name, stream in (("twin", twin), ("arm", arm)):
                self.assertEqual(last[name]["positions"], [round(float(value), 9) for value in stream.positions()[-1]])
        self.check_views([view for view in self.planner.views[seen:] if view["online"]], answer["plan_id"])

    def check_views(self, views: list[dict], plan_id: str) -> None:
        """Check what was seen of a plan that was approved and executed."""
        self.assertEqual({view["retained"] for view in views}, {False})
        self.assertEqual([view["seq"] for view in views], [views[0]["seq"] + k for k in range(len(views))])
        # how far apart they are is in test_view_period.py: here it depends on the machine
        stamps = [view["stamp"] for view in views]
        self.assertTrue(all(a < b for a, b in zip(stamps, stamps[1:])), stamps)
        moving = [view for view in views if view["execution"]["state"] == "PLAYING"]
        self.assertEqual({view["execution"]["plan_id"] for view in moving}, {plan_id})
        progress = [view["execution"]["progress"] for view in moving]
        self.assertEqual(progress, sorted(progress))
        self.assertTrue(0.0 <= progress[0] < 0.2 and progress[-1] > 0.8, (progress[0], progress[-1]))
        self.assertEqual(views[-1]["execution"]["progress"], 1.0)
        # where it was seen while it moved, it had been: the twin's age is told
        self.assertTrue(all(view["twin"]["age"] < 0.25 for view in moving))

    def test_a_stop_by_topic_mid_motion_brakes_the_arm_and_names_who(self):
        self.client.go_to(HOME)
        with Stream("physical/joint_states") as arm:
            planned = self.client.plan_to(LEFT)
            wait(lambda: (self.tablet.plan or {}).get("id") == planned.plan_id, "the plan at the tablet")
            still = arm.positions()[-1]
            self.assertTrue(self.tablet.verdict(self.tablet.plan, "approved")["ok"])
            wait(lambda: abs(arm.positions()[-1] - still).max() > 0.02, "motion")
            answer = self.tablet.stop()
            self.assertTrue(answer["ok"], answer)
            self.assertEqual(answer["account"], "anna")
            # by the executor, or by the gate that closes when the gateway brakes: whichever is first
            wait(lambda: self.client.execution.outcome in ("stopped", "held", "dropped"), "the end of the plan")
            wait(lambda: not self.client.armed(), "the end of the session")
            wait(lambda: self.client.link.gateway_state == "holding", "the arm at rest")
            arm.wait_for_more(100)
            last = arm.positions()[-100:]
            self.assertTrue((last == last[0]).all(), "the arm moves on after the stop")
        self.assertIn("anna", self.client.link.reason)
        self.assertEqual(self.client.gateway_counters()["stop_by"], "anna")
        # the right to stop is no right to go on: the reset is the bridge's
        for verb in ("reset", "arm", "speed_limit"):
            control = Control("1", "any", verb, 1.0).to_json()
            self.assertFalse(self.tablet.may_publish(TOPICS.control, control), verb)
        self.assertFalse(self.client.armed())
        self.client.start_over()


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "site", SiteTest, sys.argv)

#!/usr/bin/env python3
"""The whole system on a site's broker: TLS, an account for each program, a person at a tablet, and a planner elsewhere."""

import json
import shutil
import sys
import tempfile
import unittest
import uuid
from pathlib import Path

import numpy as np
import rospy
import rostest
from mqtt_listener import MqttListener
from started import Started
from twin_client import HOME, LEFT, Stream, TwinClient, wait

from construction_twin.broker.make_site import main as make_site
from construction_twin.mqtt.client import Broker, load_account
from construction_twin.mqtt.messages import Control, Topics
from construction_twin.mqtt.requests import REVIEW, TRAJECTORY

PORT = 18860
TOPICS = Topics("twin", "kr120")


class SiteTest(unittest.TestCase):
    """Bringup with a site's accounts."""

    @classmethod
    def setUpClass(cls):
        folder = Path(tempfile.mkdtemp())
        cls.addClassCleanup(shutil.rmtree, folder)
        site = folder / "site"
        arguments = ["--host", "localhost", "--robot", "kr120", "--port", str(PORT), "--listen", "127.0.0.1"]
        assert make_site([str(site), *arguments, "--person", "ada:operate", "--person", "anna:operate,approve"]) == 0
        words = (f"accounts:={site}/accounts", "broker_host:=localhost", f"broker_port:={PORT}", "rsi_port:=49260")
        cls.launch = Started("roslaunch", "construction_twin", "bringup.launch", *words)
        cls.addClassCleanup(cls.launch.end)
        try:
            wait(lambda: rospy.has_param("gateway/decimals"), "bringup's parameters", 60.0)
        except AssertionError as error:
            raise AssertionError(f"{error}\n{cls.launch.said()[-3000:]}") from None
        rospy.init_node("test_site")
        cls.client = TwinClient()

        def at_the_broker(person: str, *topics: str) -> MqttListener:
            account = load_account(site / f"accounts/{person}/account.json")
            listener = MqttListener(Broker("localhost", PORT, account=account), *topics)
            cls.addClassCleanup(listener.close)
            return listener

        #: A reviewer, and a program that plans elsewhere.
        cls.tablet = at_the_broker("anna", TOPICS.plan, TOPICS.view, TOPICS.ack_of(REVIEW), TOPICS.stop_ack)
        cls.planner = at_the_broker("ada", TOPICS.view, TOPICS.ack_of(TRAJECTORY))

    def setUp(self):
        try:
            self.client.wait_until_ready()
        except AssertionError as error:
            self.fail(f"{error}\n{self.launch.said()[-3000:]}")
        wait(self.tablet.client.is_connected, "the tablet's connection")
        wait(self.sees_all, "a view with everything in it")
        rospy.wait_for_service("plan_trajectory", 20.0)

    @property
    def view(self) -> dict:
        """The newest view."""
        return self.planner.newest(TOPICS.view)

    def motion_to(self, goal_deg: tuple[float, ...]) -> dict:
        """Return a motion from where the twin is seen to be, as a program sends it that plans elsewhere."""
        start = np.rad2deg(self.view["twin"]["positions"]).tolist()
        return {
            "id": uuid.uuid4().hex,
            "units": {"angle": "deg", "length": "mm", "time": "s"},
            "joint_names": self.view["joints"]["names"],
            "points": [{"positions": start}, {"positions": goal_deg}],
            "source": "facade 7",
            "speed_scale": 0.3,
        }

    def approve(self, plan: dict) -> None:
        """Approve a plan at the tablet, with the moment of what it shows."""
        asked = {"plan_id": plan["id"], "plan_hash": plan["hash"], "verdict": "approved"}
        asked["moment"] = self.tablet.newest(TOPICS.view)["moment"]
        self.assertTrue(self.tablet.ask(TOPICS.of(REVIEW, "anna"), asked, TOPICS.ack_of(REVIEW))["ok"])

    def sees_all(self) -> bool:
        """Return whether the planner elsewhere sees the whole robot, at rest and ready."""
        view = self.view
        states = [(view.get(part) or {}).get("state") for part in ("link", "sync", "execution")]
        return states == ["ARMED", "IN_SYNC", "IDLE"] and bool(view["twin"] and view["arm"])

    def test_a_motion_planned_elsewhere_is_reviewed_and_executed(self):
        goal = tuple(0.5 * (a + b) for a, b in zip(HOME, LEFT))
        with Stream("physical/joint_states") as arm, Stream("twin/joint_states") as twin:
            still = arm.positions()
            answer = self.planner.ask(TOPICS.of(TRAJECTORY, "ada"), self.motion_to(goal), TOPICS.ack_of(TRAJECTORY))
            self.assertTrue(answer["ok"], answer)
            wait(lambda: self.tablet.newest(TOPICS.plan).get("id") == answer["plan_id"], "the plan at the tablet")
            plan = self.tablet.newest(TOPICS.plan)
            self.assertEqual(plan["hash"], answer["plan_hash"])
            self.assertEqual(plan["source"], "MQTT account ada, which says it is 'facade 7'")
            self.assertTrue((arm.positions() == still[0]).all(), "the arm moved before anybody had approved")
            seen = len(self.planner.heard[TOPICS.view])
            self.approve(plan)
            self.client.wait_for_outcome(answer["plan_id"], "finished")
            self.client.assert_at(goal, twin, arm)
            wait(lambda: self.sees_all() and self.view["execution"]["outcome"] == "finished", "the end in view")
            last = self.view
            for name, stream in (("twin", twin), ("arm", arm)):
                self.assertEqual(last[name]["positions"], [round(float(value), 9) for value in stream.positions()[-1]])
        self.assertEqual({message.retain for message in self.planner.heard[TOPICS.view][seen:]}, {False})
        views = self.planner.documents(TOPICS.view)[seen:]
        self.check_views([view for view in views if view["online"]], answer["plan_id"])

    def check_views(self, views: list[dict], plan_id: str) -> None:
        """Check what was seen of a plan that was approved and executed."""
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
            wait(lambda: self.tablet.newest(TOPICS.plan).get("id") == planned.plan_id, "the plan at the tablet")
            still = arm.positions()[-1]
            self.approve(self.tablet.newest(TOPICS.plan))
            wait(lambda: abs(arm.positions()[-1] - still).max() > 0.02, "motion")
            self.tablet.publish(TOPICS.stop_by("anna"), json.dumps({"id": "s"}))
            stopped = {"id": "s", "by": "gateway", "ok": True, "account": "anna"}.items()
            wait(lambda: any(stopped <= a.items() for a in self.tablet.documents(TOPICS.stop_ack)), "the answer")
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
            self.assertFalse(self.tablet.publish(TOPICS.control, control), verb)
        self.assertFalse(self.client.armed())
        self.client.start_over()


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "site", SiteTest, sys.argv)

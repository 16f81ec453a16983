#!/usr/bin/env python3
"""`plan` and `review` over MQTT: the real node, the site's broker and a tablet's account; the test plays planner and executor."""

import functools
import json
import shutil
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import rospy
import rostest
from construction_twin.msg import Link, Plan, Review
from construction_twin.srv import (
    ResumeFromScreen,
    ResumeFromScreenResponse,
    ReviewFromScreen,
    ReviewFromScreenResponse,
)
from diagnostic_msgs.msg import DiagnosticArray
from std_srvs.srv import Trigger, TriggerResponse
from tablet import Tablet
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from twin_client import wait

from construction_twin.broker.make_site import main as make_site
from construction_twin.core.freshness import parse_moment, staleness
from construction_twin.mqtt.account import load_account
from construction_twin.mqtt.client import Broker, make_client, unique_id
from construction_twin.mqtt.messages import Topics
from construction_twin.ros.shared.robot_clock import present

PORT = 18846
TOPICS = Topics("twin", "kr120")
ACCOUNT = "kr120-reviewer-anna"


class MqttReviewTest(unittest.TestCase):
    @classmethod
    def setUpClass(cls):
        rospy.init_node("test_mqtt_review")
        cls.requests, cls.accept = [], True
        cls.folder = Path(tempfile.mkdtemp())
        cls.addClassCleanup(shutil.rmtree, cls.folder)
        arguments = ["--host", "localhost", "--robot", "kr120", "--port", str(PORT), "--listen", "127.0.0.1"]
        assert make_site([str(cls.folder / "site"), *arguments, "--reviewer", "anna"]) == 0
        cls.plans = rospy.Publisher("plan", Plan, queue_size=5, latch=True)
        cls.verdicts = rospy.Publisher("review", Review, queue_size=5, latch=True)
        cls.links = rospy.Publisher("link", Link, queue_size=5, latch=True)
        cls.service = rospy.Service("review_from_screen", ReviewFromScreen, cls._on_review)
        cls.pressed, cls.triggers = [], []
        for name in ("stop", "pause"):
            cls.triggers.append(rospy.Service(name, Trigger, functools.partial(cls._on_trigger, name)))
        cls.triggers.append(rospy.Service("resume_from_screen", ResumeFromScreen, cls._on_resume))
        cls.programs = {}
        # planner, executor and bridge are played by this node
        rospy.set_param("publishers", dict.fromkeys(("plan", "review", "link"), rospy.get_name()))
        cls._start("broker", "--config", str(cls.folder / "site/broker/mosquitto.conf"))
        account = cls.folder / "site/accounts/kr120-bridge/account.json"
        for name, value in (("host", "localhost"), ("port", PORT), ("account", str(account))):
            rospy.set_param(f"mqtt_review/{name}", value)
        cls._start("mqtt_review", f"__ns:={rospy.get_namespace().rstrip('/')}")
        cls.tablet = Tablet(cls.folder / "site/accounts/kr120-reviewer-anna/account.json", PORT, TOPICS)
        cls.addClassCleanup(cls.tablet.client.disconnect)
        wait(cls.tablet.client.is_connected, "the tablet's connection")
        wait(lambda: cls.plans.get_num_connections() and cls.verdicts.get_num_connections(), "mqtt_review")

    @classmethod
    def _start(cls, name: str, *arguments: str) -> None:
        # the relay itself, not rosrun: a signal must reach the program
        relay = Path(sys.prefix).parent / "catkin/devel/lib/construction_twin" / name
        cls.programs[name] = program = subprocess.Popen([str(relay), *arguments])
        cls.addClassCleanup(cls._end, program)

    @staticmethod
    def _end(program: subprocess.Popen) -> None:
        program.terminate()
        program.wait(15.0)

    @classmethod
    def _on_review(cls, request):
        cls.requests.append(request)
        if not cls.accept:
            return ReviewFromScreenResponse(False, "not now", False)
        cls.verdicts.publish(Review(plan_id=request.plan_id, approved=request.approve, reviewer=request.reviewer))
        return ReviewFromScreenResponse(True, "taken", False)

    @classmethod
    def _on_resume(cls, request):
        cls.pressed.append("resume")
        fresh = not staleness(parse_moment(request.moment), present())
        return ResumeFromScreenResponse(cls.accept and fresh, "resume: as the executor says", not fresh)

    @classmethod
    def _on_trigger(cls, name: str, _request):
        cls.pressed.append(name)
        return TriggerResponse(cls.accept, f"{name}: as the executor says")

    def setUp(self):
        type(self).accept = True
        self.requests.clear()
        self.pressed.clear()

    def offer(self, name: str) -> dict:
        """Publish a plan; return what the tablet sees of it."""
        points = [JointTrajectoryPoint(positions=[0.1 * k] * 6) for k in range(3)]
        names = [f"joint_a{k}" for k in range(1, 7)]
        self.plans.publish(
            Plan(
                asked="c0ffee00-7",
                id=name,
                hash=f"hash of {name}",
                trajectory=JointTrajectory(joint_names=names, points=points),
            )
        )
        wait(lambda: (self.tablet.plan or {}).get("id") == name, f"plan {name} on MQTT")
        return self.tablet.plan

    def wait_until_cleared(self):
        wait(lambda: self.tablet.plan is None, "the plan taken away")

    def refused(self, reason: str) -> int:
        """Return a counter of `/diagnostics`, as it is from now on."""
        messages = []
        subscriber = rospy.Subscriber("/diagnostics", DiagnosticArray, messages.append)

        def values():
            found = [s for m in messages for s in m.status if "mqtt_review" in s.name]
            return {value.key: value.value for value in found[-1].values} if len(found) > 1 else None

        wait(lambda: values() is not None, "diagnostics of mqtt_review")
        subscriber.unregister()
        return int(values().get(f"refused {reason}", 0))

    def test_approval_reaches_review_plan_and_the_plan_goes(self):
        plan = self.offer("approve me")
        self.assertEqual(plan["goal"], [0.2] * 6)
        answer = self.tablet.verdict(plan, "approved", reason="looks fine")
        self.assertEqual((answer["ok"], answer["plan_id"], answer["reason"]), (True, "approve me", "taken"))
        request = self.requests[-1]
        self.assertEqual((request.plan_id, request.plan_hash), ("approve me", "hash of approve me"))
        self.assertEqual((request.approve, request.reviewer, request.reason), (True, ACCOUNT, "by MQTT: looks fine"))
        self.assertEqual((answer["account"], answer["reviewer"]), (ACCOUNT, ACCOUNT))
        self.wait_until_cleared()

    def test_the_name_on_record_is_the_account_s_whatever_the_tablet_claims(self):
        self.assertTrue(self.tablet.verdict(self.offer("claimed"), "approved", reviewer="kr120-reviewer-bert")["ok"])
        request = self.requests[-1]
        self.assertEqual(request.reviewer, ACCOUNT)
        self.assertEqual(request.reason, "by MQTT, which says it is 'kr120-reviewer-bert'")
        self.wait_until_cleared()

    def test_no_verdict_comes_in_another_one_s_name_or_in_none(self):
        plan = self.offer("not in my name")
        verdict = {"plan_id": plan["id"], "plan_hash": plan["hash"], "verdict": "approved", "reviewer": "Anna"}
        payload = json.dumps(verdict).encode()
        for topic in (TOPICS.review, TOPICS.review_by("kr120-reviewer"), TOPICS.review_by("kr120-bridge")):
            self.assertFalse(self.tablet.may_publish(topic, payload), topic)
        # what the broker took behind them has been carried out, so nothing of the others was
        self.assertFalse(self.tablet.answer(b"{}")["ok"])
        self.assertEqual((self.requests, self.tablet.plan["id"]), ([], "not in my name"))

    def test_stop_pause_and_resume_reach_the_executor_and_are_answered(self):
        for verb in ("stop", "pause", "resume"):
            answer = self.tablet.press(verb)
            said = {"account": ACCOUNT, "ok": True, "reason": f"{verb}: as the executor says", "by": "executor"}
            self.assertEqual(answer, said | {"id": answer["id"], "expired": False})
        type(self).accept = False
        self.assertFalse(self.tablet.press("resume")["ok"])
        self.assertEqual(self.pressed, ["stop", "pause", "resume", "resume"])

    def test_what_is_no_press_or_came_before_reaches_nobody_and_is_counted(self):
        before = {name: self.refused(name) for name in ("pause", "repeated")}
        mine = TOPICS.pause_by(ACCOUNT)
        for payload in (b"", b"pause", b'{"id": 1}', b'{"id": "1", "account": "x"}'):
            self.assertTrue(self.tablet.may_publish(mine, payload))
        again = json.dumps({"id": "the same", "moment": str(present())}).encode()
        for _ in range(3):
            self.assertTrue(self.tablet.may_publish(TOPICS.resume_by(ACCOUNT), again))
        wait(lambda: self.refused("repeated") == before["repeated"] + 2, "the counter of repeated resumes")
        self.assertEqual(self.refused("pause"), before["pause"] + 4)
        self.assertEqual(self.pressed, ["resume"])

    def test_rejection_reaches_review_plan(self):
        answer = self.tablet.verdict(self.offer("reject me"), "rejected")
        self.assertTrue(answer["ok"])
        self.assertFalse(self.requests[-1].approve)
        self.wait_until_cleared()

    def test_refusal_of_review_plan_is_told_and_the_plan_stays(self):
        type(self).accept = False
        answer = self.tablet.verdict(self.offer("not now"), "approved")
        self.assertEqual((answer["ok"], answer["reason"]), (False, "not now"))
        self.assertEqual(self.tablet.plan["id"], "not now")

    def test_bad_verdicts_reach_nobody_and_are_counted(self):
        plan = self.offer("guarded")
        before = self.refused("review"), self.refused("retained")
        verdict = {"plan_id": plan["id"], "plan_hash": plan["hash"], "verdict": "approved"}
        bad = [
            b"",
            b"approved",
            json.dumps(verdict | {"plan_hash": ""}).encode(),
            json.dumps(verdict).encode() + b" " * 5000,
        ]
        for payload in bad:
            self.assertFalse(self.tablet.answer(payload)["ok"])
        retained = self.tablet.answer(json.dumps(verdict).encode(), retain=True)
        self.assertIn("retain", retained["reason"])
        self.tablet.client.publish(TOPICS.review_by(ACCOUNT), b"", qos=1, retain=True)
        self.assertEqual(self.requests, [])
        self.assertEqual(self.tablet.plan["id"], "guarded")
        # the empty retained message that takes the stored one away is refused too
        wait(lambda: self.refused("retained") >= before[1] + 2, "the counter of retained verdicts")
        self.assertEqual(self.refused("review"), before[0] + len(bad))

    def test_verdict_given_elsewhere_and_new_session_take_the_plan_away(self):
        self.offer("decided at the desk")
        self.verdicts.publish(Review(plan_id="decided at the desk", approved=True))
        self.wait_until_cleared()
        self.links.publish(Link(session="one"))
        self.offer("void")
        self.links.publish(Link(session="two"))
        self.wait_until_cleared()

    def test_plan_of_a_killed_node_goes_and_comes_back_with_it(self):
        self.offer("outlives the node")
        self.programs["mqtt_review"].kill()
        self.programs["mqtt_review"].wait(10.0)
        self.wait_until_cleared()
        self._start("mqtt_review", f"__ns:={rospy.get_namespace().rstrip('/')}")
        wait(lambda: (self.tablet.plan or {}).get("id") == "outlives the node", "the plan again")

    def test_plan_comes_back_when_somebody_takes_it_from_the_broker(self):
        """As the late last will of a predecessor does."""
        self.offer("stays")
        count = len(self.tablet.heard[TOPICS.plan])
        broker = Broker(
            "localhost", PORT, account=load_account(self.folder / "site/accounts/kr120-bridge/account.json")
        )
        other = make_client(broker, unique_id("kr120", "other"), "unused")
        other.connect(broker.host, broker.port)
        other.loop_start()
        other.publish(TOPICS.plan, b"", qos=1, retain=True).wait_for_publish(10.0)
        other.disconnect()
        wait(lambda: len(self.tablet.heard[TOPICS.plan]) >= count + 2, "the plan taken and put back")
        self.assertEqual(self.tablet.plan["id"], "stays")

    def test_broker_killed_and_started_again(self):
        self.offer("survives")
        self.programs["broker"].kill()
        self.programs["broker"].wait(10.0)
        wait(lambda: not self.tablet.client.is_connected(), "the loss of the connection")
        self.tablet.heard[TOPICS.plan].clear()
        self._start("broker", "--config", str(self.folder / "site/broker/mosquitto.conf"))
        wait(lambda: (self.tablet.plan or {}).get("id") == "survives", "the plan on the new broker")
        self.assertTrue(self.tablet.verdict(self.tablet.plan, "rejected")["ok"])


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "remote_review", MqttReviewTest, sys.argv)

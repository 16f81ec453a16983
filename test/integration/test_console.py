#!/usr/bin/env python3
"""A person at the console, without a browser: MQTT through the console's WebSocket, files over HTTP by the login's session."""

import hashlib
import http.client
import json
import re
import sys
import time
import uuid
from urllib.parse import urljoin
from xml.etree import ElementTree

import paho.mqtt.client as mqtt
import rospy
import rostest
from construction_twin.msg import Execution
from twin_client import LEFT, RobotTest, Stream, wait

from construction_twin.core.freshness import parse_moment, present_moment, staleness
from construction_twin.core.units import from_wire
from construction_twin.extensions.console.remote_view import COMPATIBLE, VERSION
from construction_twin.kinematics.chain import Chain
from construction_twin.mqtt import requests
from construction_twin.mqtt.messages import Topics
from construction_twin.robot.frames import rotation_to_quaternion

PORT = 28466
TOPICS = Topics("twin", "kr120")
ACCOUNT = "console"
HEARD = {
    "view": TOPICS.view,
    "screen": TOPICS.screen,
    "scene": TOPICS.scene,
    "plan": TOPICS.plan,
    "review_ack": TOPICS.ack_of(requests.REVIEW),
    "stop_ack": TOPICS.stop_ack,
    "plan_request_ack": TOPICS.ack_of(requests.PLAN_REQUEST),
}


class Console:
    """What the page does, in Python."""

    def __init__(self):
        self.heard: dict[str, list[dict]] = {name: [] for name in HEARD}
        self._names = {topic: name for name, topic in HEARD.items()}
        #: The session, which a browser would get with the page.
        self.cookie = f"console_session={uuid.uuid4().hex}"
        self.client = mqtt.Client(
            mqtt.CallbackAPIVersion.VERSION2,
            protocol=mqtt.MQTTv5,
            client_id=uuid.uuid4().hex,
            transport="websockets",
        )
        self.client.ws_set_options(path="/mqtt", headers=lambda headers: headers | {"Cookie": self.cookie})
        self.client.on_connect = lambda client, *_: client.subscribe([(topic, 1) for topic in HEARD.values()])
        self.client.on_message = self._on_message
        self.client.connect_async("127.0.0.1", PORT)
        self.client.loop_start()

    def close(self) -> None:
        self.client.disconnect()
        self.client.loop_stop()

    def _on_message(self, client, data, message) -> None:
        if message.payload:
            self.heard[self._names[message.topic]].append(json.loads(message.payload))

    def newest(self, name: str):
        return self.heard[name][-1] if self.heard[name] else None

    def send(self, topic: str, document: dict, qos: int = 1) -> None:
        self.client.publish(topic, json.dumps(document), qos=qos)

    def ask(self, topic: str, ack: str, document: dict) -> dict:
        """Send a request with an id of its own; return the answer to it. One that came too soon is sent again when it may be."""
        name, again = "", 0.0
        found: list[dict] = []

        def answered() -> bool:
            nonlocal name, again, found
            found = [answer for answer in self.heard[ack] if answer["id"] == name]
            soon = re.search(r"try again in ([0-9.]+) s", found[0].get("reason", "")) if found else None
            if soon and not again:
                again = time.monotonic() + float(soon[1])
            if not name or (soon and time.monotonic() > again):
                name, again, found = uuid.uuid4().hex, 0.0, []
                moment = {"moment": self.moment} if ack == "plan_request_ack" else {}
                self.send(topic, {"id": name} | moment | document)
            return bool(found) and not soon

        wait(answered, f"the answer to {document} on {ack}")
        return found[0]

    def line(self, topic: str) -> dict:
        """Return the line of the status line about a topic; empty before the first one."""
        return next((line for line in self.newest("screen") or [] if line["topic"] == topic), {})

    @property
    def moment(self) -> str:
        """What whoever starts something repeats: of the newest view."""
        return self.newest("view")["moment"]

    def verdict(self, plan: dict, verdict: str, moment: str = "") -> dict:
        count = len(self.heard["review_ack"])
        document = {"plan_id": plan["id"], "plan_hash": plan["hash"], "verdict": verdict, "reviewer": "Ada"}
        document["moment"] = moment or self.moment
        self.send(TOPICS.of(requests.REVIEW, ACCOUNT), document)
        wait(lambda: len(self.heard["review_ack"]) > count, "an answer on review/ack")
        return self.heard["review_ack"][count]


def get(path: str, cookie: str = "") -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", PORT, timeout=10.0)
    connection.request("GET", path, headers={"Cookie": cookie} if cookie else {})
    return connection.getresponse()


class ConsoleTest(RobotTest):
    @classmethod
    def setUpClass(cls):
        super().setUpClass()
        cls.console = Console()
        cls.addClassCleanup(cls.console.close)
        for service in ("plan_to_joints", "plan_to_pose", "plan_cartesian", "review_plan"):
            rospy.wait_for_service(service, 60.0)
        # a message that is sent before the node subscribes is heard by nobody
        wait(lambda: cls.console.heard["view"] and cls.console.heard["screen"], "view and status line", 60.0)

    def plan(self, answer: dict) -> dict:
        """Return the plan that an answer names, as it is shown."""
        self.assertTrue(answer["ok"], answer)
        wait(lambda: (self.console.newest("plan") or {}).get("id") == answer["plan_id"], "the plan that was asked for")
        return self.console.newest("plan")

    def joints(self, degrees) -> dict:
        return dict(zip(self.client.robot.joint_names, from_wire(degrees, self.client.robot.linear)))

    def test_everything_is_seen(self):
        self.begin()
        console = self.console
        wait(lambda: console.line("link").get("state") == "ARMED", "the link on the status line")
        wait(lambda: console.line("startup").get("state") == "ready", "the start on the status line")
        self.assertEqual({line["topic"] for line in console.newest("screen")}, {"startup", "link", "sync", "execution"})
        view = console.newest("view")
        self.assertEqual((view["version"], view["compatible"], view["online"]), (VERSION, COMPATIBLE, True))
        wait(lambda: console.newest("view")["link"]["round_trip_ms"], "the round trip")
        scene = console.newest("scene")
        self.assertEqual((scene["frame"], len(scene["hash"])), (self.client.robot.base_link, 64))
        self.assertTrue(scene["objects"])

    def test_the_robot_is_served_to_who_is_logged_in(self):
        model = "/private/kr120/robot.urdf"
        self.assertEqual(get(model).status, 403)
        answer = get(model, self.console.cookie)
        self.assertEqual(answer.status, 200)
        meshes = [mesh.get("filename") for mesh in ElementTree.fromstring(answer.read()).iter("mesh")]
        self.assertGreater(len(meshes), 5)
        for path in set(meshes):
            answer = get(urljoin(model, path), self.console.cookie)
            digest = hashlib.sha256(answer.read()).hexdigest()
            self.assertEqual((answer.status, digest), (200, path.split("/")[-1].split(".")[0]))

    def test_a_motion_is_asked_for_approved_and_carried_out_then_one_is_stopped(self):
        self.begin()
        console = self.console
        goal = {"kind": "joints", "joints": self.joints(LEFT), "speed_scale": 0.5}
        plan = self.plan(console.ask(TOPICS.of(requests.PLAN_REQUEST, ACCOUNT), "plan_request_ack", goal))
        self.assertEqual(plan["source"], "MQTT, on the topic of console")
        wait(lambda: console.newest("view")["plan"] == plan["id"], "the plan in the view")
        wait(lambda: console.line("execution").get("who") == "reviewer", "the reviewer on the status line")
        shown = console.moment
        wait(lambda: staleness(parse_moment(shown), present_moment()), "what was shown to be too old")
        late = console.verdict(plan, "approved", shown)
        self.assertEqual((late["ok"], late["expired"]), (False, True), late)
        self.assertIn("look again", late["reason"])
        late = console.ask(TOPICS.of(requests.PLAN_REQUEST, ACCOUNT), "plan_request_ack", goal | {"moment": shown})
        self.assertEqual((late["ok"], late["expired"]), (False, True), late)
        self.assertEqual(console.newest("view")["plan"], plan["id"], "it is still under review")
        self.assertEqual(self.client.execution.state, Execution.IDLE)
        with Stream("mock_rsi/joint_states") as arm:
            self.assertTrue(console.verdict(plan, "approved")["ok"])
            self.client.wait_for_outcome(plan["id"], "finished", plan["duration"] + 20.0)
            wait(lambda: arm.moved(5.0) and arm.at_rest(), "the arm to have moved")
        again = console.verdict(plan, "approved")
        self.assertFalse(again["ok"], "a plan is executed once")
        self.client.wait_until_ready()
        home = goal | {"joints": dict(zip(self.client.robot.joint_names, self.client.robot.home)), "speed_scale": 0.2}
        back = self.plan(console.ask(TOPICS.of(requests.PLAN_REQUEST, ACCOUNT), "plan_request_ack", home))
        with Stream("mock_rsi/joint_states") as arm:
            self.assertTrue(console.verdict(back, "approved")["ok"])
            wait(lambda: arm.moved(2.0), "the arm to move")
            console.send(TOPICS.stop_by(ACCOUNT), {"id": "1"})
            wait(lambda: {each["by"] for each in console.heard["stop_ack"]} == {"gateway", "executor"}, "both answers")
            wait(arm.at_rest, "the arm to rest")
        self.assertGreater(
            max(abs(a - b) for a, b in zip(arm.positions(-1)[0], self.client.robot.home)), 0.05, "short of its goal"
        )
        wait(lambda: console.line("link").get("who") == "operator", "the reset on the status line")
        self.assertEqual(console.newest("screen")[0]["level"], 2)
        self.client.start_over()

    def test_a_plan_to_a_pose_of_the_tool_ends_there(self):
        self.begin()
        console, chain = self.console, Chain(self.client.robot)
        q = [console.newest("view")["twin"]["positions"][k] for k in range(len(self.client.robot.joint_names))]
        pose = chain.forward(q)
        position = [float(value) for value in pose.position]
        orientation = [float(value) for value in rotation_to_quaternion(pose.rotation)]
        position[2] += 0.1
        asked = {"position": position, "orientation": orientation}
        for kind in ("pose", "line"):
            plan = self.plan(
                console.ask(TOPICS.of(requests.PLAN_REQUEST, ACCOUNT), "plan_request_ack", asked | {"kind": kind})
            )
            self.assertLess(max(abs(a - b) for a, b in zip(plan["tool_path"][-1], position)), 1e-3)
            self.assertTrue(console.verdict(plan, "rejected")["ok"])


if __name__ == "__main__":
    rostest.rosrun("construction_twin", "console", ConsoleTest, sys.argv)

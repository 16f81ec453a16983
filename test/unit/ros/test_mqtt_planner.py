"""The node that takes motions from MQTT and shows everything there, without ROS master and broker."""

from __future__ import annotations

import copy
import json
import math
import sys
from types import SimpleNamespace
from typing import ClassVar

import pytest
import rospy
from bridge_bench import Client, Refusals
from construction_twin.msg import Execution, Link, Sync
from construction_twin.srv import PlanTrajectoryRequest, PlanTrajectoryResponse
from diagnostic_msgs.msg import KeyValue
from paho.mqtt.client import topic_matches_sub

from construction_twin.core.errors import PayloadError, PoseUnknownError
from construction_twin.core.reports import HoldReport
from construction_twin.core.units import NANOSECONDS
from construction_twin.link.remote_view import ClosestView, ViewWriter
from construction_twin.link.requests import Joints
from construction_twin.mqtt.client import Broker
from construction_twin.mqtt.messages import Topics
from construction_twin.mqtt.requests import IK, NAMELESS_TRAJECTORY, PLAN_REQUEST, RequestKind
from construction_twin.ros.nodes import mqtt_planner
from construction_twin.ros.nodes.mqtt_planner import (
    REPEAT_WINDOW,
    WAITING,
    MqttPlanner,
    Poses,
    Settings,
)
from construction_twin.ros.shared.endpoint import REPEATED, Endpoint, Incoming, Outlets
from construction_twin.ros.shared.message_board import MessageBoard
from construction_twin.ros.shared.outcome import Outcome
from construction_twin.ros.shared.request_counts import RequestCounts
from construction_twin.ros.transport.joint_stream import to_time
from construction_twin.ros.transport.latest_pose import StampedPose

JOINTS = Joints(("joint_a1", "track"), (False, True))
TRAJECTORY = {
    "id": "7",
    "source": "Ada",
    "units": {"angle": "deg", "length": "mm", "time": "s"},
    "joint_names": ["track", "joint_a1"],
    "points": [
        {"positions": [0.0, 0.0], "time_from_start": 0.0},
        {"positions": [500.0, 90.0], "time_from_start": 2.75},
    ],
}  # fmt: skip


class Stream:
    """In place of a LatestPose."""

    def __init__(self, pose: StampedPose | None):
        self.pose = pose

    def newest(self, oldest: float) -> StampedPose:
        if self.pose is None:
            raise PoseUnknownError("twin/joint_states", math.inf, oldest)
        return self.pose


class Bench:
    """The node, a client that remembers, a planner that plans, and clocks that the test sets."""

    resolved_name = "/kr120/plan_trajectory"

    def __init__(self, **settings):
        self.client, self.asked, self.success, self.error, self.retimed = Client(), [], True, None, ""
        self.steady, self.wall = 1000.0, 1_764_000_000.0
        self.made = Refusals(None)
        given = {"host": "127.0.0.1", "port": 1, "max_trajectory_bytes": 4096, "view_rate": 25.0}
        self.node = MqttPlanner(
            Settings(**given | settings), "kr120", JOINTS, Broker("127.0.0.1", 1), self.client,
            ViewWriter("kr120", "cafe", JOINTS), self, self.made,
        )  # fmt: skip

    def __call__(self, **fields):
        # as rospy makes it: fields that the service does not have are an error
        self.asked.append(PlanTrajectoryRequest(**fields))
        if self.error is not None:
            raise self.error
        plan = ("p1", "cafe", 2.75) if self.success else ("", "", 0.0)
        return PlanTrajectoryResponse(self.success, "waiting for review", *plan, self.retimed)

    def send(self, sender: str = "", retained: bool = False, **changes) -> None:
        document = copy.deepcopy(TRAJECTORY) | changes
        self.deliver(sender, json.dumps(document).encode(), retained)

    def deliver(self, sender: str, payload: bytes, retained: bool = False) -> None:
        """Hand over a message as the client does."""
        topic = f"twin/kr120/trajectory/from/{sender}" if sender else "twin/kr120/trajectory"
        (endpoint,) = (each for each in self.node.endpoints if topic_matches_sub(each.topic, topic))
        endpoint.on_message(SimpleNamespace(topic=topic, payload=payload, retain=retained))

    def check(self) -> None:
        """Check everything that waits."""
        self.node.run_waiting()

    @property
    def answers(self) -> list[dict]:
        return [json.loads(payload) for topic, payload in self.client.published if topic == "twin/kr120/trajectory/ack"]


@pytest.fixture
def bench(monkeypatch):
    made = Bench()
    monkeypatch.setattr(rospy, "wait_for_service", lambda *_: None)
    monkeypatch.setattr(rospy, "loginfo", lambda *_: None)
    monkeypatch.setattr(mqtt_planner, "time", SimpleNamespace(monotonic=lambda: made.steady))
    monkeypatch.setattr(mqtt_planner, "now_ns", lambda: round(made.wall * NANOSECONDS))
    return made


def test_a_trajectory_becomes_a_plan_and_the_sender_is_told_its_id(bench):
    bench.send("kr120-planner-ada")
    assert bench.answers == [] and bench.asked == [], "it is checked in another thread"
    bench.check()
    asked = bench.asked[0]
    message = asked.trajectory
    assert message.joint_names == ["joint_a1", "track"]
    assert list(message.points[1].positions) == pytest.approx([math.pi / 2, 0.5])
    assert message.points[1].time_from_start.to_sec() == 2.75 and message.header.stamp.to_sec() == 0.0
    assert (asked.speed_scale, asked.acceleration_scale, asked.retime) == (0.0, 0.0, True)
    assert asked.source == "MQTT, on the topic of kr120-planner-ada, which says it is 'Ada'"
    assert bench.answers == [
        {"id": "7", "sender": "kr120-planner-ada", "ok": True, "reason": "waiting for review", "plan_id": "p1",
         "plan_hash": "cafe", "duration": 2.75, "notes": []}
    ]  # fmt: skip
    assert bench.node.report().values == {"trajectories under review": 1, "trajectories waiting": 0}


def test_who_floods_with_what_cannot_be_read_is_not_always_answered_and_a_motion_is(bench):
    for _ in range(100):
        bench.deliver("kr120-planner-ada", b"{")
    answered = len(bench.answers)
    assert 10 <= answered < 100 and sum(bench.made.refused.values()) == 100
    assert bench.node.report().values["trajectories malformed, not answered"] == 100 - answered
    bench.send("kr120-planner-ada")
    bench.check()
    assert bench.answers[-1]["ok"] and len(bench.answers) == answered + 1


def test_a_planner_that_is_gone_is_told_and_the_node_goes_on(bench):
    bench.error = rospy.ServiceException("connection refused")
    bench.send()
    bench.check()
    assert "/kr120/plan_trajectory does not answer: connection refused" in bench.answers[0]["reason"]
    bench.error = None
    bench.steady += NAMELESS_TRAJECTORY.pace.seconds
    bench.send(id="8")
    bench.check()
    assert bench.answers[1]["ok"]


def test_what_nobody_foresaw_ends_the_node_because_a_motion_is_no_safety_act(bench, monkeypatch):
    def fail(*_given, **_named):
        raise RuntimeError("nobody foresaw this")

    bench.send()
    monkeypatch.setattr(bench.client, "publish", fail)
    with pytest.raises(RuntimeError, match="nobody foresaw this"):
        bench.check()


def test_times_that_were_replaced_are_told_with_both_durations_and_the_reason(bench):
    bench.retimed = "point 1: joint_a1 has a jerk of 9 rad/s^3; its limit is 5 rad/s^3"
    points = copy.deepcopy(TRAJECTORY["points"])
    points[1]["time_from_start"] = 2.5
    bench.send(points=points)
    bench.check()
    assert bench.answers[0]["notes"] == [f"timed anew: 2.750 s instead of 2.500 s, because {bench.retimed}"]


@pytest.mark.parametrize(
    "sender, payload, retained, reason, request_id",
    [
        ("", json.dumps(TRAJECTORY).encode(), True, "retained", "7"),
        ("", b" " * 5000, False, "size", ""),
        ("", b"{", False, "format", ""),
        ("", json.dumps(TRAJECTORY | {"units": {}}).encode(), False, "format", "7"),
        ("", json.dumps(TRAJECTORY | {"joint_names": []}).encode(), False, "joints", "7"),
        ("", json.dumps(TRAJECTORY | {"speed_scale": 2}).encode(), False, "values", "7"),
        ("no such account", json.dumps(TRAJECTORY).encode(), False, "sender", "7"),
    ],
)
def test_what_is_refused_is_counted_and_answered_with_the_id_where_there_is_one(
    bench, sender, payload, retained, reason, request_id
):
    bench.deliver(sender, payload, retained)
    bench.check()
    assert bench.made.refused == {reason: 1} and bench.asked == []
    assert [(answer["ok"], answer["id"]) for answer in bench.answers] == [(False, request_id)]


def test_more_than_may_wait_is_refused_and_can_be_sent_again(bench):
    for number in range(WAITING + 1):
        bench.send(f"account-{number}", id=f"n{number}")
    assert bench.made.refused == {"busy": 1} and [answer["id"] for answer in bench.answers] == [f"n{WAITING}"]
    bench.check()
    bench.send(f"account-{WAITING}", id=f"n{WAITING}")
    bench.check()
    assert len(bench.asked) == WAITING + 1 and bench.answers[-1]["ok"]


def test_one_sender_alone_does_not_hold_up_the_others(bench):
    for number in range(25):
        bench.send("hasty", id=f"n{number}")
        bench.check()
        bench.steady += 0.05
    assert [asked.source for asked in bench.asked] == [bench.asked[0].source] * 2 and bench.made.refused == {"busy": 23}
    refused = next(answer for answer in bench.answers if not answer["ok"])
    assert (refused["id"], refused["sender"]) == ("n1", "hasty")
    assert refused["reason"] == "one motion in 1 s is taken from a sender; try again in 1.0 s"
    bench.send("patient")
    bench.check()
    assert bench.answers[-1]["ok"]


def test_the_same_message_twice_makes_one_plan_and_gets_one_answer_twice(bench):
    """QoS 1 may deliver twice; a second plan would take the first one from under the reviewer."""
    bench.send()
    bench.send()
    bench.check()
    bench.send()
    assert len(bench.asked) == 1 and bench.made.refused == {"repeated": 2}
    assert [answer["plan_id"] for answer in bench.answers] == ["p1", "p1"]
    bench.steady += REPEAT_WINDOW + 0.1
    bench.send()
    bench.check()
    assert len(bench.asked) == 2, "later it is meant"


# -- view


def view(bench) -> dict:
    return json.loads(bench.node.publish_view())


def reports(bench) -> None:
    bench.node.on_sync(
        Sync(text="IN_SYNC", reason="agree", agreed=True, error=[0.1, 0.2], threshold=[1.0, 1.0], servo_lag=0.01)
    )
    bench.node.on_link(Link(text="ARMED", gateway_state="following", gateway_kind="rsi"))
    execution = Execution(text="PLAYING", plan_id="p1", duration=10.0, rate=1.0, speed_limit=1.0)
    execution.header.stamp = execution.plan_start = to_time(round(bench.wall * NANOSECONDS))
    bench.node.on_execution(execution)


def test_the_view_shows_what_is_known(bench):
    stamp = round((bench.wall - 0.01) * NANOSECONDS)
    bench.node.listen(
        Poses(
            Stream(StampedPose((0.5, 1.5), stamp, 999.99)),
            Stream(StampedPose((0.4, 1.4), stamp, 999.98)),
            Stream(StampedPose((0.401, 1.399), stamp, 999.97)),
        ),
        lambda: True,
    )
    reports(bench)
    bench.steady += 0.04
    bench.wall += 2.5
    message = view(bench)
    assert message["twin"] == {"stamp": 1_763_999_999.99, "age": 0.05, "positions": [0.5, 1.5]}
    assert message["arm"] == {"stamp": 1_763_999_999.99, "age": 0.06, "positions": [0.4, 1.4]}
    assert message["expected"] == {"stamp": 1_763_999_999.99, "age": 0.07, "positions": [0.401, 1.399]}
    assert (message["sync"]["state"], message["sync"]["age"], message["link"]["state"]) == ("IN_SYNC", 0.04, "ARMED")
    assert (message["execution"]["state"], message["execution"]["progress"]) == ("PLAYING", 0.25)
    assert [topic for topic, _ in bench.client.published] == ["twin/kr120/view"]


def test_what_is_old_is_shown_as_not_known(bench):
    bench.node.listen(Poses(Stream(None), Stream(None), Stream(None)), lambda: True)
    reports(bench)
    bench.steady += 1.0
    message = view(bench)
    assert message["twin"] is message["arm"] is message["expected"] is message["sync"] is None
    assert message["link"]["age"] == 1.0
    bench.steady += 3.0
    assert view(bench)["link"] is None and view(bench)["execution"]["state"] == "PLAYING"
    bench.node.listen(Poses(Stream(None), Stream(None)), lambda: False)
    assert view(bench)["execution"] is None, "its node is gone"


# -- consoles


class Feed:
    """In place of a ConsoleFeed."""

    plan = "p7"
    hold = HoldReport("joint_a3 differs", 7 * 10**9)
    approval_obstacle = "not in sync"

    def __init__(self):
        self.heard: list = []
        self.messages = MessageBoard(lambda text: None, lambda reason, sentence: None)

    def note_poses(self, twin, arm):
        self.heard.append(("poses", twin, arm))

    def on_link(self, message):
        self.heard.append(("link", message.text))

    def on_execution(self, report):
        self.heard.append(("execution", report.text))

    def publish_retained(self):
        self.heard.append("publish_retained")

    def publish_offline(self):
        self.heard.append("publish_offline")

    def publish_status_line(self, link, sync, execution, now):
        self.heard.append(("tell", *(report and report.text for report in (link, sync, execution))))


class Desk:
    """In place of a ConsoleRequests."""

    counts: ClassVar[dict] = {"ik free": 2}

    def __init__(self):
        self.heard: list = []
        self.plan_requests, self.ik = self._endpoint(PLAN_REQUEST), self._endpoint(IK)

    def _endpoint(self, kind: RequestKind) -> Endpoint:
        name = kind.name

        def read(incoming: Incoming):
            self.heard.append((name, incoming.account, incoming.payload, incoming.retained))
            raise PayloadError(REPEATED, "nothing is to be done")

        outlets = Outlets(lambda *_: None, lambda *_: None)
        return Endpoint(
            kind, Topics("twin", "kr120"), read, lambda asked: Outcome(True, ""), RequestCounts(name), outlets
        )

    def closest(self):
        return ClosestView(0.5, ("link_3", "wall"), (1.0, 2.0, 3.0), 0.25)

    def run(self, looks_around):
        pass


class Listening(Client):
    """A client that remembers what is subscribed, and delivers messages as paho does."""

    def __init__(self):
        super().__init__()
        self.topics: list = []
        self.callbacks: dict = {}

    def subscribe(self, topics):
        self.topics += [topic for topic, *_ in topics]

    def message_callback_add(self, topic, callback):
        self.callbacks[topic] = callback

    def connect_async(self, *_):
        pass

    def loop_start(self):
        pass

    def deliver(self, topic: str, payload: bytes) -> None:
        message = SimpleNamespace(topic=topic, payload=payload, retain=False)
        for pattern, callback in self.callbacks.items():
            if topic_matches_sub(pattern, topic):
                callback(self, None, message)


@pytest.fixture
def consoles(bench, monkeypatch):
    """The node with a feed and a desk, as `start` gives them; and without trajectories."""

    def make(**settings) -> tuple[Bench, Listening, Feed, Desk]:
        client = Listening()
        with monkeypatch.context() as patch:
            patch.setattr(sys.modules[__name__], "Client", lambda: client)
            made = Bench(**settings)
        feed, desk = Feed(), Desk()
        made.node.serve_consoles(feed, desk)
        made.node.connect()
        made.node.on_connect(client, None, None, SimpleNamespace(is_failure=False), None)
        return made, client, feed, desk

    return make


def test_wishes_and_poses_reach_the_desk_with_their_account_and_our_own_answers_do_not(consoles):
    _, client, feed, desk = consoles()
    assert {"twin/kr120/plan_request/+", "twin/kr120/ik/+"} <= set(client.topics) and "publish_retained" in feed.heard
    client.deliver("twin/kr120/plan_request/ada", b"{}")
    client.deliver("twin/kr120/plan_request/ack", b"{}")
    client.deliver("twin/kr120/ik/ada", b"[]")
    client.deliver("twin/kr120/ik/ack/ada", b"[]")
    assert desk.heard == [("plan_request", "ada", b"{}", False), ("ik", "ada", b"[]", False)]


def test_the_view_has_what_feed_and_desk_know(bench, consoles):
    made, _, feed, _ = consoles()
    made.node.listen(Poses(Stream(None), Stream(None)), lambda: True)
    link = Link(text="ARMED", gateway_counters=[KeyValue("telegrams", "9"), KeyValue("late_replies", "3")])
    made.node.on_link(link)
    made.node.on_sync(Sync(text="IN_SYNC", round_trip=0.0321))
    made.node.on_execution(
        Execution(text="AT_BOUNDARY", segment=1, segment_name="carry", at_boundary=True, engaged=True)
    )
    message = view(made)
    assert (message["plan"], message["closest"]["between"]) == ("p7", ["link_3", "wall"])
    assert (message["link"]["round_trip_ms"], message["link"]["late"]) == (32.1, 3)
    assert message["hold"] == {"cause": "joint_a3 differs", "since": 7.0}
    assert message["approval_obstacle"] == "not in sync"
    assert message["execution"]["segment"] == {"number": 1, "name": "carry", "at_boundary": True}
    assert made.node.is_engaged() and made.node.report().values["ik free"] == 2
    made.node.on_link(Link(text="ARMED", gateway_counters=[KeyValue("telegrams", "9")]))
    made.node.on_execution(Execution(text="IDLE", segment=-1))
    assert view(made)["link"]["late"] == 0 and view(made)["execution"]["segment"] is None
    made.node.on_link(Link(text="GATEWAY_OFFLINE"))
    assert view(made)["link"]["late"] is None
    made.node.publish_status_line()
    assert ("link", "ARMED") in feed.heard and ("execution", "AT_BOUNDARY") in feed.heard
    assert feed.heard[-1] == ("tell", "GATEWAY_OFFLINE", "IN_SYNC", "IDLE")
    bench.steady += 10.0
    made.node.publish_status_line()
    assert feed.heard[-1] == ("tell", None, None, "IDLE"), "what is silent is not the present"
    assert view(made)["hold"] is None

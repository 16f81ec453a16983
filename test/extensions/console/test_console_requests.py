"""Motions and wishes for plans from consoles, without ROS master and broker."""

from __future__ import annotations

import copy
import json
import math
from types import SimpleNamespace

import pytest
import rospy
from bridge_bench import Client
from construction_twin.srv import (
    PlanCartesianResponse,
    PlanToJointsResponse,
    PlanToPoseResponse,
    PlanTrajectory,
    PlanTrajectoryResponse,
    WorkPlanTaskResponse,
)
from paho.mqtt.client import topic_matches_sub
from std_srvs.srv import TriggerResponse

from construction_twin.core.freshness import Moment
from construction_twin.extensions.console.nodes import endpoint
from construction_twin.extensions.console.nodes.endpoint import Connection
from construction_twin.extensions.console.nodes.requests import WAITING_PLANS, ConsoleRequests
from construction_twin.link.requests import Joints
from construction_twin.mqtt.client import Broker
from construction_twin.mqtt.messages import Topics
from construction_twin.ros.messages.services import PLAN_SERVICES

JOINTS = Joints(("joint_a1", "track"), (False, True))
ADA = "kr120-planner-ada"
POSE = {"position": [1.0, 0.0, 2.0], "orientation": [0.0, 0.0, 0.0, 1.0]}
PLAN = {"success": True, "message": "waiting for review", "plan_id": "p1", "plan_hash": "cafe"}
TIMED = PLAN | {"duration": 2.5}

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


class Service:
    """In place of a `rospy.ServiceProxy`: fields that the service does not have are an error."""

    def __init__(self, name: str, kind, answer):
        self.resolved_name, self._request, self.answer = (
            f"/kr120/{name}",
            rospy.ServiceProxy(name, kind).request_class,
            answer,
        )
        self.asked: list = []

    def __call__(self, **fields):
        self.asked.append(self._request(**fields))
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


class Bench:
    def __init__(self):
        self.client, self.planner = (
            Client(),
            Service("plan_trajectory", PlanTrajectory, PlanTrajectoryResponse(**PLAN | {"duration": 2.75})),
        )
        self.refused: list[str] = []
        self.steady, self.wall = 1000.0, 1_764_000_000 * 10**9
        self.work, self.engaged = False, False
        self.connection = Connection(Broker("127.0.0.1", 1), self.client, Topics("twin", "kr120"), self._refuse)
        self.services = {
            kind: Service(PLAN_SERVICES[kind].name, PLAN_SERVICES[kind].kind, answer)
            for kind, answer in (
                ("joints", PlanToJointsResponse(**TIMED)),
                ("pose", PlanToPoseResponse(**TIMED)),
                ("line", PlanCartesianResponse(**TIMED, fraction=1.0)),
                ("way_back", TriggerResponse(True, "the way back waits")),
                ("work_task", WorkPlanTaskResponse(**PLAN, task="t")),
            )
        }
        self.desk = ConsoleRequests(
            JOINTS, self.services, self.planner, self.connection, 4096, lambda: self.work, lambda: self.engaged
        )

    def moment(self) -> Moment:
        """The present moment."""
        return Moment("c0ffee00", round(self.steady * 1e9))

    @property
    def published(self) -> list[tuple[str, dict]]:
        return [(topic, json.loads(payload)) for topic, payload in self.client.published]

    def _refuse(self, reason: str, sentence: str) -> None:
        self.refused.append(reason)

    def deliver(self, topic: str, payload: bytes, retained: bool = False) -> None:
        """Hand over a message as the client does."""
        (endpoint,) = (
            each for each in self.connection.endpoints if topic_matches_sub(each.topic, f"twin/kr120/{topic}")
        )
        endpoint.on_message(SimpleNamespace(topic=f"twin/kr120/{topic}", payload=payload, retain=retained))

    def ask(self, account: str = ADA, retained: bool = False, **document) -> dict:
        """Send a wish, and have it carried out; return the newest answer."""
        wish = {"id": "7", "moment": str(self.moment())} | document
        self.deliver(f"plan_request/{account}", json.dumps(wish).encode(), retained)
        self.desk.queue.run()
        self.steady += 1.1
        topic, answer = self.published[-1]
        assert topic == "twin/kr120/plan_request/ack"
        return answer

    def send(self, sender: str = "", retained: bool = False, **changes) -> None:
        """Send a motion."""
        topic = f"trajectory/from/{sender}" if sender else "trajectory"
        self.deliver(topic, json.dumps(copy.deepcopy(TRAJECTORY) | changes).encode(), retained)

    @property
    def answers(self) -> list[dict]:
        """The answers to motions."""
        return [answer for topic, answer in self.published if topic == "twin/kr120/trajectory/ack"]


@pytest.fixture
def bench(monkeypatch):
    made = Bench()
    monkeypatch.setattr(rospy, "wait_for_service", lambda *_: None)
    monkeypatch.setattr(rospy, "loginfo", lambda *_: None)
    monkeypatch.setattr(endpoint, "time", SimpleNamespace(monotonic=lambda: made.steady))
    monkeypatch.setattr(endpoint, "present_moment", made.moment)
    return made


def test_joint_values_become_a_plan_that_a_stop_before_its_turn_voids(bench):
    arrived = str(bench.moment())
    answer = bench.ask(kind="joints", joints={"track": 1.5, "joint_a1": 0.25}, speed_scale=0.5)
    assert answer == {
        "id": "7", "account": ADA, "kind": "joints", "ok": True, "reason": "waiting for review",
        "plan_id": "p1", "plan_hash": "cafe", "duration": 2.5, "expired": False,
    }  # fmt: skip
    (asked,) = bench.services["joints"].asked
    assert (list(asked.goal), list(asked.start), asked.speed_scale) == ([0.25, 1.5], [], 0.5)
    assert (asked.source, asked.asked) == (f"MQTT, on the topic of {ADA}", arrived)


def test_a_pose_and_a_line_are_poses_of_the_tool_in_the_base(bench):
    assert bench.ask(kind="pose", configuration="front up positive", **POSE)["ok"]
    (asked,) = bench.services["pose"].asked
    assert (asked.goal.header.frame_id, asked.configuration) == ("", "front up positive")
    assert (asked.goal.pose.position.z, asked.goal.pose.orientation.w) == (2.0, 1.0)
    assert bench.ask(kind="line", speed=0.1, **POSE)["duration"] == 2.5
    (asked,) = bench.services["line"].asked
    (waypoint,) = asked.waypoints
    assert (asked.frame_id, asked.speed, waypoint.arc, waypoint.pose.position.x) == ("", 0.1, False, 1.0)


def test_the_way_back_is_the_planners_and_the_work_nodes_where_it_carries_a_task(bench):
    assert bench.ask(kind="way_back")["plan_id"] == ""
    bench.work = True
    bench.ask(kind="way_back", id="8")
    assert len(bench.services["way_back"].asked) == 2 and bench.services["work_task"].asked == []
    bench.engaged = True
    assert bench.ask(kind="way_back", id="9")["plan_id"] == "p1"
    assert len(bench.services["way_back"].asked) == 2 and bench.services["work_task"].asked[0].task == ""


def test_a_task_is_planned_only_where_a_building_model_is_worked_on(bench):
    answer = bench.ask(kind="work_task", task="t")
    assert not answer["ok"] and "no building model" in answer["reason"] and bench.services["work_task"].asked == []
    bench.work = True
    assert bench.ask(kind="work_task", task="t", id="8")["plan_id"] == "p1"
    assert bench.services["work_task"].asked[0].task == "t"


def test_what_the_planner_refuses_and_a_planner_that_is_gone_are_sentences(bench):
    bench.services["pose"].answer = PlanToPoseResponse(message="link_3 would touch wall")
    answer = bench.ask(kind="pose", **POSE)
    assert (answer["ok"], answer["reason"], answer["plan_id"]) == (False, "link_3 would touch wall", "")
    bench.services["pose"].answer = rospy.ServiceException("connection refused")
    answer = bench.ask(kind="pose", id="8", **POSE)
    assert "/kr120/plan_to_pose does not answer: connection refused" in answer["reason"]
    assert bench.connection.status_fields() == {"plan_request not taken": 2}


@pytest.mark.parametrize(
    "account, document, retained, reason, name",
    [
        (ADA, {"kind": "way_back"}, True, "retained", "7"),
        (ADA, {"kind": "dance"}, False, "format", "7"),
        (ADA, {"kind": "joints", "joints": {}}, False, "values", "7"),
        (ADA, {"kind": "line", "speed": -1, **POSE}, False, "values", "7"),
        ("no account", {"kind": "way_back"}, False, "sender", "7"),
        (ADA, {"kind": "way_back", "moment": ""}, False, "moment", "7"),
        (ADA, {"kind": "way_back", "moment": "deadbeef-1000000"}, False, "too_old", "7"),
    ],
)
def test_what_is_refused_is_counted_and_answered_with_its_id(bench, account, document, retained, reason, name):
    answer = bench.ask(account, retained, **document)
    assert bench.refused == [reason] and (answer["ok"], answer["id"]) == (False, name)


def test_a_wish_that_came_too_late_is_void_and_says_so(bench):
    shown = str(bench.moment())
    bench.steady += 6.0
    answer = bench.ask(kind="way_back", moment=shown)
    assert (answer["ok"], answer["expired"], answer["kind"]) == (False, True, "way_back")
    assert "too old: it is of 6.0 s ago" in answer["reason"] and bench.refused == ["too_old"]
    assert bench.services["way_back"].asked == [] and bench.ask(kind="way_back", id="8")["ok"]


# -- motions that were planned elsewhere


def test_a_trajectory_becomes_a_plan_and_the_sender_is_told_its_id(bench):
    bench.send("kr120-planner-ada")
    assert bench.answers == [] and bench.planner.asked == [], "it is checked in another thread"
    bench.desk.queue.run()
    asked = bench.planner.asked[0]
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
    assert bench.connection.status_fields() == {"trajectory taken": 1}


def test_times_that_were_replaced_are_told_with_both_durations_and_the_reason(bench):
    bench.planner.answer.retimed = "point 1: joint_a1 has a jerk of 9 rad/s^3; its limit is 5 rad/s^3"
    points = copy.deepcopy(TRAJECTORY["points"])
    points[1]["time_from_start"] = 2.5
    bench.send(points=points)
    bench.desk.queue.run()
    assert bench.answers[0]["notes"] == [
        f"timed anew: 2.750 s instead of 2.500 s, because {bench.planner.answer.retimed}"
    ]


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
    bench.deliver(f"trajectory/from/{sender}" if sender else "trajectory", payload, retained)
    bench.desk.queue.run()
    assert bench.refused == [reason] and bench.planner.asked == []
    assert [(answer["ok"], answer["id"]) for answer in bench.answers] == [(False, request_id)]


def test_more_than_may_wait_is_refused_and_can_be_sent_again(bench):
    for number in range(WAITING_PLANS + 1):
        bench.send(f"account-{number}", id=f"n{number}")
    assert bench.refused == ["busy"] and [answer["id"] for answer in bench.answers] == [f"n{WAITING_PLANS}"]
    bench.desk.queue.run()
    bench.send(f"account-{WAITING_PLANS}", id=f"n{WAITING_PLANS}")
    bench.desk.queue.run()
    assert len(bench.planner.asked) == WAITING_PLANS + 1 and bench.answers[-1]["ok"]


def test_one_sender_alone_does_not_hold_up_the_others(bench):
    for number in range(25):
        bench.send("hasty", id=f"n{number}")
        bench.desk.queue.run()
        bench.steady += 0.05
    assert [asked.source for asked in bench.planner.asked] == [bench.planner.asked[0].source] * 2 and bench.refused == [
        "busy"
    ] * 23
    refused = next(answer for answer in bench.answers if not answer["ok"])
    assert (refused["id"], refused["sender"]) == ("n1", "hasty")
    assert refused["reason"] == "one motion in 1 s is taken from a sender; try again in 1.0 s"
    bench.send("patient")
    bench.desk.queue.run()
    assert bench.answers[-1]["ok"]


def test_what_comes_too_soon_is_not_even_read(bench, monkeypatch):
    """A motion of 2 MiB takes so long to read that a flood of them held up a rejection."""
    bench.send("hasty")
    monkeypatch.setattr(endpoint, "read_document", lambda *_: pytest.fail("it was read"))
    bench.send("hasty", id="8")
    assert bench.refused == ["busy"] and bench.answers[-1]["id"] == "8"

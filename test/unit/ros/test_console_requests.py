"""Wishes for plans and dragged poses from consoles, without ROS master and broker."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
import rospy
from construction_twin.srv import (
    PlanCartesianResponse,
    PlanToJointsResponse,
    PlanToPoseResponse,
    WorkPlanTaskResponse,
)
from paho.mqtt.client import topic_matches_sub
from std_srvs.srv import TriggerResponse

from construction_twin.core.freshness import Moment
from construction_twin.core.motion_errors import SceneError
from construction_twin.link.requests import Joints
from construction_twin.mqtt.messages import Topics
from construction_twin.robot.plan import Clearance
from construction_twin.ros.messages.plan_services import PLAN_SERVICES
from construction_twin.ros.shared import console_requests, endpoint
from construction_twin.ros.shared.console_requests import (
    ConsoleRequests,
    RobotContext,
)
from construction_twin.ros.shared.endpoint import Outlets
from construction_twin.ros.shared.request_queue import RequestQueue
from construction_twin.views.reachability import PoseVerdict, Reach

JOINTS = Joints(("joint_a1", "track"), (False, True))
ADA = "kr120-planner-ada"
POSE = {"position": [1.0, 0.0, 2.0], "orientation": [0.0, 0.0, 0.0, 1.0]}
PLAN = {"success": True, "message": "waiting for review", "plan_id": "p1", "plan_hash": "cafe"}
TIMED = PLAN | {"duration": 2.5}


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


class Judge:
    """In place of a PoseJudge."""

    def __init__(self):
        self.asked: list = []
        self.verdict = PoseVerdict(Reach.FREE, "can be reached", np.array([0.25, 1.5]))
        self.error: Exception | None = None
        self.clearance: Clearance | None = Clearance(0.25, ("link_3", "wall"), (1.0, 2.0, 3.0))

    def judge(self, position, rotation, seed):
        self.asked.append((tuple(position), np.asarray(rotation).tolist(), tuple(seed)))
        if self.error is not None:
            raise self.error
        return self.verdict

    def closest(self, q):
        if self.error is not None:
            raise self.error
        return self.clearance


class Bench:
    def __init__(self):
        self.published: list[tuple[str, dict]] = []
        self.refused: list[str] = []
        self.steady, self.wall = 1000.0, 1_764_000_000 * 10**9
        self.twin, self.work, self.engaged = (0.5, 1.0), False, False
        self.judge = Judge()
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
        self.queue = RequestQueue(4, 5.0, lambda: self.steady)
        around = RobotContext(lambda: self.twin, lambda: self.work, lambda: self.engaged, self.moment)
        self.desk = ConsoleRequests(
            Topics("twin", "kr120"), JOINTS, self.queue, self.services, self.judge, around,
            Outlets(self._publish, self._refuse), lambda account: f"MQTT account {account}",
        )  # fmt: skip

    def moment(self) -> Moment:
        """The present moment."""
        return Moment("c0ffee00", round(self.steady * 1e9))

    def _publish(self, topic: str, payload: bytes, qos: int = 1) -> None:
        self.published.append((topic, json.loads(payload)))

    def _refuse(self, reason: str, sentence: str) -> None:
        self.refused.append(reason)

    def deliver(self, topic: str, payload: bytes, retained: bool = False) -> None:
        """Hand over a message as the client does."""
        (endpoint,) = (
            each
            for each in (self.desk.plan_requests, self.desk.ik)
            if topic_matches_sub(each.topic, f"twin/kr120/{topic}")
        )
        endpoint.on_message(SimpleNamespace(topic=f"twin/kr120/{topic}", payload=payload, retain=retained))

    def ask(self, account: str = ADA, retained: bool = False, **document) -> dict:
        """Send a wish, and have it carried out; return the newest answer."""
        wish = {"id": "7", "moment": str(self.moment())} | document
        self.deliver(f"plan_request/{account}", json.dumps(wish).encode(), retained)
        self.queue.run()
        self.steady += 1.1
        topic, answer = self.published[-1]
        assert topic == "twin/kr120/plan_request/ack"
        return answer

    def drag(self, account: str = ADA, **document) -> None:
        self.deliver(f"ik/{account}", json.dumps({"id": "3"} | POSE | document).encode())


@pytest.fixture
def bench(monkeypatch):
    made = Bench()
    monkeypatch.setattr(rospy, "wait_for_service", lambda *_: None)
    monkeypatch.setattr(rospy, "loginfo", lambda *_: None)
    for module in (console_requests, endpoint):
        monkeypatch.setattr(module, "time", SimpleNamespace(monotonic=lambda: made.steady))
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
    assert (asked.source, asked.asked) == (f"MQTT account {ADA}", arrived)


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
    bench.services["pose"].answer = PlanToPoseResponse(False, "link_3 would touch wall", "", "", 0.0)
    answer = bench.ask(kind="pose", **POSE)
    assert (answer["ok"], answer["reason"], answer["plan_id"]) == (False, "link_3 would touch wall", "")
    bench.services["pose"].answer = rospy.ServiceException("connection refused")
    answer = bench.ask(kind="pose", id="8", **POSE)
    assert "/kr120/plan_to_pose does not answer: connection refused" in answer["reason"]
    assert bench.desk.counts == {"plan_requests no plan": 2}


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


# -- poses that are dragged


def test_a_pose_is_solved_near_the_twin_or_near_a_seed(bench):
    bench.drag()
    bench.desk.poses.run()
    bench.drag(seed={"joint_a1": 0.1, "track": 0.2})
    bench.desk.poses.run()
    assert [seed for _, _, seed in bench.judge.asked] == [(0.5, 1.0), (0.1, 0.2)]
    assert bench.published[0] == (
        f"twin/kr120/ik/ack/{ADA}",
        {
            "id": "3",
            "reach": "free",
            "joints": {"joint_a1": 0.25, "track": 1.5},
            "sentence": "can be reached",
            "between": [],
        },
    )


def test_what_cannot_be_solved_is_a_sentence(bench):
    bench.judge.verdict = PoseVerdict(
        Reach.CONTACT, "link_3 would touch wall", np.array([0.0, 1.0]), ("link_3", "wall")
    )
    bench.drag()
    bench.desk.poses.run()
    bench.judge.verdict = PoseVerdict(Reach.OUT, "out of reach by 7 mm")
    bench.drag()
    bench.desk.poses.run()
    bench.judge.error = SceneError("scene", "x", "y")
    bench.drag()
    bench.desk.poses.run()
    bench.twin = ()
    bench.drag()
    bench.desk.poses.run()
    answers = [answer for _, answer in bench.published]
    assert [answer["reach"] for answer in answers] == ["contact", "out", "unknown", "unknown"]
    assert answers[0]["between"] == ["link_3", "wall"] and answers[1]["joints"] is None
    assert "twin's pose is not known" in answers[3]["sentence"] and bench.refused == ["ik"]

"""`plan` and `review` on MQTT: what is shown, what is read, what is refused."""

from __future__ import annotations

import json
import math

import pytest
from construction_twin.msg import Plan
from geometry_msgs.msg import Point
from hypothesis import given
from hypothesis import strategies as st
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from construction_twin.core.errors import PayloadError
from construction_twin.link.remote_review import (
    MAX_REVIEW_BYTES,
    PlanBoard,
    RemoteReview,
    parse_review,
    review_answer,
    shown,
    thinned,
)
from construction_twin.ros.nodes.mqtt_review import plan_view

REVIEW = {"plan_id": "p1", "plan_hash": "ab" * 32, "verdict": "approved", "reviewer": "Anna"}


def payload(**changes) -> bytes:
    return json.dumps({key: value for key, value in (REVIEW | changes).items() if value is not ...}).encode()


def refusal(data: bytes, retained: bool = False) -> str:
    with pytest.raises(PayloadError) as caught:
        parse_review(data, retained)
    assert len(str(caught.value)) < 300
    return caught.value.reason


# -- review


def test_a_verdict_is_read_as_it_was_given():
    assert parse_review(payload(), False) == RemoteReview(**REVIEW)
    assert parse_review(payload(verdict="rejected", reason="too close to the wall"), False) == RemoteReview(
        "p1", "ab" * 32, "rejected", "Anna", "too close to the wall"
    )


@pytest.mark.parametrize("verdict, approves", [("approved", True), ("rejected", False)])
def test_only_one_word_approves(verdict, approves):
    assert parse_review(payload(verdict=verdict), False).approves is approves


def test_a_retained_verdict_is_refused_whatever_it_says():
    assert refusal(payload(), retained=True) == "retained"
    assert refusal(b"", retained=True) == "retained"


@pytest.mark.parametrize("key", list(REVIEW))
@pytest.mark.parametrize("value", [..., "", "  ", None, 1, True, ["p1"], {"a": 1}, "x" * 65, "a\nb", "a\x00b"])
def test_a_verdict_whose_fields_are_not_short_texts_is_refused(key, value):
    assert refusal(payload(**{key: value})) == "review"


@pytest.mark.parametrize(
    "verdict", ["approve", "Approved", "APPROVED", "yes", "true", "approved ", "refused", "withdrawn"]
)
def test_no_other_word_is_taken_for_a_verdict(verdict):
    assert refusal(payload(verdict=verdict)) == "review"


@pytest.mark.parametrize(
    "data",
    [
        b"", b"approved", b"[]", b"null", b"{}", b"\xff\xfe", b"[" * 2000, payload() + b"x", payload(extra=""),
        payload(reason="x" * 501), payload(reason=3), payload()[:-1],
        payload(reason="y" * MAX_REVIEW_BYTES), payload() + b" " * MAX_REVIEW_BYTES,
        b'{"verdict": "rejected", ' + payload()[1:],
    ],
)  # fmt: skip
def test_anything_else_on_review_is_refused(data):
    assert refusal(data) == "review"


@given(st.binary(max_size=200))
def test_no_bytes_do_more_to_review_than_be_refused(data):
    refusal(data)


json_values = (
    st.none() | st.booleans() | st.integers() | st.text(max_size=70) | st.lists(st.text(max_size=3), max_size=2)
)


@given(st.dictionaries(st.sampled_from([*REVIEW, "reason", "other"]), json_values))
def test_a_verdict_is_taken_only_with_every_field_a_text(document):
    try:
        review = parse_review(json.dumps(document).encode(), False)
    except PayloadError as error:
        assert error.reason == "review"
    else:
        assert {key: document[key] for key in REVIEW} == {key: getattr(review, key) for key in REVIEW}


def test_the_answer_names_what_it_answers():
    review = parse_review(payload(), False)
    assert json.loads(review_answer(review, False, "why")) == REVIEW | {"ok": False, "reason": "why"}
    unread = json.loads(review_answer(None, False, "no JSON"))
    assert unread == dict.fromkeys(REVIEW, "") | {"ok": False, "reason": "no JSON"}


# -- plan


def message(waypoints: int = 3, **changes) -> Plan:
    points = [JointTrajectoryPoint(positions=[0.1 * k, -0.2]) for k in range(waypoints)]
    plan = Plan(
        id="p1", hash="cafe", source="request", planner="RRTConnect", scene="beef", duration=1.5, planning_time=0.25,
        trajectory=JointTrajectory(joint_names=["joint_a1", "joint_a2"], points=points),
        tool_path=[Point(0.1 * k, 1.0, 0.123456789) for k in range(waypoints)],
    )  # fmt: skip
    plan.header.frame_id = "kr120/twin/base_link"
    plan.header.stamp.secs = 7
    for name, value in changes.items():
        setattr(plan, name, value)
    return plan


MEASURED = {
    "clearance": 0.031, "clearance_time": 0.5, "clearance_between": ["link_3", "wall"],
    "clearance_point": Point(1.0, 2.0, 3.0), "velocity_use": [0.5, 0.4], "acceleration_use": [0.9, 0.1], "jerk_use": [0.2, 0.3],
}  # fmt: skip


def document_of(plan: Plan, points: int = 200) -> dict:
    def refuse(name):
        raise AssertionError(f"{name} is no JSON")

    return json.loads(plan_view(plan).to_json(points), parse_constant=refuse)


def test_a_plan_is_shown_with_what_a_verdict_needs():
    shown_plan = document_of(message(**MEASURED))
    assert {key: shown_plan[key] for key in ("id", "hash", "source", "planner", "scene")} == {
        "id": "p1", "hash": "cafe", "source": "request", "planner": "RRTConnect", "scene": "beef"
    }  # fmt: skip
    assert (shown_plan["duration"], shown_plan["planning_time"], shown_plan["created_ns"]) == (1.5, 0.25, 7_000_000_000)
    assert (shown_plan["joints"], shown_plan["waypoints"]) == (["joint_a1", "joint_a2"], 3)
    assert (shown_plan["start"], shown_plan["goal"]) == ([0.0, -0.2], [0.2, -0.2])
    assert (shown_plan["frame"], shown_plan["tool_path"][1]) == ("kr120/twin/base_link", [0.1, 1.0, 0.1235])
    assert shown_plan["clearance"] == {
        "distance": 0.031, "time": 0.5, "between": ["link_3", "wall"], "point": [1.0, 2.0, 3.0]
    }  # fmt: skip
    assert shown_plan["use"] == {"velocity": [0.5, 0.4], "acceleration": [0.9, 0.1], "jerk": [0.2, 0.3]}


def test_what_was_not_measured_is_not_shown_as_a_measurement():
    shown_plan = document_of(message())
    assert shown_plan["clearance"] is None and shown_plan["use"]["velocity"] == []


def test_nothing_to_touch_is_not_shown_as_a_distance():
    shown_plan = document_of(message(**MEASURED | {"clearance": math.inf, "clearance_between": []}))
    assert shown_plan["clearance"]["distance"] is None


def test_a_plan_without_waypoints_can_be_shown():
    shown_plan = document_of(message(0))
    assert (shown_plan["start"], shown_plan["tool_path"], shown_plan["waypoints"]) == ([], [], 0)


def test_the_longest_plan_stays_far_below_the_broker_s_limit():
    plan = message(20_000, **MEASURED, source="s" * 5000, planner="p" * 5000)
    plan.tool_path = [Point(-1234.56789 - k, -1234.56789, -1234.56789) for k in range(20_000)]
    payload_bytes = plan_view(plan).to_json(1000)
    assert len(payload_bytes) < 50_000
    assert len(plan_view(plan).to_json(200)) < 12_000
    found = json.loads(payload_bytes)
    assert len(found["tool_path"]) == 1000 and found["waypoints"] == 20_000 and found["source"].endswith("...")


def test_a_text_is_cut_only_when_it_is_long():
    assert shown("x" * 200) == "x" * 200 and shown("x" * 201) == "x" * 197 + "..."


coordinates = st.floats(-10.0, 10.0)
paths = st.lists(st.tuples(coordinates, coordinates, coordinates), max_size=60)


@given(paths, st.integers(2, 20))
def test_a_thinned_path_keeps_its_ends_and_its_order(path, points):
    kept, deviation = thinned(path, points)
    assert len(kept) == min(len(path), points)
    if path:
        assert (kept[0], kept[-1]) == (path[0], path[-1])
    rest = iter(path)
    assert all(point in rest for point in kept)
    assert deviation >= 0.0 and (len(path) > points or deviation == 0.0)


@pytest.mark.parametrize("points, deviation", [(2, 0.5), (3, 0.0), (5, 0.0)])
def test_what_thinning_loses_is_said(points, deviation):
    corner = [(0.0, 0.0, 0.0), (0.25, 0.25, 0.0), (0.5, 0.5, 0.0), (0.75, 0.25, 0.0), (1.0, 0.0, 0.0)]
    assert thinned(corner, points)[1] == pytest.approx(deviation, abs=1e-12)


def test_a_path_that_returns_to_its_start_is_measured_too():
    there_and_back = [(0.0, 0.0, 0.0), (0.3, 0.4, 0.0), (0.0, 0.0, 0.0)]
    assert thinned(there_and_back, 2)[1] == pytest.approx(0.5)


# -- board


def test_a_plan_lies_on_the_board_until_it_is_decided():
    board = PlanBoard()
    assert board.payload == b""
    board.on_plan("p1", b"one")
    assert board.payload == b"one"
    board.on_verdict("another")
    assert board.payload == b"one"
    board.on_verdict("p1")
    assert board.payload == b""


def test_a_newer_plan_takes_its_place():
    board = PlanBoard()
    board.on_plan("p1", b"one")
    board.on_plan("p2", b"two")
    board.on_verdict("p1")
    assert board.payload == b"two"


def test_a_verdict_that_arrives_before_its_plan_counts():
    """After a restart of the node the latched plan and the latched verdict come in any order."""
    board = PlanBoard()
    board.on_verdict("p1")
    board.on_plan("p1", b"one")
    assert board.payload == b""


def test_a_new_session_takes_the_plan_away_for_good():
    board = PlanBoard()
    board.on_plan("p1", b"one")
    board.restart()
    board.on_plan("p1", b"one")
    assert board.payload == b""
    board.on_plan("p2", b"two")
    assert board.payload == b"two"

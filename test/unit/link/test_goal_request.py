"""`plan_request` and `ik` on MQTT: what is read, what is refused, and how many are taken."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.errors import PayloadError
from construction_twin.core.freshness import Moment
from construction_twin.link.goal_request import (
    KINDS,
    MAX_BYTES,
    GoalRequest,
    IkRequest,
    parse_ik,
    parse_plan_request,
)
from construction_twin.link.remote_trajectory import Joints
from construction_twin.mqtt.json_fields import read_document

JOINTS = Joints(("joint_a1", "track"), (False, True))
POSE = {"position": [1.5, 0.0, 2], "orientation": [0.0, 0.0, 0.0, 1.0]}
VALUES = {"track": 2.0, "joint_a1": 0.5}
MOMENT = Moment("c0ffee00", 5_000_000)
REQUESTS = {
    "joints": {"joints": VALUES, "speed_scale": 0.5},
    "pose": POSE | {"configuration": "front up positive", "acceleration_scale": 0.25},
    "line": POSE | {"speed": 0.1},
    "way_back": {},
    "work_task": {"task": "2O2Fr$t4X7Zf8NOew3FLOH"},
}


def asked(kind: str, **changes) -> dict:
    return {"id": "7", "kind": kind, "moment": str(MOMENT)} | REQUESTS[kind] | changes


def refused(document: dict, parse=parse_plan_request) -> str:
    with pytest.raises(PayloadError) as caught:
        parse(document, JOINTS)
    return caught.value.reason


def test_every_kind_is_read_with_all_that_belongs_to_it():
    assert set(REQUESTS) == set(KINDS)
    read = {kind: parse_plan_request(asked(kind), JOINTS) for kind in KINDS}
    assert read["joints"] == GoalRequest("joints", "7", MOMENT, (0.5, 2.0), speed_scale=0.5)
    assert read["pose"] == GoalRequest(
        "pose", "7", MOMENT, (), (1.5, 0.0, 2.0), (0.0, 0.0, 0.0, 1.0), "front up positive", acceleration_scale=0.25
    )
    assert read["line"] == GoalRequest("line", "7", MOMENT, (), (1.5, 0.0, 2.0), (0.0, 0.0, 0.0, 1.0), speed=0.1)
    assert read["way_back"] == GoalRequest("way_back", "7", MOMENT)
    assert read["work_task"].task == "2O2Fr$t4X7Zf8NOew3FLOH"
    assert parse_plan_request({"id": "8", "kind": "work_task", "moment": str(MOMENT)}, JOINTS).task == "", (
        "the next one"
    )


@pytest.mark.parametrize(
    "document, reason",
    [
        (asked("joints") | {"kind": "dance"}, "format"),
        (asked("joints") | {"kind": ["joints"]}, "format"),
        ({"kind": "joints", "joints": VALUES}, "format"),
        (asked("joints") | {"id": ""}, "format"),
        (asked("joints", id="x" * 65), "format"),
        (asked("joints", task="1"), "format"),
        (asked("joints", joints=[0.5, 2.0]), "joints"),
        (asked("joints", joints={"joint_a1": 0.5}), "joints"),
        (asked("joints", joints=VALUES | {"joint_a2": 0.0}), "joints"),
        (asked("joints", joints=VALUES | {"track": True}), "values"),
        (asked("joints", joints=VALUES | {"track": math.inf}), "values"),
        (asked("joints", speed_scale=1.1), "values"),
        (asked("pose", position=[0.0, 0.0]), "values"),
        (asked("pose", position="here"), "format"),
        (asked("pose", orientation=[0.0, 0.0, 0.0, 1.1]), "values"),
        (asked("pose", orientation=[0.0, 0.0, 0.0, math.nan]), "values"),
        (asked("pose", speed=0.1), "format"),
        (asked("line", speed=-0.1), "values"),
        (asked("way_back", task="1"), "format"),
        (asked("work_task", task=7), "format"),
        (asked("way_back", moment=""), "moment"),
        (asked("way_back", moment=5.0), "moment"),
        ({"id": "7", "kind": "way_back"}, "moment"),
    ],
)
def test_what_is_not_exactly_so_is_refused(document, reason):
    assert refused(document) == reason


def test_a_pose_to_solve_has_a_seed_or_none():
    document = {"id": "3"} | POSE
    assert parse_ik(document, JOINTS) == IkRequest("3", (1.5, 0.0, 2.0), (0.0, 0.0, 0.0, 1.0))
    assert parse_ik(document | {"seed": VALUES}, JOINTS).seed == (0.5, 2.0)
    assert refused(document | {"seed": [0.5, 2.0]}, parse_ik) == "joints"
    assert refused(document | {"kind": "pose"}, parse_ik) == "format"
    assert refused({"id": "3", "position": [0, 0, 0]}, parse_ik) == "format"


def test_a_quaternion_with_three_digits_becomes_a_unit_one():
    read = parse_ik({"id": "3", "position": [0, 0, 0], "orientation": [0.707, 0.0, 0.0, 0.707]}, JOINTS)
    assert math.hypot(*read.orientation) == pytest.approx(1.0, abs=1e-15)


def test_retained_too_long_and_broken_messages_are_refused():
    payload = json.dumps(asked("joints")).encode()
    assert read_document(payload, False, "plan_request", MAX_BYTES) == asked("joints")
    for wrong, retained, reason in (
        (payload, True, "retained"),
        (b" " * (MAX_BYTES + 1), False, "size"),
        (b"[]", False, "format"),
        (b'{"id": "1", "id": "2"}', False, "format"),
        (b"\xff", False, "format"),
    ):
        with pytest.raises(PayloadError) as caught:
            read_document(wrong, retained, "plan_request", MAX_BYTES)
        assert caught.value.reason == reason


#: What JSON can hold, with the keys and words of requests mixed in.
_words = st.sampled_from(
    ["id", "kind", "moment", "joints", "position", "orientation", "seed", "task", "speed", "track", "joint_a1", *KINDS]
)
_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=80) | _words,
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=8) | _words, inner, max_size=5),
    max_leaves=12,
)


@given(document=st.dictionaries(st.text(max_size=8) | _words, _values, max_size=7), kind=st.sampled_from(sorted(KINDS)))
def test_whatever_comes_is_a_request_or_refused_with_a_short_sentence(document, kind):
    for parse, candidate in (
        (parse_plan_request, document),
        (parse_plan_request, asked(kind) | document),
        (parse_ik, {"id": "1"} | POSE | document),
    ):
        try:
            read = parse(candidate, JOINTS)
        except PayloadError as error:
            assert len(str(error)) < 500 and str(error).isprintable()
            continue
        numbers = [*read.position, *read.orientation, *getattr(read, "joints", ()), *getattr(read, "seed", ())]
        assert all(math.isfinite(value) for value in numbers) and len(read.id) <= 64


@given(payload=st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(payload):
    try:
        assert isinstance(read_document(payload, False, "ik", MAX_BYTES), dict)
    except PayloadError as error:
        assert error.reason == "format"

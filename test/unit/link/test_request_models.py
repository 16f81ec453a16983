"""What people ask for by MQTT: what is read, and that anything else is refused."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.errors import PayloadError
from construction_twin.core.freshness import Moment
from construction_twin.link.requests import (
    GOALS,
    LEAST_SPEED,
    Acknowledgement,
    AnswerRequest,
    GoalRequest,
    Joints,
    LowerSpeed,
    NamelessVerdict,
    Override,
    RaiseSpeed,
    ReviewRequest,
    VerdictMessage,
    read,
    read_document,
    read_goal,
)
from construction_twin.mqtt.requests import OVERRIDE, PLAN_REQUEST, REVIEW, RequestKind

MAX_BYTES = PLAN_REQUEST.limit
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


def read_message(model, kind: RequestKind, data: bytes, retained: bool):
    return read(model, read_document(data, retained, kind.name, kind.limit), kind.name)


def asked(kind: str, **changes) -> dict:
    return {"id": "7", "kind": kind, "moment": str(MOMENT)} | REQUESTS[kind] | changes


def refused(document: dict) -> str:
    with pytest.raises(PayloadError) as caught:
        read_goal(document, JOINTS)
    return caught.value.reason


def test_every_kind_is_read_with_all_that_belongs_to_it():
    assert set(REQUESTS) == set(GOALS)
    read = {kind: read_goal(asked(kind), JOINTS) for kind in GOALS}
    assert read["joints"] == GoalRequest("joints", "7", MOMENT, (0.5, 2.0), speed_scale=0.5)
    assert read["pose"] == GoalRequest(
        "pose", "7", MOMENT, (), (1.5, 0.0, 2.0), (0.0, 0.0, 0.0, 1.0), "front up positive", acceleration_scale=0.25
    )
    assert read["line"] == GoalRequest("line", "7", MOMENT, (), (1.5, 0.0, 2.0), (0.0, 0.0, 0.0, 1.0), speed=0.1)
    assert read["way_back"] == GoalRequest("way_back", "7", MOMENT)
    assert read["work_task"].task == "2O2Fr$t4X7Zf8NOew3FLOH"
    assert read_goal({"id": "8", "kind": "work_task", "moment": str(MOMENT)}, JOINTS).task == "", "the next one"


@pytest.mark.parametrize(
    "document, reason",
    [
        (asked("joints") | {"kind": "dance"}, "format"),
        (asked("joints") | {"kind": ["joints"]}, "format"),
        ({"kind": "joints", "joints": VALUES, "moment": str(MOMENT)}, "format"),
        (asked("joints") | {"id": ""}, "format"),
        (asked("joints", id="x" * 65), "format"),
        (asked("joints", task="1"), "format"),
        (asked("joints", joints=[0.5, 2.0]), "format"),
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


def test_a_quaternion_with_three_digits_becomes_a_unit_one():
    read = read_goal(asked("pose", orientation=[0.707, 0.0, 0.0, 0.707]), JOINTS)
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


# -- verdicts

ADA = "kr120-reviewer-ada"
VERDICT = {"plan_id": "p1", "plan_hash": "ab" * 32, "verdict": "approved", "reviewer": "Anna", "moment": str(MOMENT)}


def payload(**changes) -> bytes:
    return json.dumps({key: value for key, value in (VERDICT | changes).items() if value is not ...}).encode()


def review(data: bytes, account: str = "", retained: bool = False) -> ReviewRequest:
    return read_message(VerdictMessage if account else NamelessVerdict, REVIEW, data, retained).review_by(account)


def refusal(data: bytes, account: str = "", retained: bool = False) -> str:
    with pytest.raises(PayloadError) as caught:
        review(data, account, retained)
    assert len(str(caught.value)) < 500
    return caught.value.reason


def test_a_verdict_is_read_as_it_was_given():
    assert review(payload()) == ReviewRequest(**VERDICT)
    rejected = review(payload(verdict="rejected", reason="too close to the wall", moment=...))
    assert rejected == ReviewRequest("p1", "ab" * 32, "rejected", "Anna", "too close to the wall")
    assert (review(payload()).approve, rejected.approve) == (True, False)


@pytest.mark.parametrize("account", ["", ADA])
@pytest.mark.parametrize(
    "moment, reason", [(..., "moment"), ("", "moment"), ("c0ffee00", "moment"), ("x" * 65, "format"), (5.0, "format")]
)
def test_an_approval_that_does_not_say_what_its_screen_had_shown_is_refused(account, moment, reason):
    assert refusal(payload(moment=moment), account) == reason


@pytest.mark.parametrize("moment", [..., "", "of an old screen", str(MOMENT)])
def test_a_rejection_needs_no_moment(moment):
    assert not review(payload(verdict="rejected", moment=moment)).approve


def test_a_retained_verdict_is_refused_whatever_it_says():
    assert refusal(payload(), retained=True) == refusal(b"", retained=True) == "retained"


@pytest.mark.parametrize("key", ["plan_id", "plan_hash", "verdict", "reviewer"])
@pytest.mark.parametrize(
    "value", [..., "", "  ", None, 1, True, ["p1"], {"a": 1}, "x" * 65, "a\nb", "a\x00b", "\ud800"]
)
def test_a_verdict_whose_fields_are_not_short_texts_is_refused(key, value):
    assert refusal(payload(**{key: value})) in ("format", "values")


@pytest.mark.parametrize("verdict", ["approve", "Approved", "APPROVED", "yes", "true", "approved ", "refused"])
def test_no_other_word_is_taken_for_a_verdict(verdict):
    assert refusal(payload(verdict=verdict)) == "format"


@pytest.mark.parametrize(
    "data",
    [
        b"", b"approved", b"[]", b"null", b"{}", b"\xff\xfe", b"[" * 2000, payload() + b"x", payload(extra=""),
        payload(reason="x" * 501), payload(reason=3), payload()[:-1], b'{"verdict": "rejected", ' + payload()[1:],
    ],
)  # fmt: skip
def test_anything_else_on_review_is_refused(data):
    assert refusal(data) == "format"


@pytest.mark.parametrize("claims", [..., "Bob", ADA, "kr120-bridge"])
def test_the_name_on_record_is_the_topic_s_whatever_the_message_says(claims):
    found = review(payload(reviewer=claims, reason="fine"), ADA)
    assert (found.reviewer, found.account) == (ADA, ADA)
    said = f"by MQTT, which says it is {claims!r}: fine" if claims in ("Bob", "kr120-bridge") else "by MQTT: fine"
    assert found.recorded_reason == said and review(payload()).recorded_reason == "by MQTT"


@pytest.mark.parametrize(
    "changes, ok",
    [
        ({}, True), ({"rehearsal_hash": ""}, True), ({"rehearsal_hash": ...}, False), ({"reason": " "}, False),
        ({"reason": ...}, False), ({"verdict": "rejected"}, False), ({"moment": ...}, False),
    ],
)  # fmt: skip
def test_an_override_is_an_approval_with_a_reason_and_what_was_seen_of_the_rehearsal(changes, ok):
    data = payload(**{"reason": "seen it", "rehearsal_hash": "d1"} | changes)
    if not ok:
        with pytest.raises(PayloadError):
            read_message(Override, OVERRIDE, data, False)
        return
    found = read_message(Override, OVERRIDE, data, False).review_by(ADA)
    assert found.override_rehearsal and found.approve and found.rehearsal_hash == ("d1" if not changes else "")
    assert refusal(data, ADA) == "format"


# -- answers, messages that were read, speed limits

ANSWER = {"id": "1", "task": "t", "question": "Where\nis it?", "answer": "in the rack", "moment": str(MOMENT)}
LIMIT = {"id": "1", "limit": 0.3, "moment": str(MOMENT)}


def test_each_is_read():
    assert read(AnswerRequest, ANSWER, "answer").question == ANSWER["question"]
    assert read(Acknowledgement, {"id": "1", "message": "m"}, "acknowledge").message == "m"
    assert read(RaiseSpeed, LIMIT, "speed") == RaiseSpeed(id="1", limit=0.3, moment=str(MOMENT))
    assert read(LowerSpeed, {"id": "1", "limit": 1}, "speed") == LowerSpeed(id="1", limit=1.0)


@pytest.mark.parametrize("moment", [None, 5, [], "x" * 65, ...])
def test_a_moment_that_is_none_counts_to_raise_alone(moment):
    said = {key: value for key, value in (LIMIT | {"moment": moment}).items() if value is not ...}
    assert read(LowerSpeed, said, "speed").moment == ""
    with pytest.raises(PayloadError):
        read(RaiseSpeed, said, "speed")


@pytest.mark.parametrize(
    "model, good, changes",
    [
        *((LowerSpeed, LIMIT, {"limit": limit}) for limit in (0, LEAST_SPEED - 0.001, 1.001, math.nan, "0.3", True, ...)),
        *((LowerSpeed, LIMIT, changes) for changes in ({"id": ""}, {"id": 3}, {"id": ...}, {"more": 1})),
        *((AnswerRequest, ANSWER, {key: value}) for key in ANSWER for value in (..., "", 3, None)),
        *((AnswerRequest, ANSWER, {"question": "x" * 2001}), (AnswerRequest, ANSWER, {"answer": "a\nb"})),
        *((Acknowledgement, {"id": "1", "message": "m"}, {key: value}) for key in ("id", "message") for value in (..., "", 3)),
    ],
)  # fmt: skip
def test_what_is_not_as_described_is_refused(model, good, changes):
    with pytest.raises(PayloadError):
        read(model, {key: value for key, value in (good | changes).items() if value is not ...}, "it")


# -- whatever comes

#: What JSON can hold, with the keys and words of requests mixed in.
_words = st.sampled_from(
    ["id", "kind", "moment", "joints", "position", "orientation", "task", "speed", "track", "joint_a1", *GOALS]
)
_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=80) | _words,
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=8) | _words, inner, max_size=5),
    max_leaves=12,
)


@given(document=st.dictionaries(st.text(max_size=8) | _words, _values, max_size=7), kind=st.sampled_from(sorted(GOALS)))
def test_whatever_comes_is_a_request_or_refused_with_a_short_sentence(document, kind):
    for candidate in (document, asked(kind) | document):
        try:
            found = read_goal(candidate, JOINTS)
        except PayloadError as error:
            assert len(str(error)) < 500 and str(error).isprintable()
            continue
        numbers = [
            *found.position,
            *found.orientation,
            *found.joints,
        ]
        assert all(math.isfinite(value) for value in numbers) and len(found.id) <= 64


@given(payload=st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(payload):
    try:
        assert isinstance(read_document(payload, False, "plan_request", MAX_BYTES), dict)
    except PayloadError as error:
        assert error.reason == "format"

"""`stop`, `pause` and `resume` by MQTT: what is read, what is refused, and how often an account is answered."""

from __future__ import annotations

import json
import runpy

import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.errors import PayloadError
from construction_twin.mqtt import interventions, requests
from construction_twin.mqtt.interventions import (
    MAX_BYTES,
    PAUSE,
    RESUME,
    STOP,
    Intervention,
    parse_intervention,
)
from construction_twin.mqtt.messages import account_of
from construction_twin.mqtt.requests import RequestKind


def refusal(verb: str, payload: bytes, retained: bool = False) -> str:
    with pytest.raises(PayloadError) as caught:
        parse_intervention(verb, "ada", payload, retained)
    assert len(str(caught.value)) < 300
    return caught.value.reason


def test_one_line_of_pressed_is_a_further_verb(monkeypatch):
    park = RequestKind("park", "pause", "park/{}", "pause/ack", requests.PAUSE.answer)
    monkeypatch.setattr(requests, "PRESSED", (*requests.PRESSED, park))
    read = runpy.run_path(interventions.__file__)["parse_intervention"]
    assert read("park", "ada", b'{"id": "7"}', False).verb == "park"


MOMENT = "c0ffee00-5000"


@pytest.mark.parametrize("verb", [STOP, PAUSE])
@pytest.mark.parametrize("moment", [{}, {"moment": MOMENT}, {"moment": "of an old screen"}, {"moment": None}])
def test_a_stop_and_a_pause_need_an_id_alone_and_are_never_too_old(verb, moment):
    taken = parse_intervention(verb, "ada", json.dumps({"id": "a-1"} | moment).encode(), False)
    assert taken == Intervention(verb, "ada", "a-1") and taken.moment == ""


def test_a_resume_repeats_what_its_screen_had_shown():
    taken = parse_intervention(RESUME, "ada", json.dumps({"id": "a-1", "moment": MOMENT}).encode(), False)
    assert taken == Intervention(RESUME, "ada", "a-1") and taken.moment == MOMENT


@pytest.mark.parametrize("moment", [{}, {"moment": ""}, {"moment": 5}, {"moment": None}, {"moment": "c0ffee00"}])
def test_a_resume_that_does_not_is_refused(moment):
    assert refusal(RESUME, json.dumps({"id": "a-1"} | moment).encode()) == "moment"


def test_the_same_resume_with_a_newer_moment_is_the_same():
    """Or what was taken down once could be sent again, and again."""
    first, again = (Intervention(RESUME, "ada", "1", moment) for moment in ("c0ffee00-1", "c0ffee00-2"))
    assert first == again


@pytest.mark.parametrize("verb", [STOP, PAUSE, RESUME])
@pytest.mark.parametrize(
    "payload",
    [
        b"", b"stop", b"{}", b"[]", b"null", b'{"id": 1}', b'{"id": ""}', b'{"id": "  "}', b'{"id": "a\\nb"}', b'{"id": null}',
        b'{"id": "1", "account": "bob"}', b'{"id": "1", "id": "2"}', b'{"verb": "stop"}', b"\xff\xfe", b"[" * 200,
        json.dumps({"id": "x" * 65}).encode(), b'{"id": "1"}' + b" " * MAX_BYTES,
    ],
)  # fmt: skip
def test_anything_else_is_refused_under_the_verb(verb, payload):
    assert refusal(verb, payload) == verb


@pytest.mark.parametrize("payload", [b'{"id": "1"}', b""])
def test_a_retained_one_is_refused_because_its_age_is_unknown(payload):
    assert refusal(RESUME, payload, retained=True) == "retained"


@given(st.binary(max_size=MAX_BYTES + 10))
def test_no_bytes_do_more_than_be_refused(payload):
    assert refusal(STOP, payload) == STOP


@given(st.dictionaries(st.sampled_from(["id", "session"]), st.none() | st.integers() | st.text(max_size=70)))
def test_what_is_taken_is_one_short_line(document):
    try:
        taken = parse_intervention(STOP, "ada", json.dumps(document).encode(), False)
    except PayloadError as error:
        assert error.reason == STOP
    else:
        assert document == {"id": taken.id} and taken.id.isprintable() and 0 < len(taken.id) <= 64


@pytest.mark.parametrize("verb", ["stop", "pause", "resume", "review"])
def test_the_account_is_the_last_level_and_an_answer_is_nobody_s(verb):
    assert account_of(f"twin/kr120/{verb}/kr120-reviewer-ada") == "kr120-reviewer-ada"
    assert account_of(f"twin/kr120/{verb}/ack") == ""


@pytest.mark.parametrize("name", ["", "a b", "ä", "a" * 101, "a.b", "$x", "a\n"])
def test_a_last_level_that_no_account_can_have_is_refused(name):
    with pytest.raises(PayloadError) as caught:
        account_of(f"twin/kr120/stop/{name}")
    assert caught.value.reason == "sender" and len(str(caught.value)) < 300

"""`stop`, `pause` and `resume` by MQTT: what is read, what is refused, and how often an account is answered."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.errors import PayloadError
from construction_twin.link.requests import ButtonPress, StampedButtonPress, read, read_document
from construction_twin.mqtt import requests
from construction_twin.mqtt.messages import Intervention, account_of, parse_intervention


def refusal(payload: bytes, retained: bool = False) -> str:
    with pytest.raises(PayloadError) as caught:
        parse_intervention("ada", payload, retained)
    assert len(str(caught.value)) < 300
    return caught.value.reason


MOMENT = "c0ffee00-5000"


@pytest.mark.parametrize("moment", [{}, {"moment": MOMENT}, {"moment": "of an old screen"}, {"moment": None}])
def test_a_stop_needs_an_id_alone_and_is_never_too_old(moment):
    document = {"id": "a-1"} | moment
    assert parse_intervention("ada", json.dumps(document).encode(), False) == Intervention("ada", "a-1")
    assert read(ButtonPress, document, "stop").moment == ""


def test_what_starts_something_repeats_what_its_screen_had_shown():
    assert read(StampedButtonPress, {"id": "a-1", "moment": MOMENT}, "resume").moment == MOMENT
    for moment in ({}, {"moment": ""}, {"moment": 5}, {"moment": None}, {"moment": "c0ffee00"}):
        with pytest.raises(PayloadError) as caught:
            read(StampedButtonPress, {"id": "a-1"} | moment, "resume")
        assert caught.value.reason == "moment"


@pytest.mark.parametrize(
    "payload",
    [
        b"", b"stop", b"{}", b"[]", b"null", b'{"id": 1}', b'{"id": ""}', b'{"id": "  "}', b'{"id": "a\\nb"}', b'{"id": null}',
        b'{"id": "1", "account": "bob"}', b'{"id": "1", "id": "2"}', b'{"verb": "stop"}', b"\xff\xfe", b"[" * 200,
        json.dumps({"id": "x" * 65}).encode(), b'{"id": "1"}' + b" " * requests.STOP.limit,
    ],
)  # fmt: skip
def test_anything_else_is_refused_by_the_gateway_and_by_the_bridge_s_side(payload):
    assert refusal(payload) == "stop"
    with pytest.raises(PayloadError):
        read(ButtonPress, read_document(payload, False, "stop", requests.STOP.limit), "stop")


def test_a_retained_one_is_refused_because_its_age_is_unknown():
    assert refusal(b'{"id": "1"}', retained=True) == "retained"


@given(st.binary(max_size=requests.STOP.limit + 10))
def test_no_bytes_do_more_than_be_refused(payload):
    assert refusal(payload) == "stop"


@given(st.dictionaries(st.sampled_from(["id", "session"]), st.none() | st.integers() | st.text(max_size=70)))
def test_what_is_taken_is_one_short_line(document):
    try:
        taken = parse_intervention("ada", json.dumps(document).encode(), False)
    except PayloadError as error:
        assert error.reason == "stop"
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

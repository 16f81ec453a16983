"""Topics, user properties, control and status messages: what is accepted, and that everything else is refused."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.errors import ConfigurationError, PayloadError
from construction_twin.mqtt.messages import (
    MAX_CONTROL_BYTES,
    CommandProperties,
    Control,
    StateProperties,
    Topics,
    message_number,
    parse_control,
    read_command_properties,
    read_state_properties,
)
from construction_twin.mqtt.requests import NAMELESS_REVIEW

COMMAND = [("session", "a1"), ("seq", "7"), ("stamp", "1700000000000000000")]
STATE = [("seq", "7"), ("stamp", "0"), ("command_stamp", "1700000000000000000")]


def control(**changes) -> bytes:
    return json.dumps({"id": "1", "session": "s", "verb": "arm", "value": "hash"} | changes).encode()


def test_topics_are_those_of_the_design():
    topics = Topics("twin", "kr120")
    assert (topics.command, topics.state, topics.status) == (
        "twin/kr120/command",
        "twin/kr120/state",
        "twin/kr120/status",
    )
    assert topics.bridge_status == "twin/kr120/bridge/status"
    assert (topics.control, topics.control_ack) == ("twin/kr120/control", "twin/kr120/control/ack")
    assert (topics.plan, topics.of(NAMELESS_REVIEW), topics.ack_of(NAMELESS_REVIEW)) == (
        "twin/kr120/plan",
        "twin/kr120/review",
        "twin/kr120/review/ack",
    )


@pytest.mark.parametrize("level", ["", "a/b", "+", "#", "a b", "ä", "a\n", "$SYS"])
def test_a_name_that_is_no_topic_level_is_refused(level):
    with pytest.raises(ConfigurationError, match="prefix"):
        Topics(level, "kr120")
    with pytest.raises(ConfigurationError, match="robot"):
        Topics("twin", level)


sequences = st.integers(0, 4_294_967_295_999_999_999)


@given(st.from_regex(r"[A-Za-z0-9_-]{1,64}", fullmatch=True), sequences, sequences)
def test_command_properties_survive_the_wire(session, seq, stamp):
    properties = CommandProperties(session, seq, stamp)
    assert read_command_properties(properties.pairs()) == properties


@given(sequences, sequences, sequences)
def test_state_properties_survive_the_wire(seq, stamp, command_stamp):
    properties = StateProperties(seq, stamp, command_stamp)
    assert read_state_properties(properties.pairs()) == properties


@pytest.mark.parametrize("text, number", [("0", 0), ("007", 7), ("9" * 19, 10**19 - 1)])
def test_a_control_message_s_id_may_be_a_number(text, number):
    assert message_number(text) == number


@pytest.mark.parametrize("text", ["", "-1", "+1", "1.0", " 1", "1\n", "0x1", "1e3", "٣", "1_000", "9" * 20, "cafe"])
def test_any_other_id_is_none(text):
    assert message_number(text) is None


def test_properties_may_come_in_any_order():
    assert read_command_properties(COMMAND[::-1]) == CommandProperties("a1", 7, 1_700_000_000_000_000_000)


@pytest.mark.parametrize(
    "pairs",
    [
        [],
        COMMAND[:2],
        COMMAND + [("extra", "1")],
        COMMAND + [("seq", "7")],  # the same name twice
        [("Session", "a1")] + COMMAND[1:],
        [("session", "")] + COMMAND[1:],
        [("session", "a b")] + COMMAND[1:],
        [("session", "a1\n")] + COMMAND[1:],
        [("session", "x" * 65)] + COMMAND[1:],
    ],
)
def test_command_properties_that_are_not_exactly_those_named_are_refused(pairs):
    with pytest.raises(PayloadError) as caught:
        read_command_properties(pairs)
    assert caught.value.reason == "properties"


@pytest.mark.parametrize("text", ["", "-1", "+1", "1.0", " 1", "1 ", "0x1", "1e3", "nan", "٣", "1_000", "9" * 5000])
@pytest.mark.parametrize("index", [0, 1, 2])
def test_a_number_that_is_not_plain_digits_is_refused(index, text):
    pairs = list(STATE)
    pairs[index] = (pairs[index][0], text)
    with pytest.raises(PayloadError) as caught:
        read_state_properties(pairs)
    assert caught.value.reason == "properties" and len(str(caught.value)) < 200


@pytest.mark.parametrize("text", ["4294967296000000000", "9" * 19, "9" * 20])
def test_a_number_beyond_the_end_of_ros_time_is_refused(text):
    with pytest.raises(PayloadError):
        read_state_properties(STATE[:2] + [("command_stamp", text)])


def test_control_survives_the_wire():
    message = Control("1", "s", "arm", {"any": [1, None]})
    assert parse_control(message.to_json()) == message
    assert message.to_json() == b'{"id": "1", "session": "s", "verb": "arm", "value": {"any": [1, null]}}'
    assert Control("2", "s", "speed_limit", 0.1 + 0.2).to_json().endswith(b'"value": 0.30000000000000004}')


def test_control_s_value_may_be_left_out():
    assert parse_control(b'{"id": "1", "session": "s", "verb": "stop"}') == Control("1", "s", "stop", None)


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"arm",
        b"[]",
        b"null",
        b"\xff\xfe",
        b"{}",
        b'{"id": "1", "session": "s"}',
        control(extra=1),
        control(id=1),
        control(session=None),
        control(verb=["arm"]),
        control(verb="x" * 65),
        control(session="s1\n2026-11-21 rsi_gateway INFO all is well"),
        control(id="\x1b[2J"),
        control(value="x" * MAX_CONTROL_BYTES),
        b"[" * 2000,
        b'{"verb": "stop", ' + control()[1:],
        b'{"id": "1", "session": "s", "verb": "arm", "value": ' + b"9" * 1900 + b"",
    ],
)
def test_anything_else_on_control_is_refused(payload):
    with pytest.raises(PayloadError) as caught:
        parse_control(payload)
    assert caught.value.reason == "control" and len(str(caught.value)) < 400


@given(st.binary(max_size=100))
def test_no_bytes_do_more_to_control_than_be_refused(payload):
    with pytest.raises(PayloadError):
        parse_control(payload)

"""The messages that a person must not miss: which lines become one, when they end, and who has read them."""

from __future__ import annotations

import itertools

import pytest

from construction_twin.core.errors import ConfigurationError, RequestRefused
from construction_twin.core.reports import SpeedChange
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.extensions.console.message_history import MOST, ORDINARY, MessageHistory
from construction_twin.views.startup import Word
from construction_twin.views.status_line import TABLE, Level, ReportsNow, status_lines

ARMED, IN_SYNC, IDLE = Word("ARMED", ""), Word("IN_SYNC", ""), Word("IDLE", "")


def history(text: bytes = b"") -> MessageHistory:
    numbers = itertools.count(text.count(b'"id":'))
    return MessageHistory(lambda: f"m{next(numbers)}", text)


def lines(**changes):
    return status_lines(ReportsNow(**{"link": ARMED, "sync": IN_SYNC, "execution": IDLE} | changes))


STOPPED = lines(link=Word("NEEDS_RESET", "asked by account bob"))


def test_what_a_person_must_mend_is_a_message_from_when_it_began_until_it_ends():
    made = history()
    made.on_lines(lines(), 10.0)
    made.on_lines(STOPPED, 11.0)
    assert made.messages == ()
    made.on_lines(STOPPED, 12.0)
    (message,) = made.messages
    assert (message.at, message.until, message.line.topic, message.line.state) == (11.0, None, "link", "NEEDS_RESET")
    assert "asked by account bob" in message.line.sentence
    before = made.messages
    made.on_lines(STOPPED, 13.0)
    assert made.messages is before, "nothing is told again"
    made.on_lines(lines(), 14.0)
    assert [message.until for message in made.messages] == [14.0]


def test_what_passes_at_once_is_none():
    made = history()
    for at, shown in ((0.0, STOPPED), (0.5, lines()), (1.5, STOPPED), (2.4, lines())):
        made.on_lines(shown, at)
    assert made.messages == ()


def test_another_cause_is_another_message():
    made = history()
    for at, joint in ((0.0, "A3"), (1.0, "A3"), (2.0, "A1"), (3.0, "A1")):
        made.on_lines(lines(sync=Word("HOLDING", ""), cause=f"{joint} differs"), at)
    assert [(each.line.sentence, each.at, each.until) for each in made.messages if each.line.topic == "cause"] == [
        ("The arm holds: A3 differs", 0.0, 2.0), ("The arm holds: A1 differs", 2.0, None),
    ]  # fmt: skip


def test_a_verdict_or_a_task_that_is_waited_for_is_no_message():
    assert {key for key in ORDINARY} <= set(TABLE) | {("execution", "REVIEW")}
    assert all(TABLE[key].level is Level.PERSON for key in ORDINARY)
    made = history()
    for at in (0.0, 5.0):
        made.on_lines(lines(plan="p1"), at)
    assert made.messages == ()


def test_who_has_read_a_message_is_known_once():
    made = history()
    for at in (0.0, 1.0):
        made.on_lines(STOPPED, at)
    assert "acknowledged by ada" in made.acknowledge("m0", "ada", 7.0)
    assert (made.messages[0].acknowledged_by, made.messages[0].acknowledged_at) == ("ada", 7.0)
    with pytest.raises(RequestRefused, match="ada has acknowledged"):
        made.acknowledge("m0", "bob", 8.0)
    with pytest.raises(RequestRefused, match="no message 'm9'"):
        made.acknowledge("m9", "bob", 8.0)
    made.on_lines(lines(), 9.0)
    assert made.messages[0].acknowledged_by == "ada" and made.messages[0].until == 9.0


def test_what_people_did_stands_among_them_and_is_told_once():
    made = history()
    for _ in range(2):
        made.on_act("reset", 5.0, Sentence("{person} asked for a reset", person="ada"))
    (message,) = made.messages
    assert message.line.sentence == "ada asked for a reset"
    assert (message.at, message.until) == (5.0, 5.0)
    assert message.line.said == {
        "ada asked for a reset": {"template": "{person} asked for a reset", "values": {"person": "ada"}}
    }


def test_the_newest_are_kept():
    made = history()
    for number in range(MOST + 5):
        made.on_act("reset", float(number), "ada asked for a reset")
    assert len(made.messages) == MOST and made.messages[-1].at == MOST + 4


def test_they_outlast_the_program_and_what_lasted_begins_anew():
    before = history()
    for at in (0.0, 1.0):
        before.on_lines(STOPPED, at)
    before.acknowledge("m0", "ada", 2.0)
    made = history(before.text)
    assert made.messages[0].acknowledged_by == "ada" and made.messages[0].until == 0.0
    for at in (10.0, 11.0):
        made.on_lines(STOPPED, at)
    assert [(each.id, each.at, each.until) for each in made.messages] == [("m0", 0.0, 0.0), ("m1", 10.0, None)]


@pytest.mark.parametrize("text", [b"{}", b"[1]", b"not json", b'[{"id": "a"}]', b"\xff"])
def test_a_file_of_something_else_is_refused_and_says_where(text):
    with pytest.raises(ConfigurationError, match="messages"):
        history(text)


def speed(made: MessageHistory, person: str, before: float, limit: float, at: float) -> None:
    made.on_speed(SpeedChange(person, limit, before, "bob", round(at * NANOSECONDS)))


def told(made: MessageHistory) -> list[tuple]:
    return [(each.line.state, each.line.sentence, each.at, each.until) for each in made.messages]


def test_who_has_raised_or_lowered_the_speed_limit_is_a_message_that_needs_nobody_s_note():
    made = history()
    speed(made, "dora", 1.0, 0.3, 5.0)
    speed(made, "ada", 0.3, 0.555, 6.0)
    assert told(made) == [
        ("lowered", "dora lowered the speed limit of people from 100% to 30%", 5.0, 5.0),
        ("raised", "ada raised the speed limit of people from 30% to 55.5%", 6.0, 6.0),
    ]
    assert history(made.text).messages == made.messages

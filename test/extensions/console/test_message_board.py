"""The messages that a person must not miss: which lines become one, when they end, who has read them, and that they outlast the
node.
"""

from __future__ import annotations

import json
from types import SimpleNamespace

import pytest
from bridge_bench import Client

from construction_twin.core.reports import SpeedChange
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.extensions.console import message_board as module
from construction_twin.extensions.console.message_board import MAX_MESSAGES, ORDINARY, MessageBoard
from construction_twin.extensions.console.nodes.endpoint import Connection
from construction_twin.extensions.console.nodes.feed import ConsoleFeed
from construction_twin.extensions.console.remote_view import ViewWriter
from construction_twin.extensions.console.status_line import TABLE, CurrentReports, Level, status_lines
from construction_twin.link.requests import Joints
from construction_twin.mqtt.client import Broker
from construction_twin.mqtt.messages import Topics
from construction_twin.views.startup import ReportedState

ARMED, IN_SYNC, IDLE = ReportedState("ARMED", ""), ReportedState("IN_SYNC", ""), ReportedState("IDLE", "")


class Board:
    """A board with a clock that the test sets; remembers what is told and refused."""

    def __init__(self, path=None):
        self.told: list[list[dict]] = []
        self.refused: list[str] = []
        self.now = 0.0
        self.board = MessageBoard(
            lambda text: self.told.append(json.loads(text)),
            lambda reason, sentence: self.refused.append(sentence),
            path,
            lambda: self.now,
        )

    @property
    def messages(self):
        return self.board.messages

    def lines(self, lines, now: float) -> None:
        self.now = now
        self.board.on_lines(lines)

    def acknowledge(self, number: int, account: str, now: float = 0.0):
        self.now = now
        return self.board.acknowledge(self.messages[number].id, account)

    def speed(self, person: str, before: float, limit: float, at: float) -> None:
        self.board.on_speed(SpeedChange(person, limit, before, "bob", round(at * NANOSECONDS)))


def lines(**changes):
    return status_lines(CurrentReports(**{"link": ARMED, "sync": IN_SYNC, "execution": IDLE} | changes))


STOPPED = lines(link=ReportedState("NEEDS_RESET", "asked by account bob"))


def test_what_a_person_must_mend_is_a_message_from_when_it_began_until_it_ends():
    made = Board()
    for at in (9.6, 9.8, 10.0):
        made.lines(lines(), at)
    assert made.told == [[]], "at the first look, and not again"
    made.lines(STOPPED, 11.0)
    assert made.messages == ()
    made.lines(STOPPED, 12.0)
    (message,) = made.messages
    assert (message.at, message.until, message.line.topic, message.line.state) == (11.0, None, "link", "NEEDS_RESET")
    assert "asked by account bob" in message.line.sentence
    made.lines(STOPPED, 13.0)
    assert [len(told) for told in made.told] == [0, 1], "nothing is told again"
    made.lines(lines(), 14.0)
    assert [message.until for message in made.messages] == [14.0]


def test_what_passes_at_once_is_none():
    made = Board()
    for at, shown in ((0.0, STOPPED), (0.5, lines()), (1.5, STOPPED), (2.4, lines())):
        made.lines(shown, at)
    assert made.messages == ()


def test_another_cause_is_another_message():
    made = Board()
    for at, joint in ((0.0, "A3"), (1.0, "A3"), (2.0, "A1"), (3.0, "A1")):
        made.lines(lines(sync=ReportedState("HOLDING", ""), cause=f"{joint} differs"), at)
    assert [(each.line.sentence, each.at, each.until) for each in made.messages if each.line.topic == "cause"] == [
        ("The arm holds: A3 differs", 0.0, 2.0), ("The arm holds: A1 differs", 2.0, None),
    ]  # fmt: skip


def test_a_verdict_or_a_task_that_is_waited_for_is_no_message():
    assert {key for key in ORDINARY} <= set(TABLE) | {("execution", "REVIEW")}
    assert all(TABLE[key].level is Level.PERSON for key in ORDINARY)
    made = Board()
    for at in (0.0, 5.0):
        made.lines(lines(plan="p1"), at)
    assert made.messages == ()


def test_who_has_read_a_message_is_known_once():
    made = Board()
    for at in (0.0, 1.0):
        made.lines(STOPPED, at)
    assert made.acknowledge(0, "ada", 7.0) == (True, "acknowledged by ada")
    assert (made.messages[0].acknowledged_by, made.messages[0].acknowledged_at) == ("ada", 7.0)
    assert made.acknowledge(0, "bob", 8.0) == (False, "ada has acknowledged it already")
    taken, why = made.board.acknowledge("m9", "bob")
    assert not taken and "no message 'm9'" in why
    made.lines(lines(), 9.0)
    assert made.messages[0].acknowledged_by == "ada" and made.messages[0].until == 9.0


def test_one_is_acknowledged_in_the_name_of_the_topic_s_account():
    client, refused, topics = Client(), [], Topics("twin", "kr120")
    connection = Connection(Broker("127.0.0.1", 1), client, topics, lambda reason, _: refused.append(reason))
    writer = ViewWriter("kr120", "cafe", Joints(("a1",), (False,)))
    board = ConsoleFeed("base_link", connection, writer, {}).messages
    (endpoint,) = connection.endpoints
    board.on_act("reset", 5.0, "ada asked for a reset")
    (message,) = board.messages

    def acknowledge(account, retain=False):
        payload = json.dumps({"id": "1", "message": message.id}).encode()
        topic = f"twin/kr120/acknowledge/{account}"
        endpoint.on_message(SimpleNamespace(topic=topic, payload=payload, retain=retain))
        return json.loads(client.published[-1][1])

    assert acknowledge("ada") == {
        "id": "1",
        "account": "ada",
        "message": message.id,
        "ok": True,
        "reason": "acknowledged by ada",
        "said": {"acknowledged by ada": {"template": "acknowledged by {account}", "values": {"account": "ada"}}},
    }
    again = acknowledge("bob")
    assert (again["ok"], again["account"]) == (False, "bob") and board.messages[0].acknowledged_by == "ada"
    assert not acknowledge("ada", retain=True)["ok"] and refused == ["retained"]


def test_what_people_did_stands_among_them_and_is_told_once():
    made = Board()
    for _ in range(2):
        made.board.on_act("reset", 5.0, Sentence("{person} asked for a reset", person="ada"))
    (message,) = made.messages
    assert message.line.sentence == "ada asked for a reset"
    assert (message.at, message.until) == (5.0, 5.0)
    assert message.line.said == {
        "ada asked for a reset": {"template": "{person} asked for a reset", "values": {"person": "ada"}}
    }
    assert [len(told) for told in made.told] == [1]


def test_the_newest_are_kept():
    made = Board()
    for number in range(MAX_MESSAGES + 5):
        made.board.on_act("reset", float(number), "ada asked for a reset")
    assert len(made.messages) == MAX_MESSAGES and made.messages[-1].at == MAX_MESSAGES + 4


def test_they_outlast_the_node_and_what_lasted_begins_anew(tmp_path, monkeypatch):
    path = tmp_path / "messages/kr120.json"
    before = Board(path)
    for at in (0.0, 1.0):
        before.lines(STOPPED, at)
    before.acknowledge(0, "ada", 2.0)
    before.board.write()
    monkeypatch.setattr(module, "write_atomically", lambda *_: pytest.fail("nothing has changed"))
    before.board.write()
    made = Board(path)
    assert made.messages[0].acknowledged_by == "ada" and made.messages[0].until == 0.0
    for at in (10.0, 11.0):
        made.lines(STOPPED, at)
    assert [(each.at, each.until) for each in made.messages] == [(0.0, 0.0), (10.0, None)]
    assert before.messages[0].id == made.told[0][0]["id"] and made.refused == []


@pytest.mark.parametrize("text", [b"{}", b"[1]", b"not json", b'[{"id": "a"}]', b"\xff"])
def test_a_file_that_is_none_of_ours_is_counted_and_they_begin_anew(tmp_path, text):
    path = tmp_path / "kr120.json"
    path.write_bytes(text)
    made = Board(path)
    made.lines(lines(), 0.0)
    (refused,) = made.refused
    assert "not as console_node wrote it; the messages begin anew" in refused and made.told == [[]]
    path.unlink()
    path.mkdir()
    for at in (1.0, 2.0):
        made.lines(STOPPED, at)
    made.board.write()
    assert len(made.refused) == 2, "what cannot be written is counted"


def told(made: Board) -> list[tuple]:
    return [(each.line.state, each.line.sentence, each.at, each.until) for each in made.messages]


def test_who_has_raised_or_lowered_the_speed_limit_is_a_message_that_needs_nobody_s_note():
    made = Board()
    made.speed("dora", 1.0, 0.3, 5.0)
    made.speed("ada", 0.3, 0.555, 6.0)
    assert told(made) == [
        ("lowered", "dora lowered the speed limit of people from 100% to 30%", 5.0, 5.0),
        ("raised", "ada raised the speed limit of people from 30% to 55.5%", 6.0, 6.0),
    ]

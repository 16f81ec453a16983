"""The messages of a robot: told when they change and not else, kept over a restart, acknowledged by MQTT in the account's name."""

from __future__ import annotations

import json
from types import SimpleNamespace

import genpy
import pytest
from bridge_bench import Client

from construction_twin.extensions.console.nodes import messages as module
from construction_twin.extensions.console.nodes.endpoint import Connection
from construction_twin.extensions.console.nodes.messages import MessageBoard
from construction_twin.mqtt.client import Broker
from construction_twin.mqtt.messages import Topics
from construction_twin.views.startup import Word
from construction_twin.views.status_line import ReportsNow, status_lines

TOPICS = Topics("twin", "kr120")
WELL = status_lines(ReportsNow(Word("ARMED", ""), Word("IN_SYNC", ""), Word("IDLE", "")))
STOPPED = status_lines(ReportsNow(Word("NEEDS_RESET", "asked by bob"), Word("IN_SYNC", ""), Word("IDLE", "")))


class Bench:
    """A board with a file, a clock that the test sets, and a broker that remembers."""

    def __init__(self, path):
        self.told: list[list[dict]] = []
        self.refused: list[str] = []
        self.now = 0.0
        self.client = Client()
        connection = Connection(Broker("127.0.0.1", 1), self.client, TOPICS, self._refuse)
        self.board = MessageBoard(self._tell, connection, path, lambda: self.now)
        (self.endpoint,) = connection.endpoints

    def _tell(self, text: bytes) -> None:
        self.told.append(json.loads(text))

    def _refuse(self, reason: str, sentence: str) -> None:
        self.refused.append(reason)

    def lines(self, lines, now: float) -> None:
        self.now = now
        self.board.on_lines(lines)

    def acknowledge(self, message: str, account: str = "ada", id_: str = "1", retain: bool = False) -> dict:
        payload = json.dumps({"id": id_, "message": message}).encode()
        topic = f"twin/kr120/acknowledge/{account}"
        self.endpoint.on_message(SimpleNamespace(topic=topic, payload=payload, retain=retain))
        return json.loads(self.client.published[-1][1])


@pytest.fixture
def bench(tmp_path):
    return Bench(tmp_path / "messages/kr120.json")


def test_they_are_told_at_the_first_look_and_after_each_change(bench):
    for at in (0.0, 0.2, 0.4):
        bench.lines(WELL, at)
    assert bench.told == [[]]
    for at in (1.0, 1.2, 2.0, 2.2):
        bench.lines(STOPPED, at)
    assert [len(told) for told in bench.told] == [0, 1]
    bench.board.on_act("reset", genpy.Time(3), "ada asked for a reset")
    assert [message["line"]["topic"] for message in bench.told[-1]] == ["link", "person"]


def test_one_is_acknowledged_in_the_name_of_the_topic_s_account(bench):
    for at in (1.0, 2.0):
        bench.lines(STOPPED, at)
    (message,) = bench.told[-1]
    answer = bench.acknowledge(message["id"])
    assert answer == {
        "id": "1",
        "account": "ada",
        "message": message["id"],
        "ok": True,
        "reason": "acknowledged by ada",
        "said": {"acknowledged by ada": {"template": "acknowledged by {account}", "values": {"account": "ada"}}},
    }
    assert bench.told[-1][0]["acknowledged_by"] == "ada"
    again = bench.acknowledge(message["id"], "bob", "2")
    assert (again["ok"], again["account"]) == (False, "bob") and bench.told[-1][0]["acknowledged_by"] == "ada"
    assert not bench.acknowledge("nothing")["ok"]
    assert not bench.acknowledge(message["id"], retain=True)["ok"] and bench.refused == ["retained"]


def test_they_outlast_the_node_and_are_written_only_where_something_has_changed(bench, tmp_path, monkeypatch):
    for at in (1.0, 2.0):
        bench.lines(STOPPED, at)
    bench.board.write()
    kept = (tmp_path / "messages/kr120.json").read_bytes()
    monkeypatch.setattr(module, "write_whole", lambda *_: pytest.fail("nothing has changed"))
    bench.board.write()
    again = Bench(tmp_path / "messages/kr120.json")
    again.lines(WELL, 5.0)
    assert json.loads(kept)[0]["id"] == again.told[0][0]["id"] and again.refused == []


def test_a_file_that_is_none_of_ours_is_counted_and_they_begin_anew(tmp_path):
    path = tmp_path / "kr120.json"
    path.write_text("{")
    bench = Bench(path)
    bench.lines(WELL, 0.0)
    assert bench.refused == ["messages"] and bench.told == [[]]
    path.unlink()
    path.mkdir()
    for at in (1.0, 2.0):
        bench.lines(STOPPED, at)
    bench.board.write()
    assert bench.refused == ["messages"] * 2, "what cannot be written is counted"

"""STOPPED outlasts the monitor: kept in a thread of its own, tried again when the master does not answer."""

from __future__ import annotations

import threading
import xmlrpc.client
from pathlib import Path
from xml.etree import ElementTree

import pytest
from processes import wait_until

from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.ros.nodes.pca_monitor import STOPPED
from construction_twin.ros.shared.params import SavedParameter


class Server:
    """A parameter server that can be away, or slow."""

    def __init__(self):
        self.written: list[str] = []
        self.away: Exception | None = None
        self.go_on = threading.Event()
        self.go_on.set()

    def write(self, session: str) -> None:
        """Take a session."""
        self.go_on.wait(10.0)
        if self.away:
            raise self.away
        xmlrpc.client.dumps((session,))  # what cannot travel is refused as the master's proxy does
        self.written.append(session)


def save(memory: SavedParameter, session: str, now: int) -> None:
    memory.save(session, now)
    wait_until(lambda: not memory.writing)


def test_a_new_launch_begins_without():
    launch = ElementTree.parse(Path(__file__).parents[3] / "launch/bringup.launch").getroot()
    assert [param.get("value") for param in launch.iter("param") if param.get("name") == STOPPED] == [""]


def test_writes_changes_only():
    server = Server()
    memory = SavedParameter("", server.write, STOPPED)
    for now, session in enumerate(("", "", "s1", "s1", "", "s2", "s2")):
        save(memory, session, now)
    assert server.written == ["s1", "", "s2"] and memory.fault == ""


def test_the_sentence_of_a_link_travels_as_a_text():
    server, reason = Server(), Sentence("stop sent to the gateway, plan dropped; call reset to go on")
    save(SavedParameter("", server.write, STOPPED), reason, 0)
    assert server.written == [reason]


def test_what_is_there_already_is_not_written_again():
    server = Server()
    save(SavedParameter("s1", server.write, STOPPED), "s1", 0)
    assert server.written == []


def test_a_slow_master_holds_nobody_up_and_the_newest_is_written_in_the_end():
    server = Server()
    server.go_on.clear()
    memory = SavedParameter("", server.write, STOPPED)
    memory.save("s1", 0)
    memory.save("", 1)
    memory.save("s2", 2)
    assert server.written == []
    server.go_on.set()
    wait_until(lambda: not memory.writing)
    save(memory, "s2", 3)
    assert server.written == ["s1", "s2"]


@pytest.mark.parametrize("error", [ConnectionRefusedError("nobody there"), KeyError("nobody there")])
def test_says_that_it_could_not_be_kept_and_tries_again_after_a_while(error):
    server = Server()
    server.away = error
    memory = SavedParameter("", server.write, STOPPED)
    save(memory, "s1", 0)
    assert "nobody there" in memory.fault
    server.away = None
    save(memory, "s1", NANOSECONDS // 2)
    assert server.written == []
    save(memory, "s1", NANOSECONDS)
    assert server.written == ["s1"] and memory.fault == ""

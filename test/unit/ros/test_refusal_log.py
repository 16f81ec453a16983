"""Which refusals are written: each stranger once per stream, everything else at most every 5 s per reason."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import pytest
import rospy
from processes import wait_until

from construction_twin.ros.shared import diagnostics as module
from construction_twin.ros.shared.diagnostics import MAX_STRANGERS, PERIOD, RefusalLog, warn_of_refusals


def sentence(topic: str, stranger: str = "/play_1") -> str:
    return f"message from {stranger}; only /kr120/x may publish /kr120/{topic}"


@pytest.fixture
def clock():
    return [0]


@pytest.fixture
def log(clock):
    return RefusalLog(lambda: clock[0])


def test_every_stream_of_a_bag_is_named_once_however_many_come_together(log, clock):
    written = []
    for _ in range(100):
        clock[0] += PERIOD // 100
        written += [topic for topic in ("sync", "link", "plan") if log.admit("publisher", sentence(topic)) == ""]
    assert written == ["sync", "link", "plan"]
    # another bag is another stranger
    assert log.admit("publisher", sentence("sync", "/play_2")) == ""


def test_other_reasons_do_not_hide_each_other(log, clock):
    assert log.admit("plan", "a") == log.admit("limit", "b") == ""
    clock[0] += PERIOD - 1
    assert log.admit("plan", "c") is log.admit("limit", "d") is None
    clock[0] += 1
    assert log.admit("plan", "e") == " (1 more like this since the last such line)"


def test_strangers_without_end_fill_no_memory_and_no_log(log, clock):
    written = sum(log.admit("publisher", sentence("sync", f"/play_{k}")) is not None for k in range(10 * MAX_STRANGERS))
    assert written == MAX_STRANGERS + 1


def test_a_program_without_diagnostics_says_it_with_its_name(monkeypatch):
    said = []
    monkeypatch.setattr(rospy, "logwarn", lambda *words: said.append(words[0] % words[1:]))
    monkeypatch.setattr(rospy, "get_name", lambda: "/kr120/build")
    refuse = warn_of_refusals()
    for _ in range(3):
        refuse("publisher", sentence("sync"))
    assert said == [f"/kr120/build refused (publisher): {sentence('sync')}"]


@pytest.fixture
def diagnostics(monkeypatch):
    """The diagnostics of a node, without a master."""
    updater = SimpleNamespace(setHardwareID=lambda name: None, add=lambda name, task: None)
    monkeypatch.setattr(module.diagnostic_updater, "Updater", lambda: updater)
    monkeypatch.setattr(module, "Publisher", lambda *_, **__: None)
    monkeypatch.setattr(rospy, "Timer", lambda *_: None)
    monkeypatch.setattr(rospy, "on_shutdown", lambda hook: None)
    monkeypatch.setattr(rospy, "get_name", lambda: "/kr120/executor")
    return module.NodeDiagnostics("kr120", lambda: module.Diagnosis(module.OK, "well"))


def test_who_refuses_waits_for_no_log(diagnostics, monkeypatch):
    """What refuses a plan holds the lock of the executor's cycle: a disk or a terminal that hangs must not stop that."""
    hangs, said = threading.Event(), []
    monkeypatch.setattr(rospy, "logwarn", lambda *words: hangs.wait(10.0) and said.append(words[0] % words[1:]))
    refusing = threading.Thread(target=lambda: [diagnostics.refuse(reason, "no") for reason in ("plan", "limit")])
    refusing.start()
    refusing.join(5.0)
    assert not refusing.is_alive() and diagnostics.refused == {"plan": 1, "limit": 1} and said == []
    hangs.set()
    wait_until(lambda: len(said) == 2, what="both lines")
    assert said == ["/kr120/executor refused (plan): no", "/kr120/executor refused (limit): no"]
    diagnostics.refuse("scene", "no")
    wait_until(lambda: len(said) == 3, what="the next line")

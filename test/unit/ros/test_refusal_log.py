"""Which refusals are written: each stranger once per stream, everything else at most every 5 s per reason."""

from __future__ import annotations

import pytest
import rospy

from construction_twin.ros.shared.refusal_log import KEPT, PERIOD, RefusalLog, warn_of_refusals


def sentence(topic: str, stranger: str = "/play_1") -> str:
    return f"message from {stranger}; only /kr120/x may publish /kr120/{topic}"


@pytest.fixture
def clock():
    return [0.0]


@pytest.fixture
def log(clock):
    return RefusalLog(lambda: clock[0])


def test_every_stream_of_a_bag_is_named_once_however_many_come_together(log, clock):
    written = []
    for _ in range(100):
        clock[0] += 0.05
        written += [topic for topic in ("sync", "link", "plan") if log.take("publisher", sentence(topic))]
    assert written == ["sync", "link", "plan"]
    assert log.strangers() == {sentence(topic): 100 for topic in written}
    # another bag is another stranger
    assert log.take("publisher", sentence("sync", "/play_2"))


def test_other_reasons_do_not_hide_each_other(log, clock):
    assert log.take("plan", "a") and log.take("limit", "b")
    clock[0] += PERIOD - 0.01
    assert not log.take("plan", "c") and not log.take("limit", "d")
    clock[0] += 0.01
    assert log.take("plan", "e")


def test_strangers_without_end_fill_no_memory_and_no_log(log, clock):
    written = sum(log.take("publisher", sentence("sync", f"/play_{k}")) for k in range(10 * KEPT))
    assert written == KEPT + 1 and len(log.strangers()) == KEPT


def test_a_program_without_diagnostics_says_it_with_its_name(monkeypatch):
    said = []
    monkeypatch.setattr(rospy, "logwarn", lambda *words: said.append(words[0] % words[1:]))
    monkeypatch.setattr(rospy, "get_name", lambda: "/kr120/build")
    refuse = warn_of_refusals()
    for _ in range(3):
        refuse("publisher", sentence("sync"))
    assert said == [f"/kr120/build refused (publisher): {sentence('sync')}"]

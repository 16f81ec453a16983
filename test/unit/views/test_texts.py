"""A robot's state as people read it: whether a plan could be approved, why the arm holds, what `twin watch` shows."""

from __future__ import annotations

import time

import pytest
from scene_samples import kr120

from construction_twin.core.reports import ExecutionReport, HoldReport, LinkReport, SyncReport
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import axis_name
from construction_twin.views.texts import Snapshot, hold_cause, watch_lines

READY = {
    "link": LinkReport("ARMED", "commands flow"),
    "sync": SyncReport("IN_SYNC", "the poses agree"),
    "execution": ExecutionReport("IDLE", "twin and arm agree"),
}


def snapshot(**facts) -> Snapshot:
    robot = kr120()
    return Snapshot("kr120", robot.joint_names, robot.linear, **facts)


def test_ready_only_when_a_plan_could_be_approved():
    assert snapshot(**READY).not_ready() == []
    assert snapshot(**READY | {"link": None}).not_ready() == []
    assert snapshot(**READY | {"sync": None}).not_ready() == ["sync is silent; expected IN_SYNC"]
    (why,) = snapshot(**READY | {"link": LinkReport("NEEDS_RESET", "it braked")}).not_ready()
    assert why == "link is NEEDS_RESET, expected ARMED: it braked"
    silent = snapshot(**READY, silent={"sync": 3.0})
    assert silent.not_ready() == ["sync has been silent for 3 s; expected IN_SYNC"]


def shown(**changes) -> str:
    return "\n".join(watch_lines(snapshot(**changes)))


def test_a_report_that_fell_silent_is_not_shown_as_the_present():
    sync = SyncReport("IN_SYNC", "the poses agree", "replan", "aligned", (0.001,) * 6, (0.01,) * 6)
    text = shown(link=LinkReport("ARMED", "commands flow"), sync=sync, silent={"sync": 4.2, "link": 7.0})
    assert "silent for 4 s; the last was IN_SYNC" in text and "silent for 7 s; the last was ARMED" in text
    assert "nothing is compared" in text and "joint_a1" not in text


def test_a_joint_over_its_threshold_is_marked_and_what_was_late_is_counted():
    sync = SyncReport("HOLDING", "", "replan", "aligned", (0.001, 0.02, 0.0, 0.0, 0.0, 0.0), (0.01,) * 6)
    text = shown(link=LinkReport("ARMED", "", gateway_counters={"late_replies": "3"}), sync=sync)
    assert "joint_a1   0.0573 deg of 0.5730 deg\n" in text and "joint_a2   1.1459 deg of 0.5730 deg  <\n" in text
    assert "late replies 3; commands late 0" in text


SINCE = 1_795_369_597_396_012_345


@pytest.fixture
def utc(monkeypatch):
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


@pytest.mark.parametrize(
    "joint, said",
    [
        ("joint_a3", "A3"),
        ("joint_e1", "E1"),
        ("track", "track"),
        ("panda_joint3", "panda_joint3"),
        ("joint_a33", "joint_a33"),
    ],
)
def test_an_axis_has_the_name_that_stands_on_the_pendant(joint, said):
    assert axis_name(joint) == said


def test_it_names_the_cause_and_since_when_and_keeps_the_words_for_another_language(utc):
    cause = Sentence("{joint} differs by {difference}", joint="A3", difference="0.755 deg")
    said = hold_cause(HoldReport(cause, SINCE))
    assert said == "A3 differs by 0.755 deg, since 17:46:37"
    assert isinstance(said, Sentence) and said.values["reason"] is cause

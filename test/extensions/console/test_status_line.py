"""The status line: every state has its words, every page exists, and the most urgent line comes first."""

from __future__ import annotations

import pytest

from construction_twin.core.records import json_value
from construction_twin.core.reports import TaskReport, WorkReport
from construction_twin.core.sentences import Sentence, templates_of
from construction_twin.execution.states import ExecutorState
from construction_twin.extensions.console.status_line import (
    TABLE,
    TOPICS,
    CurrentReports,
    Level,
    status_lines,
    work_state,
)
from construction_twin.extensions.work.task_memory import TaskState
from construction_twin.link.observations import LinkState
from construction_twin.monitor.states import SyncState
from construction_twin.views.startup import Deployment, Missing, ReportedState

HERE = Deployment("/kr120", "mock", "127.0.0.1:1883", "127.0.0.1:49152", True)
WELL = CurrentReports(ReportedState("ARMED", ""), ReportedState("IN_SYNC", ""), ReportedState("IDLE", ""))


def states_of(topic: str) -> list[str]:
    return [state for name, state in TABLE if name == topic]


def lines(reports: CurrentReports) -> dict[str, dict]:
    return {line.topic: json_value(line) for line in status_lines(reports)}


def test_every_state_of_every_node_has_words():
    assert {state.name for state in LinkState} | {"", "NEEDS_NAME"} == set(states_of("link"))
    assert {state.name for state in SyncState} | {""} == set(states_of("sync"))
    assert {state.name for state in ExecutorState} | {"", "REVIEW", "NOT_YET", "ENGAGED"} == set(states_of("execution"))
    assert {topic for topic, _ in TABLE} == set(TOPICS)


def test_all_is_well():
    said = lines(WELL)
    # what the arm does comes first where nothing is urgent
    assert list(said) == ["execution", "link", "sync"]
    assert all(line["level"] == 0 and not line["waits_for"] and not line["todo"] for line in said.values())
    assert said["execution"]["sentence"] == "The arm holds its pose; no plan is executed"


def test_the_most_urgent_comes_first_with_the_reason_of_the_node():
    heard = CurrentReports(
        ReportedState("ARMED", ""), ReportedState("HOLDING", "joint_a3 differs by 0.7 deg"),
        ReportedState("HELD", "at 2.1 s"), started=True,
    )  # fmt: skip
    found = status_lines(heard)
    assert [line.topic for line in found] == ["sync", "execution", "startup", "link"]
    assert (found[0].state, found[0].who) == ("HOLDING", "operator")
    assert found[0].sentence == "The arm holds, because it is not where the twin is: joint_a3 differs by 0.7 deg"
    assert found[0].waits_for == "twin and arm to agree again"


@pytest.mark.parametrize(
    "state, words", [("HOLDING", "held"), ("REPLANNING", "held"), ("STOPPED", "stopped"), ("WAITING", "held")]
)
def test_why_the_arm_holds_comes_before_all_that_follows_from_it(state, words):
    cause = Sentence("{reason}, since {since}", reason="joint_a3 differs by 0.7 deg", since="10:02:03")
    heard = CurrentReports(
        ReportedState("ARMED", ""), ReportedState(state, "another reason"), ReportedState("IDLE", ""),
        plan="p1", cause=cause, obstacle="not in sync",
        started=True, missing=Missing("gate_reset", "it holds", HERE),
    )  # fmt: skip
    first, *others = status_lines(heard)
    assert "startup" not in [line.topic for line in others], "that the gate is closed is said already"
    assert (first.topic, first.state) == ("cause", words) and first.sentence.endswith(f": {cause}")
    assert first.said == templates_of(first.sentence) and cause in first.said and first.level == Level.PERSON
    execution = next(line for line in others if line.topic == "execution")
    assert (execution.state, execution.level) == ("NOT_YET", Level.WAITS) and execution.sentence.endswith(
        ": not in sync"
    )


def test_what_is_silent_is_a_line_of_its_own():
    said = lines(CurrentReports())
    assert [line["state"] for line in said.values()] == ["", "", ""] and all(
        line["level"] == 2 for line in said.values()
    )
    assert "link" not in lines(CurrentReports(arm=False)), "without an arm there is none"


def test_a_plan_under_review_waits_for_the_reviewer():
    line = lines(CurrentReports(WELL.link, WELL.sync, WELL.execution, plan="p1"))["execution"]
    assert (line["state"], line["who"]) == ("REVIEW", "reviewer")
    engaged = lines(CurrentReports(WELL.link, WELL.sync, WELL.execution, engaged=True))["execution"]
    assert engaged["state"] == "ENGAGED"
    playing = lines(CurrentReports(WELL.link, WELL.sync, ReportedState("PLAYING", ""), plan="p1"))["execution"]
    assert playing["level"] == 0, "the plan that waits comes after this one"


def test_a_bare_plc_is_armed_by_name_and_not_reset():
    link = ReportedState("NEEDS_RESET", "nobody has armed")
    assert lines(CurrentReports(link, bare=True))["link"]["state"] == "NEEDS_NAME"
    assert lines(CurrentReports(link))["link"]["state"] == "NEEDS_RESET"


def facts(*states: str, proposed: bool = False, **changes) -> WorkReport:
    given = {"engaged": False, "schedule": "proposed" if proposed else "model", "next": "", "reason": "why"} | changes
    tasks = tuple(TaskReport(id="", name="", element="", state=state, reason="", after=()) for state in states)
    return WorkReport(model="", model_hash="", tasks=tasks, notes=(), **given)


@pytest.mark.parametrize(
    "work, state",
    [
        (facts(), "unavailable"),
        (facts("done", "asks", "waiting"), "asks"),
        (facts("asks", engaged=True), "engaged"),
        (facts("done", "carrying", "ready"), "working"),
        (facts("planned", "waiting"), "planned"),
        (facts("ready", proposed=True), "proposed"),
        (facts("ready", "waiting", next="t"), "ready"),
        (facts("done", "skipped"), "done"),
        (facts("held", "waiting"), "waiting"),
    ],
)
def test_the_work_is_in_one_state(work, state):
    assert work_state(work) == state
    said = lines(CurrentReports(work=work))["work"]
    assert said["state"] == state and said["sentence"].endswith(": why")


def test_every_state_of_a_task_leads_to_a_state_of_the_work():
    found = {work_state(facts(state.value)) for state in TaskState}
    assert found <= set(states_of("work")) and {"working", "planned", "asks", "done", "waiting"} == found

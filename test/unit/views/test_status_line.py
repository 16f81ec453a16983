"""The status line: every state has its words, every page exists, and the most urgent line comes first."""

from __future__ import annotations

import json
import re
from dataclasses import asdict
from pathlib import Path

import pytest

from construction_twin.core.records import SPACED, document, dumped
from construction_twin.core.reports import NO_REPORT, TaskReport, WorkReport
from construction_twin.core.sentences import Sentence, has
from construction_twin.execution.states import ExecutorState
from construction_twin.link.states import LinkState
from construction_twin.monitor.states import SyncState
from construction_twin.views.startup import Deployment, Missing, Word, first_missing
from construction_twin.views.startup import Seen as StartSeen
from construction_twin.views.status_line import (
    STARTING,
    TABLE,
    TOPICS,
    WHO,
    Level,
    ReportsNow,
    status_lines,
    work_state,
)
from construction_twin.work.task_states import TaskState

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"
SENTENCES = json.loads((ROOT / "src/construction_twin/core/sentences.json").read_text())
#: What can be missing at a start.
KINDS = [key.split(".")[2] for key in SENTENCES if re.fullmatch(r"line\.startup\.\w+\.waits", key)]
HERE = Deployment("/kr120", "mock", "127.0.0.1:1883", "127.0.0.1:49152", True)
WELL = ReportsNow(Word("ARMED", ""), Word("IN_SYNC", ""), Word("IDLE", ""))


def states_of(topic: str) -> list[str]:
    return [state for name, state in TABLE if name == topic]


def test_a_line_is_sent_with_all_its_fields_in_their_order_as_json_has_them():
    for heard in (
        WELL,
        ReportsNow(sync=Word("HOLDING", NO_REPORT)),
        ReportsNow(started=True, missing=Missing("nodes", "ä", HERE)),
    ):
        found = status_lines(heard)
        assert dumped(found, marks=SPACED) == json.dumps([asdict(line) for line in found]).encode()
    keys = [
        "topic",
        "state",
        "words",
        "values",
        "level",
        "sentence",
        "reason",
        "said",
        "waits_for",
        "who",
        "todo",
        "page",
    ]
    assert list(document(found[0])) == keys


def lines(reports: ReportsNow) -> dict[str, dict]:
    return {line.topic: document(line) for line in status_lines(reports)}


def test_every_state_of_every_node_has_words():
    assert {state.name for state in LinkState} | {"", "NEEDS_NAME"} == set(states_of("link"))
    assert {state.name for state in SyncState} | {""} == set(states_of("sync"))
    assert {state.name for state in ExecutorState} | {"", "REVIEW", "NOT_YET", "ENGAGED"} == set(states_of("execution"))
    assert {topic for topic, _ in TABLE} == set(TOPICS)


@pytest.mark.parametrize("key", TABLE, ids=" ".join)
def test_words_are_a_sentence_and_say_who_and_what_to_do_where_a_person_is_needed(key):
    urgency = TABLE[key]
    line = f"line.{key[0]}.{key[1] or 'silent'}"
    assert all(text[0].isupper() and text.endswith(".") for text in SENTENCES[f"{line}.sentence"].values())
    assert urgency.who in WHO
    assert bool(urgency.who) == (urgency.level is not Level.WELL), "somebody is waited for, or nobody"
    if urgency.level is Level.PERSON and key != ("startup", "waiting"):
        assert has(f"{line}.waits") and has(f"{line}.todo") and urgency.who != "system"


@pytest.mark.parametrize("page", sorted({urgency.page for urgency in TABLE.values()}))
def test_every_page_and_its_heading_exist(page):
    name, _, anchor = page.partition("#")
    headings = re.findall(r"^#+ (.+)$", (DOCS / name).read_text(), re.MULTILINE)
    slugs = {re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-") for heading in headings}
    assert anchor in slugs


def test_all_is_well():
    said = lines(WELL)
    # what the arm does comes first where nothing is urgent
    assert list(said) == ["execution", "link", "sync"]
    assert all(line["level"] == 0 and not line["waits_for"] and not line["todo"] for line in said.values())
    assert said["execution"]["sentence"] == Sentence("line.execution.IDLE.sentence")


def test_what_is_well_is_said_without_a_session_s_number():
    said = lines(ReportsNow(Word("ARMED", "session 41ee"), Word("IN_SYNC", "poses agree"), Word("PLAYING", "at 50 %")))
    assert [said[topic]["reason"] for topic in ("link", "sync", "execution")] == ["", "", "at 50 %"]
    assert said["link"]["sentence"] == Sentence("line.link.ARMED.sentence")
    assert said["execution"]["sentence"] == f"{Sentence('line.execution.PLAYING.sentence')[:-1]}: at 50 %"


def test_the_most_urgent_comes_first_with_the_reason_of_the_node():
    heard = ReportsNow(
        Word("ARMED", ""), Word("HOLDING", "joint_a3 differs by 0.7 deg"), Word("HELD", "at 2.1 s"), started=True,
    )  # fmt: skip
    found = status_lines(heard)
    assert [line.topic for line in found] == ["sync", "execution", "startup", "link"]
    assert (found[0].words, found[0].reason, found[0].who) == (
        "sync.HOLDING", "joint_a3 differs by 0.7 deg", "operator",
    )  # fmt: skip
    assert found[0].waits_for == Sentence("line.sync.HOLDING.waits")


@pytest.mark.parametrize(
    "state, words", [("HOLDING", "held"), ("REPLANNING", "held"), ("STOPPED", "stopped"), ("WAITING", "held")]
)
def test_why_the_arm_holds_comes_before_all_that_follows_from_it(state, words):
    cause = Sentence("reason.holds.because", reason="joint_a3 differs by 0.7 deg", since="10:02:03")
    heard = ReportsNow(
        Word("ARMED", ""), Word(state, "another reason"), Word("IDLE", ""), plan="p1", cause=cause, obstacle="not in sync",
        started=True, missing=Missing("gate_reset", "it holds", HERE),
    )  # fmt: skip
    first, *others = status_lines(heard)
    assert "startup" not in [line.topic for line in others], "that the gate is closed is said already"
    assert (first.topic, first.state, first.words, first.reason) == ("cause", state, f"cause.{words}", cause)
    assert first.said == cause.document() and first.level == Level.PERSON
    execution = next(line for line in others if line.topic == "execution")
    assert (execution.words, execution.reason, execution.level) == ("execution.NOT_YET", "not in sync", Level.WAITS)


def test_what_is_silent_is_a_line_of_its_own():
    said = lines(ReportsNow())
    assert [line["state"] for line in said.values()] == ["", "", ""] and all(
        line["level"] == 2 for line in said.values()
    )
    assert "link" not in lines(ReportsNow(arm=False)), "without an arm there is none"


def test_a_plan_under_review_waits_for_the_reviewer():
    line = lines(ReportsNow(WELL.link, WELL.sync, WELL.execution, plan="p1"))["execution"]
    assert (line["state"], line["words"], line["who"]) == ("IDLE", "execution.REVIEW", "reviewer")
    engaged = lines(ReportsNow(WELL.link, WELL.sync, WELL.execution, engaged=True))["execution"]
    assert engaged["words"] == "execution.ENGAGED"
    playing = lines(ReportsNow(WELL.link, WELL.sync, Word("PLAYING", ""), plan="p1"))["execution"]
    assert playing["level"] == 0, "the plan that waits comes after this one"


def test_a_bare_plc_is_armed_by_name_and_not_reset():
    link = Word("NEEDS_RESET", "nobody has armed")
    assert lines(ReportsNow(link, bare=True))["link"]["words"] == "link.NEEDS_NAME"
    assert lines(ReportsNow(link))["link"]["words"] == "link.NEEDS_RESET"


@pytest.mark.parametrize("gateway_kind", ["rsi", "plc"])
@pytest.mark.parametrize("state", [*LinkState, None])
def test_whatever_a_start_waits_for_is_said_with_who_can_do_something(state, gateway_kind):
    deployment = Deployment("/kr120", "mock", "127.0.0.1:1883", "127.0.0.1:49152", True, gateway_kind)
    link = None if state is None else Word(state.name, "because")
    missing = first_missing(StartSeen(link, feedback=True, twin=True, scene=True), deployment)
    said = lines(ReportsNow(link, started=True, missing=missing))["startup"]
    assert (said["state"] == "ready") == (missing is None)
    if missing is not None:
        assert (said["waits_for"], said["todo"]) == (missing.what, missing.action) and said["who"] in WHO[1:]
        assert said["level"] == (1 if said["who"] == "system" else 2)


@pytest.mark.parametrize("kind", KINDS)
def test_whatever_can_be_missing_is_said_with_its_key_for_other_languages(kind):
    (line,) = (
        line
        for line in status_lines(ReportsNow(started=True, missing=Missing(kind, "it is day", HERE)))
        if line.topic == "startup"
    )
    assert line.words == f"startup.{kind}" and line.values == HERE.values
    assert (
        line.sentence == f"{Sentence('line.startup.waiting.sentence')[:-1]}: it is day" and line.reason == "it is day"
    )
    assert (line.who == "system") == (("nothing to do" in line.todo) or kind in ("gate", "executor", "running_mock"))


def test_who_can_do_something_is_of_what_can_be_missing():
    assert set(STARTING) <= set(KINDS)


def test_a_line_has_the_key_of_its_words_and_the_reason_alone():
    (line,) = (
        line for line in status_lines(ReportsNow(Word("NEEDS_RESET", "it braked"), bare=True)) if line.topic == "link"
    )
    assert (line.state, line.words, line.reason) == ("NEEDS_RESET", "link.NEEDS_NAME", "it braked")
    said = lines(ReportsNow(WELL.link, WELL.sync, WELL.execution, plan="p1"))
    assert said["execution"]["words"] == "execution.REVIEW" and said["link"]["reason"] == ""
    assert lines(ReportsNow())["sync"]["words"] == "sync.silent"


def test_there_are_words_for_every_state_and_for_no_other():
    states = {f"{topic}.{state or 'silent'}" for topic, state in TABLE} | {f"startup.{kind}" for kind in KINDS}
    said = {key for key in SENTENCES if key.startswith("line.") and not key.startswith("line.person.")}
    assert {key.removeprefix("line.").rpartition(".")[0] for key in said} == states


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
    said = lines(ReportsNow(work=work))["work"]
    assert said["state"] == state and said["sentence"].endswith(": why")


def test_every_state_of_a_task_leads_to_a_state_of_the_work():
    found = {work_state(facts(state.value)) for state in TaskState}
    assert found <= set(states_of("work")) and {"working", "planned", "asks", "done", "waiting"} == found


def test_a_reason_that_has_a_key_is_sent_with_it_for_other_languages():
    said = Sentence("reason.gate.feedback_old", age=0.25)
    heard = ReportsNow(WELL.link, Word("STALE", str(said)), WELL.execution)
    assert lines(heard)["sync"]["said"] == {"key": "reason.gate.feedback_old", "values": {"age": 0.25}}
    assert lines(ReportsNow(WELL.link, Word("STALE", "because"), WELL.execution))["sync"]["said"] is None
    assert lines(WELL)["sync"]["said"] is None

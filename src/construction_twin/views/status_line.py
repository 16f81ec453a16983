"""The status line that a foreman reads: what the arm does now, why it holds, what is waited for, by whom, and what to do.

One table gives every state of `link`, `sync`, `execution` and the work its urgency, who is waited for, and a page; its words are
``line.<topic>.<state>`` of the sentences, and the reasons those of the nodes themselves.
Pure; texts only. A page of the docs stands with each, below docs/.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any

from construction_twin.core.reports import WorkReport
from construction_twin.core.sentences import Sentence, has, key_and_values, understood
from construction_twin.views.startup import Missing, Word


class Level(IntEnum):
    """How urgent a line is."""

    #: Nothing is waited for, or the arm moves as it was told.
    WELL = 0
    #: It goes on by itself.
    WAITS = 1
    #: Only a person leads on.
    PERSON = 2


#: Who is waited for. `system` goes on by itself; the others are people: at the cell, with the right to approve, for the machines.
SYSTEM, OPERATOR, REVIEWER, TECHNICIAN = "system", "operator", "reviewer", "technician"
WHO = ("", SYSTEM, OPERATOR, REVIEWER, TECHNICIAN)


@dataclass(frozen=True)
class Urgency:
    """How urgent a state is, and who is waited for.

    Attributes:
        who: One of `WHO`.
        page: Below docs/, with its anchor.
    """

    level: Level
    who: str
    page: str


_STATES, _TROUBLE = "reference/states.md", "troubleshooting.md"
_WORK = "tutorials/work_from_a_model.md"

#: Of each topic and state; what is said stands in the sentences.
TABLE: dict[tuple[str, str], Urgency] = {
    # -- why the gate is closed, through every state of it
    ("cause", "held"): Urgency(Level.PERSON, OPERATOR, "tutorials/stalled_joint.md#3-look"),
    ("cause", "stopped"): Urgency(Level.PERSON, OPERATOR, f"{_TROUBLE}#needs_reset-call-reset"),
    # -- the link to the arm
    ("link", ""): Urgency(Level.PERSON, TECHNICIAN, f"{_STATES}#link"),
    ("link", "DISCONNECTED"): Urgency(Level.PERSON, TECHNICIAN, f"{_STATES}#link"),
    ("link", "GATEWAY_OFFLINE"): Urgency(
        Level.PERSON, TECHNICIAN,
        f"{_TROUBLE}#no-gateway-answers-on-the-broker-start-rsi_gateway-on-the-cell-pc",
    ),
    ("link", "NO_CONTROLLER"): Urgency(Level.PERSON, OPERATOR, f"{_TROUBLE}#gateway-has-no-rsi-session"),
    ("link", "MISMATCH"): Urgency(
        Level.PERSON, TECHNICIAN,
        f"{_TROUBLE}#gateway-runs-another-configuration-its-hash-differs-configuration-hash-the-file-was-edited-export-it-again",
    ),
    ("link", "RESYNC"): Urgency(Level.WAITS, SYSTEM, f"{_STATES}#link"),
    ("link", "ARMED"): Urgency(Level.WELL, "", f"{_STATES}#link"),
    ("link", "NEEDS_RESET"): Urgency(Level.PERSON, OPERATOR, f"{_TROUBLE}#needs_reset-call-reset"),
    # of a bare PLC
    ("link", "NEEDS_NAME"): Urgency(Level.PERSON, OPERATOR, "broker.md#a-plc-that-knows-only-the-string"),
    ("link", "MIRROR"): Urgency(Level.WELL, "", f"{_STATES}#mirror-mode"),
    # -- the gate
    ("sync", ""): Urgency(Level.PERSON, TECHNICIAN, f"{_STATES}#monitor"),
    ("sync", "WAITING"): Urgency(Level.WAITS, SYSTEM, f"{_STATES}#monitor"),
    ("sync", "IN_SYNC"): Urgency(Level.WELL, "", f"{_STATES}#monitor"),
    ("sync", "HOLDING"): Urgency(Level.PERSON, OPERATOR, "tutorials/stalled_joint.md#3-look"),
    ("sync", "REPLANNING"): Urgency(Level.WAITS, SYSTEM, "tutorials/stalled_joint.md#3-look"),
    ("sync", "STALE"): Urgency(Level.WAITS, SYSTEM, f"{_TROUBLE}#comparable-feedback-is"),
    ("sync", "STOPPED"): Urgency(Level.PERSON, OPERATOR, f"{_STATES}#monitor"),
    ("sync", "FAULT"): Urgency(Level.PERSON, TECHNICIAN, f"{_STATES}#monitor"),
    # -- what is executed
    ("execution", ""): Urgency(Level.PERSON, TECHNICIAN, f"{_STATES}#execution"),
    ("execution", "WAITING"): Urgency(Level.WAITS, SYSTEM, f"{_STATES}#execution"),
    ("execution", "IDLE"): Urgency(Level.WELL, "", f"{_STATES}#execution"),
    ("execution", "REVIEW"): Urgency(Level.PERSON, REVIEWER, "planning.md#verdicts"),
    # a plan is under review that could not be approved now
    ("execution", "NOT_YET"): Urgency(Level.WAITS, SYSTEM, "planning.md#verdicts"),
    ("execution", "PLAYING"): Urgency(Level.WELL, "", f"{_STATES}#execution"),
    ("execution", "STOPPING"): Urgency(Level.WAITS, SYSTEM, f"{_STATES}#execution"),
    ("execution", "PAUSING"): Urgency(Level.WAITS, SYSTEM, f"{_STATES}#execution"),
    ("execution", "PAUSED"): Urgency(Level.PERSON, OPERATOR, f"{_STATES}#execution"),
    ("execution", "HELD"): Urgency(Level.WAITS, SYSTEM, f"{_STATES}#execution"),
    ("execution", "AT_BOUNDARY"): Urgency(Level.WAITS, SYSTEM, "planning.md#work-plans"),
    ("execution", "ENGAGED"): Urgency(
        Level.PERSON, REVIEWER,
        f"{_TROUBLE}#the-arm-was-left-in-engaged-segment-the-arm-is-engaged",
    ),
    # -- work from a building model
    ("work", "unavailable"): Urgency(Level.PERSON, TECHNICIAN, f"{_WORK}#3-when-something-stops"),
    ("work", "proposed"): Urgency(Level.PERSON, OPERATOR, "building_model.md#a-model-without-a-schedule"),
    ("work", "engaged"): Urgency(Level.PERSON, REVIEWER, f"{_WORK}#3-when-something-stops"),
    ("work", "asks"): Urgency(Level.PERSON, OPERATOR, f"{_WORK}#3-when-something-stops"),
    ("work", "working"): Urgency(Level.WELL, "", f"{_WORK}#2-look-plan-approve"),
    ("work", "planned"): Urgency(Level.PERSON, REVIEWER, f"{_WORK}#2-look-plan-approve"),
    ("work", "ready"): Urgency(Level.PERSON, OPERATOR, f"{_WORK}#2-look-plan-approve"),
    ("work", "done"): Urgency(Level.WELL, "", f"{_WORK}#2-look-plan-approve"),
    ("work", "waiting"): Urgency(Level.WAITS, SYSTEM, f"{_WORK}#3-when-something-stops"),
    # -- the start
    ("startup", "ready"): Urgency(Level.WELL, "", "tutorials/plan_and_approve.md#1-start"),
    ("startup", "waiting"): Urgency(Level.PERSON, TECHNICIAN, f"{_TROUBLE}#waiting-for-not-ready-any-more"),
}  # fmt: skip
#: Who can do something about what a start waits for; where nothing stands here, a technician.
STARTING = {
    "nodes": SYSTEM,
    "measuring": SYSTEM,
    "running_mock": SYSTEM,
    "cycle": OPERATOR,
    "running": OPERATOR,
    "controller": OPERATOR,
    "no_clock": OPERATOR,
    "cycle_mock": OPERATOR,
    "controller_mock": OPERATOR,
    "plc": OPERATOR,
    "plc_other": OPERATOR,
    "plc_pose": OPERATOR,
    "reset": OPERATOR,
    "responsible": OPERATOR,
    "same_pose": SYSTEM,
    "gate": SYSTEM,
    "gate_reset": OPERATOR,
    "executor": SYSTEM,
}
#: What a start waits for only because the gate is closed.
FOLLOWS = ("gate", "gate_reset", "executor")
#: Order of lines of one level. Why the arm holds comes before everything that follows from it.
TOPICS = ("cause", "startup", "link", "sync", "execution", "work")
#: Of tasks that are carried out.
_UNDER_WAY = frozenset(("working", "gripping", "carrying", "releasing", "retreating"))
_OVER = frozenset(("done", "skipped"))


@dataclass(frozen=True)
class ReportsNow:
    """What the nodes say now; a report that is None is silent.

    Attributes:
        arm: There is a physical arm, so that there is a link.
        bare: A bare PLC takes the commands.
        plan: Id of the plan under review; empty: none.
        obstacle: Why that plan could not be approved now; empty: it could.
        cause: Why the arm holds, as `hold_cause` says it; empty: it does not.
        engaged: The executor reviews the way back only.
        work: None: there is no building model.
        started: It is known what the start waits for.
        missing: What that is; None: everything is there.
    """

    link: Word | None = None
    sync: Word | None = None
    execution: Word | None = None
    arm: bool = True
    bare: bool = False
    plan: str = ""
    obstacle: str = ""
    cause: str = ""
    engaged: bool = False
    work: WorkReport | None = None
    started: bool = False
    missing: Missing | None = None


@dataclass(frozen=True, kw_only=True)
class Line:
    """One line of <prefix>/<robot>/screen: the status line. What has a default may be missing there.

    Attributes:
        words: Key of what is said: ``<topic>.<state>`` of `TABLE`, ``startup.<kind>`` of what a start waits for. A page in another
            language has its own words for it.
        values: What these words name.
        level: Number of a `Level`.
        sentence: With the reason.
        reason: The node's own, where the sentence has it; else empty.
        said: Its key and values; None: it has none.
        waits_for, todo: "" for nothing.
        who, page: As in `Urgency`.
    """

    topic: str
    state: str = ""
    words: str = ""
    values: Mapping[str, str] = field(default_factory=dict)
    level: int = 0
    sentence: str
    reason: str = ""
    said: Mapping[str, Any] | None = None
    waits_for: str = ""
    who: str = ""
    todo: str = ""
    page: str = ""


def status_lines(reports: ReportsNow) -> list[Line]:
    """Return a line for each topic, the most urgent first; where nothing is, what the arm does."""
    lines = []
    if reports.cause:
        state = reports.sync.state if reports.sync is not None else ""
        lines.append(_line("cause", Word(state, reports.cause), "stopped" if state == "STOPPED" else "held"))
    follows = reports.cause and reports.missing is not None and reports.missing.kind in FOLLOWS
    if reports.started and not follows:
        lines.append(_start(reports.missing))
    if reports.arm:
        lines.append(
            _line("link", reports.link, "NEEDS_NAME" if reports.bare and _is(reports.link, "NEEDS_RESET") else "")
        )
    lines.append(_line("sync", reports.sync))
    lines.append(_execution(reports))
    if reports.work is not None:
        lines.append(_line("work", Word(work_state(reports.work), reports.work.reason)))
    # that all is there and agrees is no news
    calm = ("execution", *(topic for topic in TOPICS if topic != "execution"))
    return sorted(lines, key=lambda line: (-line.level, (TOPICS if line.level else calm).index(line.topic)))


def work_state(work: WorkReport) -> str:
    """Return the state of the whole work, as `TABLE` has it."""
    states = {task.state for task in work.tasks}
    if not states:
        return "unavailable"
    for state, holds in (
        ("engaged", work.engaged),
        ("asks", "asks" in states),
        ("working", states & _UNDER_WAY),
        ("planned", "planned" in states),
        ("proposed", work.schedule == "proposed"),
        ("ready", work.next),
        ("done", states <= _OVER),
    ):
        if holds:
            return state
    return "waiting"


def _is(word: Word | None, state: str) -> bool:
    return word is not None and word.state == state


def _start(missing: Missing | None) -> Line:
    if missing is None:
        return _line("startup", Word("ready", ""))
    who = STARTING.get(missing.kind, TECHNICIAN)
    line = _line("startup", Word("waiting", missing.reason))
    return replace(
        line,
        words=f"startup.{missing.kind}",
        values=missing.deployment.values,
        level=int(Level.WAITS if who == SYSTEM else line.level),
        waits_for=missing.what,
        who=who,
        todo=missing.action,
    )


def _execution(reports: ReportsNow) -> Line:
    if not _is(reports.execution, "IDLE"):
        return _line("execution", reports.execution)
    if reports.plan and reports.obstacle:
        return _line("execution", Word("IDLE", reports.obstacle), "NOT_YET")
    return _line("execution", reports.execution, "REVIEW" if reports.plan else "ENGAGED" if reports.engaged else "")


def _line(topic: str, word: Word | None, said: str = "") -> Line:
    """Return the line of a report; `said`: in the words of this state, where they are others than the report's."""
    word = word or Word("", "")
    state = said or word.state
    words = TABLE[topic, state]
    key = f"{topic}.{state or 'silent'}"
    # of a link and a gate that are well the reason is a session's number, or how they came to be
    told = word.reason if words.level is not Level.WELL or topic in ("execution", "work") else ""
    sentence = _said(key, "sentence")
    return Line(
        topic=topic,
        state=word.state,
        words=key,
        values={},
        level=int(words.level),
        sentence=f"{sentence[:-1]}: {told}" if told else sentence,
        reason=told,
        said=key_and_values(understood(told)),
        waits_for=_said(key, "waits"),
        who=words.who,
        todo=_said(key, "todo"),
        page=words.page,
    )


def _said(key: str, part: str) -> str:
    """Return what is said of a state: its `sentence`, what it `waits` for, what is `todo`; "" for nothing."""
    key = f"line.{key}.{part}"
    return Sentence(key) if has(key) else ""

"""The status line that a foreman reads: what the arm does, why it holds, what is waited for, by whom, and what to do."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import IntEnum

from construction_twin.core.reports import WorkReport
from construction_twin.core.sentences import Sentence, SentenceTemplates, templates_of
from construction_twin.views.startup import OPERATOR, REVIEWER, SYSTEM, TECHNICIAN, Missing, ReportedState


class Level(IntEnum):
    """How urgent a line is."""

    #: Nothing is waited for, or the arm moves as it was told.
    WELL = 0
    #: It goes on by itself.
    WAITS = 1
    #: Only a person leads on.
    PERSON = 2


@dataclass(frozen=True)
class Wording:
    """The words for a state: a sentence, who of `startup.WHO` is waited for, for what, what to do, and a page below docs/."""

    level: Level
    who: str
    page: str
    sentence: str
    waits_for: str = ""
    todo: str = ""


_STATES, _TROUBLE = "reference/states.md", "troubleshooting.md"
_WORK = "tutorials/work_from_a_model.md"

#: Of each topic and state.
TABLE: dict[tuple[str, str], Wording] = {
    # -- why the gate is closed, through every state of it
    ("cause", "held"): Wording(Level.PERSON, OPERATOR, "tutorials/stalled_joint.md#3-look",
        Sentence("The arm holds"),
        Sentence("a person who looks why, at the cell"),
        Sentence("look why, at the cell: a joint may be stalled, or the arm touched something"),
    ),
    ("cause", "stopped"): Wording(Level.PERSON, OPERATOR, f"{_TROUBLE}#needs_reset-call-reset",
        Sentence("The arm holds, and needs a reset"),
        Sentence("a reset"),
        Sentence("remove the cause at the cell, then hold Reset here with the right to, else reset at the robot's computer"),
    ),
    # -- the link to the arm
    ("link", ""): Wording(Level.PERSON, TECHNICIAN, f"{_STATES}#link",
        Sentence("Nothing is heard of the link to the arm"),
        Sentence("the bridge"),
        Sentence("look at the log of mqtt_bridge"),
    ),
    ("link", "DISCONNECTED"): Wording(Level.PERSON, TECHNICIAN, f"{_STATES}#link",
        Sentence("The robot's programs have no connection to the broker"),
        Sentence("the broker"),
        Sentence("start the broker, or mend the network to it"),
    ),
    ("link", "GATEWAY_OFFLINE"): Wording(
        Level.PERSON, TECHNICIAN, f"{_TROUBLE}#no-gateway-answers-on-the-broker-start-rsi_gateway-on-the-cell-pc",
        Sentence("The program at the controller does not answer; nothing is sent to the arm"),
        Sentence("the gateway"),
        Sentence("start rsi_gateway on the cell PC"),
    ),
    ("link", "NO_CONTROLLER"): Wording(Level.PERSON, OPERATOR, f"{_TROUBLE}#gateway-has-no-rsi-session",
        Sentence("The controller does not take part; the arm is not ours to move"),
        Sentence("the controller's program"),
        Sentence("start the RSI program at the pendant"),
    ),
    ("link", "MISMATCH"): Wording(
        Level.PERSON, TECHNICIAN,
        f"{_TROUBLE}#gateway-runs-another-configuration-its-hash-differs-configuration-hash-the-file-was-edited-export-it-again",
        Sentence("The program at the controller has another configuration or version; nothing is sent to the arm"),
        Sentence("the right configuration"),
        Sentence("do what the link's reason says: one configuration, version and gateway"),
    ),
    ("link", "OTHER_ARM"): Wording(Level.PERSON, TECHNICIAN, f"{_TROUBLE}#off-the-models",
        Sentence("The controller has the tool elsewhere than the model; nothing is sent to the arm"),
        Sentence("the right arm, tool and base"),
        Sentence("do what the link's reason says, at the pendant or in the robot's files"),
    ),
    ("link", "RESYNC"): Wording(Level.WAITS, SYSTEM, f"{_STATES}#link",
        Sentence("Twin and arm take the same pose; the arm does not move for it"),
        Sentence("the arm to rest"),
    ),
    ("link", "ARMED"): Wording(Level.WELL, "", f"{_STATES}#link",
        Sentence("The arm follows the twin"),
    ),
    ("link", "NEEDS_RESET"): Wording(Level.PERSON, OPERATOR, f"{_TROUBLE}#needs_reset-call-reset",
        Sentence("The arm was stopped, and holds"),
        Sentence("a reset"),
        Sentence("remove the cause, then hold Reset here with the right to, else reset at the robot's computer"),
    ),
    # of a bare PLC
    ("link", "NEEDS_NAME"): Wording(Level.PERSON, OPERATOR, "broker.md#a-plc-that-knows-only-the-string",
        Sentence("The PLC is not armed; nothing is sent to the arm"),
        Sentence("a person who arms it by name"),
        Sentence("see to PLC and arm, then hold Arm here with the right to, else arm it by name at the robot's computer"),
    ),
    ("link", "MIRROR"): Wording(Level.WELL, "", f"{_STATES}#mirror-mode",
        Sentence("The arm leads and the twin follows; nothing is sent to the arm"),
    ),
    # -- the gate
    ("sync", ""): Wording(Level.PERSON, TECHNICIAN, f"{_STATES}#monitor",
        Sentence("Nothing is heard of the comparison of twin and arm"),
        Sentence("the monitor"),
        Sentence("look at the log of pca_monitor"),
    ),
    ("sync", "WAITING"): Wording(Level.WAITS, SYSTEM, f"{_STATES}#monitor",
        Sentence("Twin and arm are not compared yet"),
        Sentence("fresh poses of twin and arm that agree"),
    ),
    ("sync", "IN_SYNC"): Wording(Level.WELL, "", f"{_STATES}#monitor",
        Sentence("Twin and arm agree"),
    ),
    ("sync", "HOLDING"): Wording(Level.PERSON, OPERATOR, "tutorials/stalled_joint.md#3-look",
        Sentence("The arm holds, because it is not where the twin is"),
        Sentence("twin and arm to agree again"),
        Sentence("look why, at the cell: a joint may be stalled, or the arm touched something"),
    ),
    ("sync", "REPLANNING"): Wording(Level.WAITS, SYSTEM, "tutorials/stalled_joint.md#3-look",
        Sentence("The arm holds, and a new way to its goal is being planned; it will wait for approval"),
        Sentence("a new plan"),
    ),
    ("sync", "STALE"): Wording(Level.WAITS, SYSTEM, f"{_TROUBLE}#comparable-feedback-is",
        Sentence("The arm holds, because its pose or its next setpoint did not come in time"),
        Sentence("fresh poses"),
        Sentence("if it stays so, look at network and programs"),
    ),
    ("sync", "STOPPED"): Wording(Level.PERSON, OPERATOR, f"{_STATES}#monitor",
        Sentence("The arm holds, and does not go on by itself"),
        Sentence("a reset"),
        Sentence("remove the cause, then hold Reset here with the right to, else reset at the robot's computer"),
    ),
    ("sync", "FAULT"): Wording(Level.PERSON, TECHNICIAN, f"{_STATES}#monitor",
        Sentence("The arm holds, because it was told to move in a way that it may not"),
        Sentence("a person who looks into it"),
        Sentence("read the reason; the plan is dropped, and the next one is planned anew"),
    ),
    # -- what is executed
    ("execution", ""): Wording(Level.PERSON, TECHNICIAN, f"{_STATES}#execution",
        Sentence("Nothing is heard of what the arm does"),
        Sentence("the executor"),
        Sentence("look at the log of executor"),
    ),
    ("execution", "WAITING"): Wording(Level.WAITS, SYSTEM, f"{_STATES}#execution",
        Sentence("Nothing can be executed yet"),
        Sentence("twin and arm to agree"),
    ),
    ("execution", "IDLE"): Wording(Level.WELL, "", f"{_STATES}#execution",
        Sentence("The arm holds its pose; no plan is executed"),
    ),
    ("execution", "REVIEW"): Wording(Level.PERSON, REVIEWER, "planning.md#verdicts",
        Sentence("The arm holds its pose; a plan waits for approval"),
        Sentence("a verdict"),
        Sentence("look at the plan, then approve or reject it"),
    ),
    # a plan is under review that could not be approved now
    ("execution", "NOT_YET"): Wording(Level.WAITS, SYSTEM, "planning.md#verdicts",
        Sentence("A plan waits, and cannot be approved yet"),
        Sentence("what the reason says"),
    ),
    ("execution", "PLAYING"): Wording(Level.WELL, "", f"{_STATES}#execution",
        Sentence("The arm moves along the approved plan"),
    ),
    ("execution", "STOPPING"): Wording(Level.WAITS, SYSTEM, f"{_STATES}#execution",
        Sentence("The arm brakes; the plan is over"),
        Sentence("the arm to rest"),
    ),
    ("execution", "PAUSING"): Wording(Level.WAITS, SYSTEM, f"{_STATES}#execution",
        Sentence("The arm comes to rest on its path"),
        Sentence("the arm to rest"),
    ),
    ("execution", "PAUSED"): Wording(Level.PERSON, OPERATOR, f"{_STATES}#execution",
        Sentence("The arm rests on its path"),
        Sentence("somebody to go on or to stop"),
        Sentence("press resume, or stop"),
    ),
    ("execution", "HELD"): Wording(Level.WAITS, SYSTEM, f"{_STATES}#execution",
        Sentence("The arm stands on its path, and goes on by itself when twin and arm agree"),
        Sentence("the gate to open"),
        Sentence("look why, at the cell: a joint may be stalled, or the arm touched something"),
    ),
    ("execution", "AT_BOUNDARY"): Wording(Level.WAITS, SYSTEM, "planning.md#work-plans",
        Sentence("The arm stands between two parts of its plan"),
        Sentence("tool and scene to be as planned"),
    ),
    ("execution", "ENGAGED"): Wording(Level.PERSON, REVIEWER, f"{_TROUBLE}#the-arm-was-left-in-engaged-segment-the-arm-is-engaged",
        Sentence("The arm was stopped where it touches something; only the way back can be planned"),
        Sentence("the way back"),
        Sentence("plan the way back, look at it and approve it"),
    ),
    # -- work from a building model
    ("work", "unavailable"): Wording(Level.PERSON, TECHNICIAN, f"{_WORK}#3-when-something-stops",
        Sentence("The building model cannot be worked on"),
        Sentence("the model or its record"),
        Sentence("read the reason, then mend model, cell file or ledger"),
    ),
    ("work", "proposed"): Wording(Level.PERSON, OPERATOR, "building_model.md#a-model-without-a-schedule",
        Sentence("The order of the tasks is only proposed"),
        Sentence("a person who accepts it"),
        Sentence("look at the order, then accept it at the robot's computer (twin work accept)"),
    ),
    ("work", "engaged"): Wording(Level.PERSON, REVIEWER, f"{_WORK}#3-when-something-stops",
        Sentence("A task was stopped; the way back comes first"),
        Sentence("the way back"),
        Sentence("plan the way back, look at it and approve it"),
    ),
    ("work", "asks"): Wording(Level.PERSON, OPERATOR, f"{_WORK}#3-when-something-stops",
        Sentence("A task cannot go on before a person says what is so"),
        Sentence("an answer"),
        Sentence("look at the element, then answer in the tab Work with the right to, else by `twin work answer`"),
    ),
    ("work", "working"): Wording(Level.WELL, "", f"{_WORK}#2-look-plan-approve",
        Sentence("A task is carried out"),
    ),
    ("work", "planned"): Wording(Level.PERSON, REVIEWER, f"{_WORK}#2-look-plan-approve",
        Sentence("A task is planned and waits for approval"),
        Sentence("a verdict"),
        Sentence("look at the plan, then approve or reject it"),
    ),
    ("work", "ready"): Wording(Level.PERSON, OPERATOR, f"{_WORK}#2-look-plan-approve",
        Sentence("The next task can be planned"),
        Sentence("somebody to have it planned"),
        Sentence("plan the next task"),
    ),
    ("work", "done"): Wording(Level.WELL, "", f"{_WORK}#2-look-plan-approve",
        Sentence("Every task is done or skipped"),
    ),
    ("work", "waiting"): Wording(Level.WAITS, SYSTEM, f"{_WORK}#3-when-something-stops",
        Sentence("No task can be planned now"),
        Sentence("what the reason says"),
    ),
    # -- the start
    ("startup", "ready"): Wording(Level.WELL, "", "tutorials/plan_and_approve.md#1-start",
        Sentence("Everything that was started is there"),
    ),
    ("startup", "waiting"): Wording(Level.PERSON, TECHNICIAN, f"{_TROUBLE}#waiting-for-not-ready-any-more",
        Sentence("Not everything is there yet"),
    ),
}  # fmt: skip
#: What a start waits for only because the gate is closed.
FOLLOWS = ("gate", "gate_reset", "executor")
#: Order of lines of one level. Why the arm holds comes before everything that follows from it.
TOPICS = ("cause", "startup", "link", "sync", "execution", "work")
#: Of tasks that are carried out.
_UNDER_WAY = frozenset(("working", "gripping", "carrying", "releasing", "retreating"))
_OVER = frozenset(("done", "skipped"))


@dataclass(frozen=True)
class CurrentReports:
    """The current reports of the nodes; None: silent. `bare`: with a bare PLC; `started`: it is known what the start waits for.

    `plan`, `obstacle`: under review, and why it could not be approved now; `cause`: as `hold_cause`; `work` None: no model.
    """

    link: ReportedState | None = None
    sync: ReportedState | None = None
    execution: ReportedState | None = None
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
    """One line of <prefix>/<robot>/screen, of a state of `TABLE`; `said`: what another language needs (`core.sentences`)."""

    topic: str
    state: str = ""
    level: int = 0
    sentence: str
    waits_for: str = ""
    who: str = ""
    todo: str = ""
    page: str = ""
    said: SentenceTemplates = field(default_factory=dict)


def status_lines(reports: CurrentReports) -> list[Line]:
    """Return a line for each topic, the most urgent first; for none, what the arm does."""
    lines = []
    if reports.cause:
        stopped = reports.sync is not None and reports.sync.state == "STOPPED"
        lines.append(_line("cause", "stopped" if stopped else "held", reports.cause))
    follows = reports.cause and reports.missing is not None and reports.missing.kind in FOLLOWS
    if reports.started and not follows:
        lines.append(_start(reports.missing))
    if reports.arm:
        link = reports.link or ReportedState("", "")
        state = "NEEDS_NAME" if reports.bare and link.state == "NEEDS_RESET" else link.state
        lines.append(_line("link", state, link.reason))
    sync = reports.sync or ReportedState("", "")
    lines.append(_line("sync", sync.state, sync.reason))
    lines.append(_execution(reports))
    if reports.work is not None:
        lines.append(_line("work", work_state(reports.work), reports.work.reason))
    # that all is there and agrees is no news
    calm = ("execution", *(topic for topic in TOPICS if topic != "execution"))
    return sorted(lines, key=lambda line: (-line.level, (TOPICS if line.level else calm).index(line.topic)))


def work_state(work: WorkReport) -> str:
    """Return the state of the whole work, a key of `TABLE`."""
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


def _start(missing: Missing | None) -> Line:
    if missing is None:
        return _line("startup", "ready", "")
    waits = missing.wait_reason
    level = Level.WAITS if waits.who == SYSTEM else Level.PERSON
    text = replace(TABLE["startup", "waiting"], level=level, who=waits.who, waits_for=waits.what, todo=waits.todo)
    return _line_of("startup", missing.kind, text, missing.reason)


def _execution(reports: CurrentReports) -> Line:
    execution = reports.execution or ReportedState("", "")
    if execution.state != "IDLE":
        return _line("execution", execution.state, execution.reason)
    if reports.plan and reports.obstacle:
        return _line("execution", "NOT_YET", reports.obstacle)
    state = "REVIEW" if reports.plan else "ENGAGED" if reports.engaged else "IDLE"
    return _line("execution", state, execution.reason)


def _line(topic: str, state: str, reason: str) -> Line:
    text = TABLE[topic, state]
    # of a link and a gate that are well the reason is a session's number, or how they came to be
    known = text.level is Level.WELL and topic not in ("execution", "work")
    return _line_of(topic, state, text, "" if known else reason)


def _line_of(topic: str, state: str, text: Wording, reason: str) -> Line:
    sentence = Sentence("{sentence}: {reason}", sentence=text.sentence, reason=reason) if reason else text.sentence
    alike = {name: getattr(text, name) for name in ("waits_for", "who", "todo", "page")}
    said = templates_of(sentence, text.waits_for, text.todo)
    return Line(topic=topic, state=state, level=int(text.level), sentence=sentence, said=said, **alike)

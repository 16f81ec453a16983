"""The status line that a foreman reads: what the arm does now, why it holds, what is waited for, by whom, and what to do.

One table gives every state of `link`, `sync`, `execution` and the work its words; the reasons are those of the nodes themselves.
Pure; texts only. A page of the docs stands with each, below docs/.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from enum import IntEnum

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
class Words:
    """What is said of a state.

    Attributes:
        sentence: What the arm does, without the node's own reason.
        waits_for: Empty: nothing.
        who: One of `WHO`.
        todo: Empty: nothing to do.
        page: Below docs/, with its anchor.
    """

    level: Level
    sentence: str
    waits_for: str
    who: str
    todo: str
    page: str


_STATES, _TROUBLE = "reference/states.md", "troubleshooting.md"
_WORK = "tutorials/work_from_a_model.md"
_LOOK = "look why, at the cell: a joint may be stalled, or the arm touched something"

#: Of each topic and state.
TABLE: dict[tuple[str, str], Words] = {
    # -- the link to the arm
    ("link", ""): Words(
        Level.PERSON, "Nothing is heard of the link to the arm.", "the bridge", TECHNICIAN,
        "look at the log of mqtt_bridge", f"{_STATES}#link",
    ),
    ("link", "DISCONNECTED"): Words(
        Level.PERSON, "The robot's programs have no connection to the broker.", "the broker", TECHNICIAN,
        "start the broker, or mend the network to it", f"{_STATES}#link",
    ),
    ("link", "GATEWAY_OFFLINE"): Words(
        Level.PERSON, "The program at the controller does not answer; nothing is sent to the arm.", "the gateway", TECHNICIAN,
        "start rsi_gateway on the cell PC",
        f"{_TROUBLE}#no-gateway-answers-on-the-broker-start-rsi_gateway-on-the-cell-pc",
    ),
    ("link", "NO_CONTROLLER"): Words(
        Level.PERSON, "The controller does not take part; the arm is not ours to move.", "the controller's program", OPERATOR,
        "start the RSI program at the pendant", f"{_TROUBLE}#gateway-has-no-rsi-session",
    ),
    ("link", "MISMATCH"): Words(
        Level.PERSON, "The program at the controller has another configuration or version; nothing is sent to the arm.",
        "the right configuration", TECHNICIAN, "do what the link's reason says: one configuration, version and gateway",
        f"{_TROUBLE}#gateway-runs-another-configuration-its-hash-differs-configuration-hash-the-file-was-edited-export-it-again",
    ),
    ("link", "RESYNC"): Words(
        Level.WAITS, "Twin and arm take the same pose; the arm does not move for it.", "the arm to rest", SYSTEM, "",
        f"{_STATES}#link",
    ),
    ("link", "ARMED"): Words(Level.WELL, "The arm follows the twin.", "", "", "", f"{_STATES}#link"),
    ("link", "NEEDS_RESET"): Words(
        Level.PERSON, "The arm was stopped, and holds.", "a reset", OPERATOR,
        "remove the cause, then call reset at the desk", f"{_TROUBLE}#needs_reset-call-reset",
    ),
    # of a bare PLC
    ("link", "NEEDS_NAME"): Words(
        Level.PERSON, "The PLC is not armed; nothing is sent to the arm.", "a person who arms it by name", OPERATOR,
        "see to PLC and arm, then arm it by name at the desk", "broker.md#a-plc-that-knows-only-the-string",
    ),
    ("link", "MIRROR"): Words(
        Level.WELL, "The arm leads and the twin follows; nothing is sent to the arm.", "", "", "", f"{_STATES}#mirror-mode"
    ),
    # -- the gate
    ("sync", ""): Words(
        Level.PERSON, "Nothing is heard of the comparison of twin and arm.", "the monitor", TECHNICIAN,
        "look at the log of pca_monitor", f"{_STATES}#monitor",
    ),
    ("sync", "WAITING"): Words(
        Level.WAITS, "Twin and arm are not compared yet.", "fresh poses of twin and arm that agree", SYSTEM, "",
        f"{_STATES}#monitor",
    ),
    ("sync", "IN_SYNC"): Words(Level.WELL, "Twin and arm agree.", "", "", "", f"{_STATES}#monitor"),
    ("sync", "HOLDING"): Words(
        Level.PERSON, "The arm holds, because it is not where the twin is.", "twin and arm to agree again", OPERATOR, _LOOK,
        "tutorials/stalled_joint.md#3-look",
    ),
    ("sync", "REPLANNING"): Words(
        Level.WAITS, "The arm holds, and a new way to its goal is being planned; it will wait for approval.",
        "a new plan", SYSTEM, "", "tutorials/stalled_joint.md#3-look",
    ),
    ("sync", "STALE"): Words(
        Level.WAITS, "The arm holds, because its pose or its next setpoint did not come in time.", "fresh poses", SYSTEM,
        "if it stays so, look at network and programs", f"{_TROUBLE}#comparable-feedback-is",
    ),
    ("sync", "STOPPED"): Words(
        Level.PERSON, "The arm holds, and does not go on by itself.", "a reset", OPERATOR,
        "remove the cause, then call reset at the desk", f"{_STATES}#monitor",
    ),
    ("sync", "FAULT"): Words(
        Level.PERSON, "The arm holds, because it was told to move in a way that it may not.", "a person who looks into it",
        TECHNICIAN, "read the reason; the plan is dropped, and the next one is planned anew", f"{_STATES}#monitor",
    ),
    # -- what is executed
    ("execution", ""): Words(
        Level.PERSON, "Nothing is heard of what the arm does.", "the executor", TECHNICIAN, "look at the log of executor",
        f"{_STATES}#execution",
    ),
    ("execution", "WAITING"): Words(
        Level.WAITS, "Nothing can be executed yet.", "twin and arm to agree", SYSTEM, "", f"{_STATES}#execution"
    ),
    ("execution", "IDLE"): Words(Level.WELL, "The arm holds its pose; no plan is executed.", "", "", "", f"{_STATES}#execution"),
    ("execution", "REVIEW"): Words(
        Level.PERSON, "The arm holds its pose; a plan waits for approval.", "a verdict", REVIEWER,
        "look at the plan, then approve or reject it", "planning.md#verdicts",
    ),
    ("execution", "PLAYING"): Words(Level.WELL, "The arm moves along the approved plan.", "", "", "", f"{_STATES}#execution"),
    ("execution", "STOPPING"): Words(
        Level.WAITS, "The arm brakes; the plan is over.", "the arm to rest", SYSTEM, "", f"{_STATES}#execution"
    ),
    ("execution", "PAUSING"): Words(
        Level.WAITS, "The arm comes to rest on its path.", "the arm to rest", SYSTEM, "", f"{_STATES}#execution"
    ),
    ("execution", "PAUSED"): Words(
        Level.PERSON, "The arm rests on its path.", "somebody to go on or to stop", OPERATOR, "press resume, or stop",
        f"{_STATES}#execution",
    ),
    ("execution", "HELD"): Words(
        Level.WAITS, "The arm stands on its path, and goes on by itself when twin and arm agree.", "the gate to open", SYSTEM,
        _LOOK, f"{_STATES}#execution",
    ),
    ("execution", "AT_BOUNDARY"): Words(
        Level.WAITS, "The arm stands between two parts of its plan.", "tool and scene to be as planned", SYSTEM, "",
        "planning.md#work-plans",
    ),
    ("execution", "ENGAGED"): Words(
        Level.PERSON, "The arm was stopped where it touches something; only the way back can be planned.",
        "the way back", REVIEWER, "plan the way back, look at it and approve it",
        f"{_TROUBLE}#the-arm-was-left-in-engaged-segment-the-arm-is-engaged",
    ),
    # -- work from a building model
    ("work", "unavailable"): Words(
        Level.PERSON, "The building model cannot be worked on.", "the model or its record", TECHNICIAN,
        "read the reason, then mend model, cell file or ledger", f"{_WORK}#3-when-something-stops",
    ),
    ("work", "proposed"): Words(
        Level.PERSON, "The order of the tasks is only proposed.", "a person who accepts it", OPERATOR,
        "look at the order, then accept it (twin work accept)", "building_model.md#a-model-without-a-schedule",
    ),
    ("work", "engaged"): Words(
        Level.PERSON, "A task was stopped; the way back comes first.", "the way back", REVIEWER,
        "plan the way back, look at it and approve it", f"{_WORK}#3-when-something-stops",
    ),
    ("work", "asks"): Words(
        Level.PERSON, "A task cannot go on before a person says what is so.", "an answer", OPERATOR,
        "look at the element, then answer (twin work answer)", f"{_WORK}#3-when-something-stops",
    ),
    ("work", "working"): Words(Level.WELL, "A task is carried out.", "", "", "", f"{_WORK}#2-look-plan-approve"),
    ("work", "planned"): Words(
        Level.PERSON, "A task is planned and waits for approval.", "a verdict", REVIEWER,
        "look at the plan, then approve or reject it", f"{_WORK}#2-look-plan-approve",
    ),
    ("work", "ready"): Words(
        Level.PERSON, "The next task can be planned.", "somebody to have it planned", OPERATOR, "plan the next task",
        f"{_WORK}#2-look-plan-approve",
    ),
    ("work", "done"): Words(Level.WELL, "Every task is done or skipped.", "", "", "", f"{_WORK}#2-look-plan-approve"),
    ("work", "waiting"): Words(
        Level.WAITS, "No task can be planned now.", "what the reason says", SYSTEM, "", f"{_WORK}#3-when-something-stops"
    ),
    # -- the start
    ("startup", "ready"): Words(Level.WELL, "Everything that was started is there.", "", "", "",
        "tutorials/plan_and_approve.md#1-start",
    ),
    ("startup", "waiting"): Words(
        Level.PERSON, "Not everything is there yet.", "", TECHNICIAN, "", f"{_TROUBLE}#waiting-for-not-ready-any-more"
    ),
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
#: Order of lines of one level.
TOPICS = ("startup", "link", "sync", "execution", "work")
#: Of tasks that are carried out.
_UNDER_WAY = frozenset(("working", "gripping", "carrying", "releasing", "retreating"))
_OVER = frozenset(("done", "skipped"))


@dataclass(frozen=True)
class WorkFacts:
    """What the status line needs of the building model's tasks.

    Attributes:
        states: Of the tasks; empty: the model cannot be used.
        engaged, proposed: Only the way back can be planned; the schedule was not accepted yet.
        next: The task that comes next; empty: none can.
        reason: What the work waits for.
    """

    states: tuple[str, ...]
    engaged: bool
    proposed: bool
    next: str
    reason: str


@dataclass(frozen=True)
class Heard:
    """What the nodes say now; a report that is None is silent.

    Attributes:
        arm: There is a physical arm, so that there is a link.
        bare: A bare PLC takes the commands.
        plan: Id of the plan under review; empty: none.
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
    engaged: bool = False
    work: WorkFacts | None = None
    started: bool = False
    missing: Missing | None = None


@dataclass(frozen=True)
class Line:
    """One line, as it is sent on `screen`.

    Attributes:
        words: Key of what is said: ``<topic>.<state>`` of `TABLE`, ``startup.<kind>`` of what a start waits for. A page in another
            language has its own words for it.
        values: What these words name.
        level: Number of a `Level`.
        sentence: With the reason.
        reason: The node's own, where the sentence has it; else empty.
        waits_for, who, todo, page: As in `Words`.
    """

    topic: str
    state: str
    words: str
    values: dict[str, str]
    level: int
    sentence: str
    reason: str
    waits_for: str
    who: str
    todo: str
    page: str

    def document(self) -> dict[str, object]:
        """Return it as JSON has it."""
        return asdict(self)


def status_lines(heard: Heard) -> list[Line]:
    """Return a line for each topic, the most urgent first; where nothing is, what the arm does."""
    lines = []
    if heard.started:
        lines.append(_start(heard.missing))
    if heard.arm:
        lines.append(_line("link", heard.link, "NEEDS_NAME" if heard.bare and _is(heard.link, "NEEDS_RESET") else ""))
    lines.append(_line("sync", heard.sync))
    lines.append(_execution(heard))
    if heard.work is not None:
        lines.append(_line("work", Word(work_state(heard.work), heard.work.reason)))
    # that all is there and agrees is no news
    calm = ("execution", *(topic for topic in TOPICS if topic != "execution"))
    return sorted(lines, key=lambda line: (-line.level, (TOPICS if line.level else calm).index(line.topic)))


def work_state(work: WorkFacts) -> str:
    """Return the state of the whole work, as `TABLE` has it."""
    states = set(work.states)
    if not states:
        return "unavailable"
    for state, holds in (
        ("engaged", work.engaged),
        ("asks", "asks" in states),
        ("working", states & _UNDER_WAY),
        ("planned", "planned" in states),
        ("proposed", work.proposed),
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


def _execution(heard: Heard) -> Line:
    said = ""
    if _is(heard.execution, "IDLE"):
        said = "REVIEW" if heard.plan else "ENGAGED" if heard.engaged else ""
    return _line("execution", heard.execution, said)


def _line(topic: str, word: Word | None, said: str = "") -> Line:
    """Return the line of a report; `said`: in the words of this state, where they are others than the report's."""
    word = word or Word("", "")
    state = said or word.state
    words = TABLE[topic, state]
    # of a link and a gate that are well the reason is a session's number, or how they came to be
    told = word.reason if words.level is not Level.WELL or topic in ("execution", "work") else ""
    sentence = f"{words.sentence[:-1]}: {told}" if told else words.sentence
    return Line(
        topic, word.state, f"{topic}.{state or 'silent'}", {}, int(words.level), sentence, told,
        words.waits_for, words.who, words.todo, words.page,
    )  # fmt: skip

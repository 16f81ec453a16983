"""The states of a task, its events as lines of the ledger, and what these say of one task.

Every event but `FREED` and `BLOCKED`, which follow from other tasks, is a line. What a kill leaves open ends in `ASKS`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from enum import Enum
from typing import Any, NamedTuple

from construction_twin.core.sentences import Sentence
from construction_twin.extensions.work.building import WorkError
from construction_twin.extensions.work.process import DEFAULT, MODULES, process_of


class TaskState(Enum):
    """State of a task; values are the words of `WorkTask.msg`. `HELD`: its element is gone, it waits for a person."""

    WAITING = "waiting"
    READY = "ready"
    CARRIED = "carried"
    PLANNED = "planned"
    WORKING = "working"
    GRIPPING = "gripping"
    CARRYING = "carrying"
    RELEASING = "releasing"
    RETREATING = "retreating"
    DONE = "done"
    SKIPPED = "skipped"
    ASKS = "asks"
    HELD = "held"


class TaskEvent(Enum):
    """What can happen to a task; values are the words of the ledger."""

    FREED = "freed"
    BLOCKED = "blocked"
    OFFERED = "offered"
    PLANNED = "planned"
    DROPPED = "dropped"
    BEGUN = "begun"
    GRIPPING = "gripping"
    GRIPPED = "gripped"
    NOT_GRIPPED = "not_gripped"
    RELEASING = "releasing"
    RELEASED = "released"
    FINISHED = "finished"
    STOPPED = "stopped"
    UNKNOWN = "unknown"
    ANSWERED = "answered"
    MEASURED = "measured"
    SKIPPED = "skipped"
    REDONE = "redone"
    REMOVED = "removed"
    FOUND = "found"
    SAME = "same"


class Row(NamedTuple):
    """What an event does in a state; of several rows the first that fits counts.

    `target`: None: the state stays. `change`: key of `CHANGES`. `when`: true attribute of `TaskMemory`, or the answer given.
    """

    state: TaskState
    event: TaskEvent
    target: TaskState | None
    change: str
    when: str


_S, _E = TaskState, TaskEvent


def _rows(
    states: TaskState | Iterable[TaskState],
    event: TaskEvent,
    target: TaskState | None,
    change: str = "",
    when: str = "",
) -> list[Row]:
    every = [states] if isinstance(states, TaskState) else states
    return [Row(state, event, target, change, when) for state in every]


#: States in which a motion of the task may be under way.
UNDER_WAY = (_S.WORKING, _S.GRIPPING, _S.CARRYING, _S.RELEASING, _S.RETREATING)
#: States whose end only a person knows if this process has not seen it.
_DOUBTFUL = (_S.PLANNED, _S.WORKING, _S.GRIPPING, _S.CARRYING, _S.RELEASING)
#: States from which a task is planned.
PLANNABLE = (_S.READY, _S.CARRIED)
#: States for which no other task waits.
SETTLED = (_S.DONE, _S.SKIPPED)

#: What is not in the table is refused.
TABLE: tuple[Row, ...] = (
    *_rows(_S.WAITING, _E.FREED, _S.READY),
    *_rows(_S.READY, _E.BLOCKED, _S.WAITING),
    # written before the plan is offered: from then on somebody may approve it
    *_rows(PLANNABLE, _E.OFFERED, _S.PLANNED, "plan"),
    *_rows(_S.PLANNED, _E.PLANNED, None, "plan"),
    *_rows(_S.PLANNED, _E.DROPPED, _S.CARRIED, "no plan", "in_grip"),
    *_rows(_S.PLANNED, _E.DROPPED, _S.READY, "no plan"),
    *_rows(_S.PLANNED, _E.BEGUN, _S.CARRYING, "plan", "in_grip"),
    *_rows(_S.PLANNED, _E.BEGUN, _S.WORKING, "plan"),
    *_rows(_S.WORKING, _E.GRIPPING, _S.GRIPPING),
    *_rows(_S.WORKING, _E.FINISHED, _S.DONE, "no plan", "stays"),
    *_rows(_S.WORKING, _E.STOPPED, _S.READY, "in stock"),
    *_rows(_S.GRIPPING, _E.GRIPPED, _S.CARRYING, "in grip"),
    *_rows(_S.GRIPPING, _E.NOT_GRIPPED, _S.READY, "in stock"),
    *_rows(_S.CARRYING, _E.RELEASING, _S.RELEASING),
    *_rows((_S.GRIPPING, _S.CARRYING, _S.RELEASING), _E.STOPPED, _S.ASKS, "no plan"),
    *_rows(_S.RELEASING, _E.RELEASED, _S.RETREATING, "placed"),
    *_rows(_S.RETREATING, _E.FINISHED, _S.DONE, "no plan"),
    # the element stands; that the arm stopped on its way out changes nothing about it
    *_rows(_S.RETREATING, _E.STOPPED, _S.DONE, "no plan"),
    *_rows(_S.RETREATING, _E.UNKNOWN, _S.DONE, "no plan"),
    *_rows(_DOUBTFUL, _E.UNKNOWN, _S.ASKS, "no plan"),
    *_rows(_S.ASKS, _E.ANSWERED, _S.READY, "in stock", "in_stock"),
    *_rows(_S.ASKS, _E.ANSWERED, _S.CARRIED, "in grip", "in_grip"),
    *_rows(_S.ASKS, _E.ANSWERED, _S.DONE, "placed as told", "placed"),
    *_rows(_S.ASKS, _E.ANSWERED, _S.HELD, "gone", "gone"),
    *_rows(_S.ASKS, _E.ANSWERED, _S.DONE, "", "done"),
    *_rows(_S.ASKS, _E.ANSWERED, _S.READY, "in stock", "not_done"),
    *_rows((_S.DONE, _S.SKIPPED), _E.MEASURED, None, "measured"),
    *_rows((_S.WAITING, _S.READY, _S.HELD), _E.SKIPPED, _S.SKIPPED),
    # of what people take down: a person says that it is gone
    *_rows((_S.WAITING, _S.READY, _S.SKIPPED), _E.REMOVED, _S.DONE, "gone"),
    # of what was placed: a person has taken it away
    *_rows(_S.DONE, _E.REMOVED, _S.HELD, "gone"),
    # a task of a former model has placed it
    *_rows((_S.WAITING, _S.READY), _E.FOUND, _S.ASKS, "placed"),
    *_rows((_S.WAITING, _S.READY), _E.SAME, _S.DONE, "placed"),
    # a person says that the element is back in its stock; of what was taken down, that it stands
    *_rows((_S.DONE, _S.SKIPPED, _S.HELD), _E.REDONE, _S.READY, "in stock"),
    # the model was changed; of what is in the grip also a person may doubt, and the tool
    *_rows((_S.WAITING, _S.READY, _S.CARRIED, _S.DONE, _S.SKIPPED), _E.UNKNOWN, _S.ASKS, "doubted"),
)

ROWS: dict[tuple[TaskState, TaskEvent], list[Row]] = {
    (state, event): [row for row in TABLE if row[:2] == (state, event)] for state in TaskState for event in TaskEvent
}

_NO_PLAN: dict[str, Any] = {"plan": "", "offer": ""}
_IN_STOCK = {
    **_NO_PLAN, "grip": "", "measured_by": "", "in_grip": False, "placed": False, "gone": False,
    "tool0_T_element": (), "base_T_element": (),
}  # fmt: skip
_IN_GRIP = {"in_grip": True, "placed": False, "gone": False}
_PLACED = {"in_grip": False, "placed": True, "gone": False}

#: What a row changes, from what was known and the event.
CHANGES: Mapping[str, Callable[[TaskMemory, Entry], dict[str, Any]]] = {
    "": lambda memory, entry: {},
    "plan": lambda memory, entry: {
        "plan": entry.plan or memory.plan, "offer": entry.offer or memory.offer, "grip": entry.grip or memory.grip,
        "tool0_T_element": entry.pose or memory.tool0_T_element,
    },
    "no plan": lambda memory, entry: _NO_PLAN,
    "in stock": lambda memory, entry: _IN_STOCK,
    "in grip": lambda memory, entry: {**_IN_GRIP, "tool0_T_element": entry.pose or memory.tool0_T_element},
    "placed": lambda memory, entry: {**_PLACED, "base_T_element": entry.pose, "measured_by": ""},
    # where the model has it until it is measured
    "placed as told": lambda memory, entry: _PLACED,
    "gone": lambda memory, entry: {**_IN_STOCK, "gone": True},
    "doubted": lambda memory, entry: {**_NO_PLAN, "base_T_element": entry.pose or memory.base_T_element},
    "measured": lambda memory, entry: {
        "placed": True, "gone": False, "base_T_element": entry.pose, "measured_by": entry.person,
    },
}  # fmt: skip

#: Answers; of a task whose element stays where it stands; of what no task places any more, with the ledger's word.
ANSWERS = ("in_stock", "in_grip", "placed", "gone")
ANSWERS_OF_STAYING = ("done", "not_done")
ANSWERS_OF_FORMER = {"stands": "placed", "taken_away": "gone"}

#: Events that are about no task.
OPENED, ACCEPTED, MENDED, CHANGED = "opened", "accept_schedule", "mended", "changed"
OF_NO_TASK = (OPENED, ACCEPTED, MENDED, CHANGED)
#: Where the pose of an element that was let go comes from.
FROM_ARM, FROM_PLAN = "measured", "planned"
#: What a person has seen of an element that stands and is not in the model.
NOT_IN_MODEL = "not in the model"

#: What is known last, by state.
_KNOWN = {
    TaskState.WAITING: Sentence("another version of the model was worked on"),
    TaskState.DONE: Sentence("it was placed, for another version of the model"),
    TaskState.SKIPPED: Sentence("it was measured at its place, for another version of the model"),
    TaskState.CARRIED: Sentence("it was in the grip"),
    TaskState.PLANNED: Sentence("it was to be fetched"),
    TaskState.WORKING: Sentence("it was being fetched"),
    TaskState.GRIPPING: Sentence("the grip was being closed on it"),
    TaskState.CARRYING: Sentence("it was carried"),
    TaskState.RELEASING: Sentence("it was being let go at its place"),
}
_KNOWN_OF_STAYING = {
    TaskState.DONE: Sentence("it was done, for another version of the model"),
    TaskState.PLANNED: Sentence("it was to be begun"),
    TaskState.WORKING: Sentence("it was under way"),
}


@dataclass(frozen=True)
class Entry:
    """One line of the ledger.

    Attributes:
        event: Value of a `TaskEvent`, or one of `OF_NO_TASK`.
        body: Digest of the element's pieces (`Ledger.save_bodies`).
        seen: `ModelElement.digest` when it was handled; `NOT_IN_MODEL`.
        former: Of `same`, `found` and `unknown`: the task that handled the element before.
        source: Of `released` and `same`: `FROM_ARM` or `FROM_PLAN`.
        offer: Stands in the plan's `source`.
        pose, goal: Length 7 or 0. How the element is held (`offered`), where it stands (others); where the model had it.
    """

    event: str
    task: str = ""
    element: str = ""
    plan: str = ""
    offer: str = ""
    grip: str = ""
    pose: tuple[float, ...] = ()
    source: str = ""
    answer: str = ""
    person: str = ""
    reason: str = ""
    model: str = ""
    cell: str = ""
    schedule: str = ""
    process: str = ""
    name: str = ""
    body: str = ""
    goal: tuple[float, ...] = ()
    seen: str = ""
    former: str = ""
    robot: str = ""
    time_ns: int = 0

    def fields(self) -> dict:
        """Return what is written of it: all that is not empty."""
        return {name: value for name, value in asdict(self).items() if value and name != "time_ns"}


def entry_of(fields: Mapping[str, Any]) -> Entry:
    """Return a line as it was written."""
    known = {name: value for name, value in fields.items() if name not in ("time", "previous")}
    pose, goal = (tuple(map(float, known.pop(name, ()))) for name in ("pose", "goal"))
    for each in (pose, goal):
        if len(each) not in (0, 7) or not all(map(math.isfinite, each)):
            raise ValueError(f"a pose of {each}; expected seven finite numbers")
    time_ns = int(known.pop("time_ns", 0))
    if not all(isinstance(value, str) for value in known.values()):
        raise ValueError("expected texts")
    process = known.get("process", DEFAULT)
    if process not in MODULES:
        raise ValueError(f"process {process!r}; expected one of {', '.join(MODULES)}")
    event = known.get("event", "")
    if event not in OF_NO_TASK:
        TaskEvent(event)
    return Entry(**known, pose=pose, goal=goal, time_ns=time_ns)


#: States in which an element is surely not in the grip.
_NOT_IN_GRIP = (TaskState.WAITING, TaskState.READY, TaskState.DONE, TaskState.SKIPPED)

#: What lines say of the element; the last one that says it counts.
_ELEMENT = ("element", "name", "body", "goal", "seen")


class NotNow(WorkError):
    """An event does not fit the state of a task."""

    def __init__(self, task: str, state: TaskState, event: TaskEvent):
        super().__init__(f"task {task} is {state.value}; {event.value!r} does not follow from that")


@dataclass(frozen=True)
class TaskMemory:
    """What the ledger says of one task; attributes that `Entry` has are the last known ones.

    Attributes:
        before: The state that a question is about.
        gone: Neither in stock nor placed; of a task that is done: taken down.
        tool0_T_element, base_T_element: Length 7 or 0: position [m], quaternion x, y, z, w.
        as_planned: `base_T_element` is the plan's: nothing was measured.
    """

    task: str
    state: TaskState = TaskState.WAITING
    before: TaskState = TaskState.WAITING
    plan: str = ""
    offer: str = ""
    grip: str = ""
    in_grip: bool = False
    placed: bool = False
    gone: bool = False
    tool0_T_element: tuple[float, ...] = ()
    base_T_element: tuple[float, ...] = ()
    measured_by: str = ""
    as_planned: bool = False
    begun_ns: int = 0
    settled_ns: int = 0
    process: str = ""
    element: str = ""
    name: str = ""
    body: str = ""
    goal: tuple[float, ...] = ()
    seen: str = ""

    @property
    def stays(self) -> bool:
        """Whether the process of its plan leaves the element where it stands."""
        return bool(self.process) and not process_of(self.process).moves

    def accepts(self, entry: Entry) -> bool:
        """Return whether an event fits the present state."""
        return self._row(entry) is not None

    def with_entry(self, entry: Entry) -> TaskMemory:
        """Return what is known after one more event of this task; raise NotNow if it does not fit."""
        row = self._row(entry)
        if row is None:
            raise NotNow(self.task, self.state, TaskEvent(entry.event))
        changed = {"before": row.state, "state": row.target or self.state, **CHANGES[row.change](self, entry)}
        changed |= {name: value for name in _ELEMENT if (value := getattr(entry, name))}
        if row.event in (TaskEvent.RELEASED, TaskEvent.MEASURED, TaskEvent.SAME):
            changed["as_planned"] = entry.source == FROM_PLAN
        if row.event is TaskEvent.OFFERED:
            changed["process"] = entry.process
        if row.event is TaskEvent.BEGUN:
            changed["begun_ns"] = entry.time_ns
        if row.target in SETTLED:
            changed["settled_ns"] = entry.time_ns
        return replace(self, **changed)

    def _row(self, entry: Entry) -> Row | None:
        event = TaskEvent(entry.event)
        answer = entry.answer if entry.answer in self.possible_answers() else None
        for row in ROWS[self.state, event]:
            if not row.when or (row.when == answer if event is TaskEvent.ANSWERED else getattr(self, row.when)):
                return row
        return None

    def possible_answers(self) -> tuple[str, ...]:
        """Return what can be answered now: `placed` only of what was held."""
        if self.state is not TaskState.ASKS:
            return ()
        if self.stays:
            return ANSWERS_OF_STAYING
        if self.before in _NOT_IN_GRIP:
            return ("in_stock", "placed", "gone")
        if self.before in (TaskState.PLANNED, TaskState.WORKING, TaskState.GRIPPING) and not self.in_grip:
            return ("in_stock", "in_grip", "gone")
        return ANSWERS

    def question(self, element_name: str) -> str:
        """Return what a person is asked; empty: nothing."""
        if self.state is not TaskState.ASKS:
            return ""
        return Sentence(
            "was the task on {element} carried out? The last that is known of it: {known}"
            if self.stays
            else "where is {element} now? The last that is known of it: {known}",
            element=element_name,
            known=self.known,
        )

    @property
    def known(self) -> str:
        """What is known last of a task that asks: of where its element is, or of what was done with it."""
        before = self.before
        if before in (TaskState.WAITING, TaskState.READY) and not self.stays:
            # the state says as little of an element that waits as of one that is ready; unless another task has placed it
            before = TaskState.DONE if self.placed else TaskState.WAITING
        # where there are no words for a state, its own
        return (_KNOWN_OF_STAYING if self.stays else _KNOWN).get(before, before.value)

    @property
    def touched(self) -> bool:
        """Whether an element may be elsewhere than in its stock, or is asked about."""
        if self.state is TaskState.DONE and self.gone:
            # what was taken down is gone, whatever the model says since
            return False
        doubtful = (TaskState.PLANNED, TaskState.ASKS, TaskState.DONE, *UNDER_WAY)
        return self.placed or self.in_grip or self.state in doubtful

    @property
    def has_left_stock(self) -> bool:
        """Whether the element has left its stock."""
        # of a skipped task a person takes the element out, so that the next can be delivered
        return self.in_grip or self.placed or self.gone or self.state is TaskState.SKIPPED

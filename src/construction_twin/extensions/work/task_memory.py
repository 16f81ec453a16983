"""The states of a task of a building model, and what the events so far say of one: a value, of which one more event makes another.

Pure. Every event but two is a line of the ledger; `FREED` and `BLOCKED` follow from the states of other tasks. What cannot be known
after a kill ends in `ASKS`: a person says what is so.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from enum import Enum
from typing import Any

from construction_twin.core import state_table
from construction_twin.core.sentences import Sentence
from construction_twin.extensions.work.errors import WorkError
from construction_twin.extensions.work.process import MODULES, process_of
from construction_twin.extensions.work.recipe import DEFAULT


class TaskState(Enum):
    """State of a task; values are the words of `WorkTask.msg`."""

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


class Guard(Enum):
    """What must hold for a row to count; the values are the words of the documentation."""

    ALWAYS = ""
    IN_GRIP = "the element is in the grip"
    STAYS = "its process does not move the element"
    SAYS_STOCK = "the answer is `in_stock`"
    SAYS_GRIP = "the answer is `in_grip`"
    SAYS_PLACED = "the answer is `placed`"
    SAYS_GONE = "the answer is `gone`"
    SAYS_DONE = "the answer is `done`"
    SAYS_NOT_DONE = "the answer is `not_done`"


class Action(Enum):
    """What is done before the next state is entered; the values are the words of the documentation."""

    NOTHING = ""
    KEEP_PLAN = "the plan is kept"
    FORGET_PLAN = "the plan is forgotten"
    IN_GRIP = "the element counts as in the grip, held as told"
    NOT_IN_GRIP = "the element counts as in its stock; the plan is forgotten"
    PLACED = "the element counts as placed, where the arm let go of it"
    PLACED_AS_TOLD = "the element counts as placed, where the model has it until it is measured"
    GONE = "the element counts as gone; the plan is forgotten"
    REMOVED = "the element counts as taken down"
    DOUBTED = "the plan is forgotten; where the element was said to be is kept"
    MEASURED = "the element counts as placed where it was measured"


Row = state_table.Row[TaskState, TaskEvent, Guard, Action]
_S, _E, _G, _A = TaskState, TaskEvent, Guard, Action
rows = state_table.Rows(TaskState, TaskEvent, Guard, Action)

#: States in which a motion of the task may be under way.
UNDER_WAY = (_S.WORKING, _S.GRIPPING, _S.CARRYING, _S.RELEASING, _S.RETREATING)
#: States whose end only a person knows when this process has not seen it.
_DOUBTFUL = (_S.PLANNED, _S.WORKING, _S.GRIPPING, _S.CARRYING, _S.RELEASING)
#: States from which a task is planned.
PLANNABLE = (_S.READY, _S.CARRIED)
#: States for which no other task waits.
SETTLED = (_S.DONE, _S.SKIPPED)

#: What is not in the table is refused by `task_memory.TaskMemory`.
TABLE: tuple[Row, ...] = (
    *rows(_S.WAITING, _E.FREED, _S.READY),
    *rows(_S.READY, _E.BLOCKED, _S.WAITING),
    # written before the plan is offered: from then on somebody may approve it
    *rows(PLANNABLE, _E.OFFERED, _S.PLANNED, _A.KEEP_PLAN),
    *rows(_S.PLANNED, _E.PLANNED, None, _A.KEEP_PLAN),
    *rows(_S.PLANNED, _E.DROPPED, _S.CARRIED, _A.FORGET_PLAN, _G.IN_GRIP),
    *rows(_S.PLANNED, _E.DROPPED, _S.READY, _A.FORGET_PLAN),
    *rows(_S.PLANNED, _E.BEGUN, _S.CARRYING, _A.KEEP_PLAN, _G.IN_GRIP),
    *rows(_S.PLANNED, _E.BEGUN, _S.WORKING, _A.KEEP_PLAN),
    *rows(_S.WORKING, _E.GRIPPING, _S.GRIPPING),
    *rows(_S.WORKING, _E.FINISHED, _S.DONE, _A.FORGET_PLAN, _G.STAYS),
    *rows(_S.WORKING, _E.STOPPED, _S.READY, _A.NOT_IN_GRIP),
    *rows(_S.GRIPPING, _E.GRIPPED, _S.CARRYING, _A.IN_GRIP),
    *rows(_S.GRIPPING, _E.NOT_GRIPPED, _S.READY, _A.NOT_IN_GRIP),
    *rows(_S.GRIPPING, _E.STOPPED, _S.ASKS, _A.FORGET_PLAN),
    *rows(_S.CARRYING, _E.RELEASING, _S.RELEASING),
    *rows(_S.CARRYING, _E.STOPPED, _S.ASKS, _A.FORGET_PLAN),
    *rows(_S.RELEASING, _E.RELEASED, _S.RETREATING, _A.PLACED),
    *rows(_S.RELEASING, _E.STOPPED, _S.ASKS, _A.FORGET_PLAN),
    *rows(_S.RETREATING, _E.FINISHED, _S.DONE, _A.FORGET_PLAN),
    # the element stands; that the arm stopped on its way out changes nothing about it
    *rows(_S.RETREATING, _E.STOPPED, _S.DONE, _A.FORGET_PLAN),
    *rows(_S.RETREATING, _E.UNKNOWN, _S.DONE, _A.FORGET_PLAN),
    *rows(_DOUBTFUL, _E.UNKNOWN, _S.ASKS, _A.FORGET_PLAN),
    *rows(_S.ASKS, _E.ANSWERED, _S.READY, _A.NOT_IN_GRIP, _G.SAYS_STOCK),
    *rows(_S.ASKS, _E.ANSWERED, _S.CARRIED, _A.IN_GRIP, _G.SAYS_GRIP),
    *rows(_S.ASKS, _E.ANSWERED, _S.DONE, _A.PLACED_AS_TOLD, _G.SAYS_PLACED),
    *rows(_S.ASKS, _E.ANSWERED, _S.HELD, _A.GONE, _G.SAYS_GONE),
    *rows(_S.ASKS, _E.ANSWERED, _S.DONE, _A.NOTHING, _G.SAYS_DONE),
    *rows(_S.ASKS, _E.ANSWERED, _S.READY, _A.NOT_IN_GRIP, _G.SAYS_NOT_DONE),
    *rows((_S.DONE, _S.SKIPPED), _E.MEASURED, None, _A.MEASURED),
    *rows((_S.WAITING, _S.READY, _S.HELD), _E.SKIPPED, _S.SKIPPED),
    # of what people take down: a person says that it is gone
    *rows((_S.WAITING, _S.READY, _S.SKIPPED), _E.REMOVED, _S.DONE, _A.REMOVED),
    # of what was placed: a person has taken it away
    *rows(_S.DONE, _E.REMOVED, _S.HELD, _A.GONE),
    # another task, of a former model or in another ledger, has placed it, or has placed what a person says is the same
    *rows((_S.WAITING, _S.READY), _E.FOUND, _S.ASKS, _A.PLACED),
    *rows((_S.WAITING, _S.READY), _E.SAME, _S.DONE, _A.PLACED),
    # a person says that the element is back in its stock; of what was taken down, that it stands
    *rows((_S.DONE, _S.SKIPPED, _S.HELD), _E.REDONE, _S.READY, _A.NOT_IN_GRIP),
    # the model was changed: what the record of the former one says of its elements is no longer sure; of what is
    # in the grip also a person may doubt, and the tool
    *rows((_S.WAITING, _S.READY, _S.CARRIED, _S.DONE, _S.SKIPPED), _E.UNKNOWN, _S.ASKS, _A.DOUBTED),
)

ROWS = state_table.by_cause(TABLE)
#: What a person can answer; the question adds which are possible.
ANSWERS = ("in_stock", "in_grip", "placed", "gone")
#: The same of a task whose process does not move the element.
ANSWERS_OF_STAYING = ("done", "not_done")
#: The same of what was placed by a task that the schedule does not have any more, with what they are in the ledger; before them
#: `SAME`, where the model has a counterpart.
ANSWERS_OF_FORMER = {"stands": "placed", "taken_away": "gone"}
SAME = "same"
#: What can be answered for all that was placed at once: each leaves it an obstacle.
ANSWERS_FOR_ALL = (SAME, "stands", "placed")
#: The guard that each of them satisfies.
SAYS = {
    "in_stock": _G.SAYS_STOCK, "in_grip": _G.SAYS_GRIP, "placed": _G.SAYS_PLACED, "gone": _G.SAYS_GONE,
    "done": _G.SAYS_DONE, "not_done": _G.SAYS_NOT_DONE,
}  # fmt: skip


#: Events that are about no task.
OPENED, ACCEPTED, MENDED, CHANGED = "opened", "accept_schedule", "mended", "changed"
OF_NO_TASK = (OPENED, ACCEPTED, MENDED, CHANGED)
#: Where the pose of an element that was let go comes from.
MEASURED, PLANNED = "measured", "planned"
#: What a person has seen of an element of which they said that it stands, and is not in the model.
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
        event: A `TaskEvent`'s word, or `OPENED`, `ACCEPTED`, `MENDED`, `CHANGED`.
        task, element: GlobalIds; empty where it is about neither.
        name, ifc_class, body, goal: Of the element, as it was handled: what it needs to stand in the scene without its model.
            `body`: digest of its pieces (`Ledger.keep`); `goal`: where the model had it.
        seen: What the model said of the element then, as `book.Present.digest`; of one that it did not have `NOT_IN_MODEL`.
        former: Of `same`, `found` and `unknown`: the task that handled the element, which this one replaces.
        source: Of the pose of `released` and `same`: `MEASURED` by the arm's own feedback, or `PLANNED`: as planned, not measured.
            Of `found`: the ledger that says so.
        plan, offer: `offer` is named in the plan's `source`, so that a plan whose id was never learnt is known again.
        grip: Of `offered`: how it is done, see `jobs.TaskMotions.method`.
        process: Of `offered`; empty: `recipe.DEFAULT`.
        pose, goal: Length 7 or 0. How it will be held (`offered`), or where it stands (`released`, `measured`, `same`) or is said
            to stand (`unknown`, `found`).
        model, cell, schedule: SHA-256 of the model's file; path of the cell file; SHA-256 of the schedule that was accepted.
        time_ns: When it was written, since 1970 [ns].
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
    ifc_class: str = ""
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
_NOT_HELD = (TaskState.WAITING, TaskState.READY, TaskState.DONE, TaskState.SKIPPED)

#: What lines say of the element; the last one that says it counts.
_ELEMENT = ("element", "name", "ifc_class", "body", "goal", "seen")


class NotNow(WorkError):
    """An event does not fit the state of a task."""

    def __init__(self, task: str, state: TaskState, event: TaskEvent):
        self.task, self.state, self.event = task, state, event
        super().__init__(f"task {task} is {state.value}; {event.value!r} does not follow from that")


@dataclass(frozen=True)
class TaskMemory:
    """What the ledger says of one task.

    Attributes:
        before: The state that a question is about: in which its answer was lost.
        plan, offer, grip: Of the plan under review or under way; `grip` stays with the element.
        process: Of the plan that was offered last; empty: `recipe.DEFAULT`.
        element, name, ifc_class, body, goal, seen: Of the element, see `Entry`; empty: no line says it.
        source: The other ledger that says that it was placed; empty: this one.
        in_grip: The element is held by the tool, as far as is known.
        gone: It is neither in its stock nor placed; of a task that is done: taken down.
        tool0_T_element, base_T_element: Length 7 or 0. How it is held, or will be, and where it stands as built: x, y, z [m],
            quaternion x, y, z, w. Empty: not known.
        measured: Who measured where it stands; empty: it is the arm's own pose when it let go, or not known.
        as_planned: Where it stands is where the plan had it: nothing was measured.
        begun_ns, settled_ns: When it was begun, and when it was done or skipped, last, since 1970 [ns]; 0: not yet.
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
    measured: str = ""
    as_planned: bool = False
    begun_ns: int = 0
    settled_ns: int = 0
    process: str = ""
    element: str = ""
    name: str = ""
    ifc_class: str = ""
    body: str = ""
    goal: tuple[float, ...] = ()
    seen: str = ""
    source: str = ""

    @property
    def stays(self) -> bool:
        """Whether the process of its plan leaves the element where it stands."""
        return bool(self.process) and not process_of(self.process).moves

    def takes(self, entry: Entry) -> bool:
        """Return whether an event fits the present state."""
        return self._row(entry) is not None

    def then(self, entry: Entry) -> TaskMemory:
        """Return what is known after one more event of this task.

        Raises:
            NotNow: If it does not fit the state.
        """
        row = self._row(entry)
        if row is None:
            raise NotNow(self.task, self.state, TaskEvent(entry.event))
        changed = {"before": row.state, "state": row.target or self.state, **_CHANGES[row.action](self, entry)}
        changed |= {name: value for name in _ELEMENT if (value := getattr(entry, name))}
        if row.event is TaskEvent.FOUND:
            # "<file> <task> <time>", so that it is asked once
            changed["source"] = entry.source.split(" ")[0]
        if row.event in (TaskEvent.RELEASED, TaskEvent.MEASURED, TaskEvent.SAME):
            changed["as_planned"] = entry.source == PLANNED
        if row.event is TaskEvent.OFFERED:
            changed["process"] = entry.process
        if row.event is TaskEvent.BEGUN:
            changed["begun_ns"] = entry.time_ns
        if row.target in SETTLED:
            changed["settled_ns"] = entry.time_ns
        return replace(self, **changed)

    def possible_answers(self) -> tuple[str, ...]:
        """Return what can be answered now: nothing is placed that was never held."""
        if self.state is not TaskState.ASKS:
            return ()
        if self.stays:
            return ANSWERS_OF_STAYING
        if self.before in _NOT_HELD:
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
        if self.source and not self.stays:
            return Sentence("the ledger {ledger} in the same folder says that it was placed", ledger=self.source)
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
    def taken(self) -> bool:
        """Whether the element does not lie in its stock any more."""
        # of a skipped task a person takes the element out, so that the next can be delivered
        return self.in_grip or self.placed or self.gone or self.state is TaskState.SKIPPED

    def _row(self, entry: Entry) -> Row | None:
        def holds(guard: Guard) -> bool:
            if guard is Guard.IN_GRIP:
                return self.in_grip
            if guard is Guard.STAYS:
                return self.stays
            return entry.answer in self.possible_answers() and SAYS[entry.answer] is guard

        return state_table.row_of(ROWS, self.state, TaskEvent(entry.event), holds)


_NO_PLAN: dict[str, Any] = {"plan": "", "offer": ""}
_IN_STOCK = {
    **_NO_PLAN, "grip": "", "measured": "", "in_grip": False, "placed": False, "gone": False,
    "tool0_T_element": (), "base_T_element": (),
}  # fmt: skip


def _keep_plan(memory: TaskMemory, entry: Entry) -> dict[str, Any]:
    return {
        "plan": entry.plan or memory.plan,
        "offer": entry.offer or memory.offer,
        "grip": entry.grip or memory.grip,
        "tool0_T_element": entry.pose or memory.tool0_T_element,
    }


def _is(in_grip: bool = False, placed: bool = False, gone: bool = False) -> dict[str, Any]:
    """Return that an element is in one place only."""
    return {"in_grip": in_grip, "placed": placed, "gone": gone}


#: What each action of the table changes, from what was known and the event.
_CHANGES: Mapping[Action, Callable[[TaskMemory, Entry], dict[str, Any]]] = {
    Action.NOTHING: lambda memory, entry: {},
    Action.KEEP_PLAN: _keep_plan,
    Action.FORGET_PLAN: lambda memory, entry: _NO_PLAN,
    Action.IN_GRIP: lambda memory, entry: {
        **_is(in_grip=True), "tool0_T_element": entry.pose or memory.tool0_T_element,
    },
    Action.NOT_IN_GRIP: lambda memory, entry: _IN_STOCK,
    Action.PLACED: lambda memory, entry: {**_is(placed=True), "base_T_element": entry.pose, "measured": ""},
    Action.PLACED_AS_TOLD: lambda memory, entry: _is(placed=True),
    Action.GONE: lambda memory, entry: {**_IN_STOCK, "gone": True},
    Action.REMOVED: lambda memory, entry: {**_IN_STOCK, "gone": True},
    Action.DOUBTED: lambda memory, entry: {**_NO_PLAN, "base_T_element": entry.pose or memory.base_T_element},
    Action.MEASURED: lambda memory, entry: {
        "placed": True, "gone": False, "base_T_element": entry.pose, "measured": entry.person,
    },
}  # fmt: skip

"""The states of a task of a building model: one table of states, events, guards, actions and next states.

Pure. Every event but two is a line of the ledger, so that the state of every task follows from replaying it; `FREED` and `BLOCKED`
follow from the states of other tasks. What cannot be known after a kill ends in `ASKS`: a person says what is so.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from construction_twin.core import state_table
from construction_twin.core.work_errors import WorkError


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


class Guard(Enum):
    """What must hold for a row to count; the values are the words of the documentation."""

    ALWAYS = ""
    IN_GRIP = "the element is in the grip"
    SAYS_STOCK = "the answer is `in_stock`"
    SAYS_GRIP = "the answer is `in_grip`"
    SAYS_PLACED = "the answer is `placed`"
    SAYS_GONE = "the answer is `gone`"


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

#: What is not in the table is refused by `TaskMemory`.
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
    *rows((_S.DONE, _S.SKIPPED), _E.MEASURED, None, _A.MEASURED),
    *rows((_S.WAITING, _S.READY, _S.HELD), _E.SKIPPED, _S.SKIPPED),
    # only of what people take down: a person says that it is gone
    *rows((_S.WAITING, _S.READY, _S.SKIPPED), _E.REMOVED, _S.DONE, _A.REMOVED),
    # a person says that the element is back in its stock; of what was taken down, that it stands
    *rows((_S.DONE, _S.SKIPPED, _S.HELD), _E.REDONE, _S.READY, _A.NOT_IN_GRIP),
    # the model was changed: what the record of the former one says of its elements is no longer sure; of what is
    # in the grip also a person may doubt, and the tool
    *rows((_S.WAITING, _S.READY, _S.CARRIED, _S.DONE, _S.SKIPPED), _E.UNKNOWN, _S.ASKS, _A.DOUBTED),
)

ROWS = state_table.by_cause(TABLE)
#: States in which an element is surely not in the grip.
_NOT_HELD = (_S.WAITING, _S.READY, _S.DONE, _S.SKIPPED)

#: What a person can answer, and what it means; the question adds which of them are possible.
ANSWERS = {
    "in_stock": "it lies in its stock, and the grip is empty",
    "in_grip": "it is in the grip, as it was taken",
    "placed": "it stands at its place, and the grip is empty",
    "gone": "it is none of these: it was taken away; it waits until it is skipped or done again",
}
_SAYS = {"in_stock": _G.SAYS_STOCK, "in_grip": _G.SAYS_GRIP, "placed": _G.SAYS_PLACED, "gone": _G.SAYS_GONE}


class NotNow(WorkError):
    """An event does not fit the state of a task."""

    def __init__(self, task: str, state: TaskState, event: TaskEvent):
        self.task, self.state, self.event = task, state, event
        super().__init__(f"task {task} is {state.value}; {event.value!r} does not follow from that")


@dataclass(frozen=True, slots=True)
class TaskOccasion(state_table.Occasion):
    """What a line of the ledger says with an event; `now` is when it was written [ns].

    Attributes:
        answer: One of `ANSWERS`.
        pose: Length 7 or 0. How it will be held (`OFFERED`), or where it stands (`RELEASED`, `MEASURED`) or is said to stand
            (`UNKNOWN`).
        person: Who measured.
        source: Where the pose of `RELEASED` comes from; ``planned``: it is as planned, not measured.
    """

    answer: str = ""
    plan: str = ""
    offer: str = ""
    grip: str = ""
    pose: tuple[float, ...] = ()
    person: str = ""
    source: str = ""


_NOTHING_SAID = TaskOccasion()


@dataclass
class TaskMemory:
    """What the ledger says of one task.

    Attributes:
        before: The state that a question is about: in which its answer was lost.
        plan, offer, grip: Of the plan under review or under way; `grip` stays with the element.
        in_grip: The element is held by the tool, as far as is known.
        gone: It is neither in its stock nor placed; of a task that is done: taken down.
        tool0_T_element, base_T_element: Length 7 or 0. How it is held, or will be, and where it stands as built: x, y, z [m],
            quaternion x, y, z, w. Empty: not known.
        measured: Who measured where it stands; empty: it is the arm's own pose when it let go, or not known.
        as_planned: Where it stands is where the plan had it: nothing was measured.
        begun_ns, settled_ns: When it was begun, and when it was done or skipped, last, since 1970 [ns]; 0: not yet.
    """

    task: str
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

    def __post_init__(self):
        self._machine = state_table.Machine(
            ROWS,
            TaskState.WAITING,
            "",
            state_table.conditions(
                {Guard.IN_GRIP: lambda said: self.in_grip} | {guard: self._is_answer(guard) for guard in _SAYS.values()}
            ),
            {
                Action.KEEP_PLAN: self._keep_plan,
                Action.FORGET_PLAN: self._forget_plan,
                Action.IN_GRIP: self._in_grip,
                Action.NOT_IN_GRIP: self._not_in_grip,
                Action.PLACED: self._placed,
                Action.PLACED_AS_TOLD: self._placed_as_told,
                Action.GONE: self._gone,
                Action.REMOVED: self._gone,
                Action.DOUBTED: self._doubted,
                Action.MEASURED: self._measured,
            },
            after=self._note,
        )

    @property
    def state(self) -> TaskState:
        """The task's."""
        return self._machine.state

    def takes(self, event: TaskEvent, answer: str = "") -> bool:
        """Return whether an event fits the present state."""
        return self._machine.row(event, TaskOccasion(answer=answer)) is not None

    def apply(self, event: TaskEvent, said: TaskOccasion = _NOTHING_SAID) -> None:
        """Let an event happen.

        Raises:
            NotNow: If it does not fit the state; nothing is changed.
        """
        if self._machine.on(event, said):
            raise NotNow(self.task, self.state, event)

    def possible_answers(self) -> tuple[str, ...]:
        """Return what can be answered now: nothing is placed that was never held."""
        if self.state is not TaskState.ASKS:
            return ()
        if self.before in _NOT_HELD:
            return ("in_stock", "placed", "gone")
        if self.before in (TaskState.PLANNED, TaskState.WORKING, TaskState.GRIPPING) and not self.in_grip:
            return ("in_stock", "in_grip", "gone")
        return tuple(ANSWERS)

    def _is_answer(self, guard: Guard) -> Callable[[TaskOccasion], bool]:
        return lambda said: said.answer in self.possible_answers() and _SAYS[said.answer] is guard

    def _note(self, row: Row, said: TaskOccasion) -> None:
        self.before = row.state
        if row.event in (TaskEvent.RELEASED, TaskEvent.MEASURED):
            self.as_planned = said.source == "planned"
        if row.event is TaskEvent.BEGUN:
            self.begun_ns = said.now
        if row.target in SETTLED:
            self.settled_ns = said.now

    # -- actions

    def _keep_plan(self, row: Row, said: TaskOccasion) -> None:
        self.plan, self.offer, self.grip = said.plan or self.plan, said.offer or self.offer, said.grip or self.grip
        self.tool0_T_element = said.pose or self.tool0_T_element

    def _forget_plan(self, row: Row, said: TaskOccasion) -> None:
        self.plan = self.offer = ""

    def _doubted(self, row: Row, said: TaskOccasion) -> None:
        self.plan = self.offer = ""
        self.base_T_element = said.pose or self.base_T_element

    def _in_grip(self, row: Row, said: TaskOccasion) -> None:
        self.in_grip, self.placed, self.gone = True, False, False
        self.tool0_T_element = said.pose or self.tool0_T_element

    def _not_in_grip(self, row: Row, said: TaskOccasion) -> None:
        self.plan = self.offer = self.grip = self.measured = ""
        self.in_grip = self.placed = self.gone = False
        self.tool0_T_element = self.base_T_element = ()

    def _placed(self, row: Row, said: TaskOccasion) -> None:
        self.in_grip, self.placed, self.gone, self.measured = False, True, False, ""
        self.base_T_element = said.pose

    def _placed_as_told(self, row: Row, said: TaskOccasion) -> None:
        self.in_grip, self.placed, self.gone = False, True, False

    def _gone(self, row: Row, said: TaskOccasion) -> None:
        self._not_in_grip(row, said)
        self.gone = True

    def _measured(self, row: Row, said: TaskOccasion) -> None:
        self.placed, self.gone, self.base_T_element, self.measured = True, False, said.pose, said.person

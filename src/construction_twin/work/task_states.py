"""The states of a task of a building model: one table of states, events, guards, actions and next states.

Pure. Every event but two is a line of the ledger, from which `book` computes the state of every task; `FREED` and `BLOCKED` follow
from the states of other tasks. What cannot be known after a kill ends in `ASKS`: a person says what is so.
"""

from __future__ import annotations

from enum import Enum

from construction_twin.core import state_table


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
#: What a person can answer: what it means are the sentences ``work.answer.<answer>``; the question adds which are possible.
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

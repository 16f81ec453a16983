"""The state machine of the executor: one table of states, events, guards, actions and the states that they lead to.

Pure. What causes an event, and how guards and actions are carried out, is in `executor`; the table only says what follows.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum

from construction_twin.core import state_table
from construction_twin.monitor.states import SyncState


class ExecutorState(Enum):
    """What the executor is doing; values are those of `Execution.msg`."""

    WAITING = 0
    IDLE = 1
    PLAYING = 2
    STOPPING = 3
    PAUSING = 4
    PAUSED = 5
    HELD = 6
    AT_BOUNDARY = 7


class ExecutorEvent(Enum):
    """What can happen to the executor."""

    AGREED = "agreed"
    TWIN_LOST = "twin_lost"
    NEW_SESSION = "new_session"
    APPROVED = "approved"
    STOP = "stop"
    PAUSE = "pause"
    RESUME = "resume"
    GATE_HOLDS = "gate_holds"
    GATE_ENDS = "gate_ends"
    GATE_OPENS = "gate_opens"
    DISARMED = "disarmed"
    STALLED = "stalled"
    AT_REST = "at_rest"
    GOAL = "goal"
    SEGMENT_END = "segment_end"
    NEXT_SEGMENT = "next_segment"
    TIMEOUT = "timeout"
    REFUSED = "refused"
    LOST = "lost"


class Guard(Enum):
    """What must be true for a row of the table to count; values are the words of the documentation."""

    ALWAYS = ""
    BEGUN = "a setpoint of the plan was sent"
    KNOWN = "the last setpoint that passed the gate is one of this plan"
    PAUSED = "it was pausing or paused before, or `pause` was called meanwhile"
    WORK = "the plan is a work plan"
    BOUNDARY = "it stands at the end of a segment"


class Action(Enum):
    """What is done before the next state is entered; values are the words of the documentation."""

    NOTHING = ""
    START_FROM_TWIN = "the setpoint begins at the twin's pose"
    FORGET_TWIN = "twin's pose and agreement are forgotten"
    PLAY = "the plan begins with the next cycle"
    BRAKE = "brakes along the path as hard as the acceleration limits allow"
    STAND = "stands where the last setpoint that passed the gate was"
    NOTE_PAUSE = "stays PAUSED when the gate opens"
    ARRIVE = "rests at the end of the segment"
    ENTER = "the next segment begins with the next cycle"
    VOID = "switches that are armed and have not fired are void"
    REARM = "switches that the gateway reports as void are armed anew"
    FINISH = "the plan ends: `finished`"
    STOP = "the plan ends: `stopped`"
    LOSE = "the plan ends: `held`"
    DROP = "the plan ends: `dropped`"


#: The word on `Execution.msg` of an action that ends a plan.
OUTCOMES = {Action.FINISH: "finished", Action.STOP: "stopped", Action.LOSE: "held", Action.DROP: "dropped"}


Row = state_table.Row[ExecutorState, ExecutorEvent, Guard, Action]

#: The setpoints may change from cycle to cycle.
MOVING = (ExecutorState.PLAYING, ExecutorState.STOPPING, ExecutorState.PAUSING)
#: A plan stands at rest on its path.
RESTING = (ExecutorState.PAUSED, ExecutorState.HELD, ExecutorState.AT_BOUNDARY)
#: An approved plan is not at its end.
ACTIVE = (*MOVING, *RESTING)
#: States of the gate that a plan survives under the policy `resume`.
SURVIVED = (SyncState.HOLDING, SyncState.STALE)

_S, _E = ExecutorState, ExecutorEvent


def _rows(
    states: Iterable[ExecutorState],
    event: ExecutorEvent,
    action: Action,
    target: ExecutorState | None = None,
    guard: Guard = Guard.ALWAYS,
) -> list[Row]:
    """Return the same row for several states; without a target each stays what it is."""
    return [row for state in states for row in state_table.rows([state], event, guard, action, target or state)]


#: Of the rows for one state and event the first whose guard is true counts. What is not in the table changes nothing in that state.
TABLE: tuple[Row, ...] = (
    *_rows([_S.WAITING], _E.AGREED, Action.START_FROM_TWIN, _S.IDLE),
    *_rows([_S.IDLE], _E.TWIN_LOST, Action.FORGET_TWIN, _S.WAITING),
    *_rows([_S.WAITING, _S.IDLE], _E.NEW_SESSION, Action.FORGET_TWIN, _S.WAITING),
    # it is in IDLE for a moment: there the event is taken again
    *_rows(ACTIVE, _E.NEW_SESSION, Action.DROP, _S.IDLE),
    *_rows([_S.IDLE], _E.APPROVED, Action.PLAY, _S.AT_BOUNDARY, Guard.WORK),
    *_rows([_S.IDLE], _E.APPROVED, Action.PLAY, _S.PLAYING),
    # a stop, by a person, a changed scene, or another arm on the path
    *_rows([_S.PLAYING, _S.PAUSING], _E.STOP, Action.BRAKE, _S.STOPPING, Guard.BEGUN),
    *_rows([_S.PLAYING, _S.PAUSING], _E.STOP, Action.STOP, _S.IDLE),
    *_rows(RESTING, _E.STOP, Action.STOP, _S.IDLE),
    # the first cause is the cause, and the path is measured from there
    *_rows([_S.STOPPING], _E.STOP, Action.NOTHING),
    *_rows([_S.PLAYING], _E.PAUSE, Action.NOTHING, _S.PAUSING),
    *_rows([_S.PAUSING, _S.PAUSED], _E.PAUSE, Action.NOTHING),
    *_rows([_S.HELD], _E.PAUSE, Action.NOTE_PAUSE),
    *_rows([_S.AT_BOUNDARY], _E.PAUSE, Action.VOID, _S.PAUSED),
    *_rows([_S.PAUSED], _E.RESUME, Action.REARM, _S.AT_BOUNDARY, Guard.BOUNDARY),
    *_rows([_S.PAUSING, _S.PAUSED], _E.RESUME, Action.NOTHING, _S.PLAYING),
    # the gate has closed, and the plan survives it
    # of a work plan none survives: tool and scene may be in between, so the rest is planned anew
    *_rows([_S.PLAYING, _S.PAUSING, _S.PAUSED], _E.GATE_HOLDS, Action.LOSE, _S.IDLE, Guard.WORK),
    *_rows([_S.PLAYING, _S.PAUSING, _S.PAUSED], _E.GATE_HOLDS, Action.STAND, _S.HELD, Guard.KNOWN),
    *_rows([_S.PLAYING, _S.PAUSING, _S.PAUSED, _S.AT_BOUNDARY], _E.GATE_HOLDS, Action.LOSE, _S.IDLE),
    *_rows([_S.STOPPING], _E.GATE_HOLDS, Action.STOP, _S.IDLE),
    # it has closed, and the plan does not
    *_rows(ACTIVE, _E.GATE_ENDS, Action.LOSE, _S.IDLE),
    *_rows([_S.HELD], _E.GATE_OPENS, Action.NOTHING, _S.PAUSED, Guard.PAUSED),
    *_rows([_S.HELD], _E.GATE_OPENS, Action.NOTHING, _S.PLAYING),
    *_rows(ACTIVE, _E.DISARMED, Action.DROP, _S.IDLE),
    *_rows(MOVING, _E.STALLED, Action.DROP, _S.IDLE),
    *_rows([_S.STOPPING], _E.AT_REST, Action.STOP, _S.IDLE),
    *_rows([_S.PAUSING], _E.AT_REST, Action.NOTHING, _S.PAUSED),
    *_rows([_S.PLAYING, _S.STOPPING, _S.PAUSING, _S.PAUSED, _S.AT_BOUNDARY], _E.GOAL, Action.FINISH, _S.IDLE),
    # a work plan: nothing passes the end of a segment before tool and scene are as planned
    *_rows([_S.PLAYING], _E.SEGMENT_END, Action.ARRIVE, _S.AT_BOUNDARY),
    *_rows([_S.PAUSING], _E.SEGMENT_END, Action.ARRIVE, _S.PAUSED),
    *_rows([_S.STOPPING], _E.SEGMENT_END, Action.STOP, _S.IDLE),
    *_rows([_S.AT_BOUNDARY], _E.NEXT_SEGMENT, Action.ENTER, _S.PLAYING),
    # what has not begun when its approval, or a resume, is void never begins by itself
    *_rows([_S.PLAYING, _S.HELD, _S.AT_BOUNDARY], _E.TIMEOUT, Action.STOP, _S.IDLE),
    *_rows([_S.AT_BOUNDARY], _E.REFUSED, Action.STOP, _S.IDLE),
    *_rows([_S.PLAYING, _S.PAUSING], _E.LOST, Action.BRAKE, _S.STOPPING),
    *_rows([_S.PAUSED, _S.AT_BOUNDARY], _E.LOST, Action.STOP, _S.IDLE),
)

ROWS = state_table.by_cause(TABLE)

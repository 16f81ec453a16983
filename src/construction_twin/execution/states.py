"""The state machine of the executor: one table of states, events, guards, actions and the states that they lead to.

Pure. What causes an event, and how guards and actions are carried out, is in `executor`; the table only says what follows.
"""

from __future__ import annotations

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
    """Event of the executor."""

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
    """Condition of a row; values are the words of the documentation."""

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
    PAUSE_AFTER_HOLD = "stays PAUSED when the gate opens"
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
rows = state_table.Rows(ExecutorState, ExecutorEvent, Guard, Action)

#: Of the rows for one state and event the first whose guard is true counts. What is not in the table changes nothing in that state.
TABLE: tuple[Row, ...] = (
    *rows(_S.WAITING, _E.AGREED, _S.IDLE, Action.START_FROM_TWIN),
    *rows(_S.IDLE, _E.TWIN_LOST, _S.WAITING, Action.FORGET_TWIN),
    *rows((_S.WAITING, _S.IDLE), _E.NEW_SESSION, _S.WAITING, Action.FORGET_TWIN),
    # it is in IDLE for a moment: there the event is taken again
    *rows(ACTIVE, _E.NEW_SESSION, _S.IDLE, Action.DROP),
    *rows(_S.IDLE, _E.APPROVED, _S.AT_BOUNDARY, Action.PLAY, Guard.WORK),
    *rows(_S.IDLE, _E.APPROVED, _S.PLAYING, Action.PLAY),
    # a stop, by a person, a changed scene, or another arm on the path
    *rows((_S.PLAYING, _S.PAUSING), _E.STOP, _S.STOPPING, Action.BRAKE, Guard.BEGUN),
    *rows((_S.PLAYING, _S.PAUSING), _E.STOP, _S.IDLE, Action.STOP),
    *rows(RESTING, _E.STOP, _S.IDLE, Action.STOP),
    # the first cause is the cause, and the path is measured from there
    *rows(_S.STOPPING, _E.STOP, _S.STOPPING),
    *rows(_S.PLAYING, _E.PAUSE, _S.PAUSING),
    *rows(_S.PAUSING, _E.PAUSE, _S.PAUSING),
    *rows(_S.PAUSED, _E.PAUSE, _S.PAUSED),
    *rows(_S.HELD, _E.PAUSE, _S.HELD, Action.PAUSE_AFTER_HOLD),
    *rows(_S.AT_BOUNDARY, _E.PAUSE, _S.PAUSED, Action.VOID),
    *rows(_S.PAUSED, _E.RESUME, _S.AT_BOUNDARY, Action.REARM, Guard.BOUNDARY),
    *rows((_S.PAUSING, _S.PAUSED), _E.RESUME, _S.PLAYING),
    # the gate has closed, and the plan survives it
    # of a work plan none survives: tool and scene may be in between, so the rest is planned anew
    *rows((_S.PLAYING, _S.PAUSING, _S.PAUSED), _E.GATE_HOLDS, _S.IDLE, Action.LOSE, Guard.WORK),
    *rows((_S.PLAYING, _S.PAUSING, _S.PAUSED), _E.GATE_HOLDS, _S.HELD, Action.STAND, Guard.KNOWN),
    *rows((_S.PLAYING, _S.PAUSING, _S.PAUSED, _S.AT_BOUNDARY), _E.GATE_HOLDS, _S.IDLE, Action.LOSE),
    *rows(_S.STOPPING, _E.GATE_HOLDS, _S.IDLE, Action.STOP),
    # it has closed, and the plan does not
    *rows(ACTIVE, _E.GATE_ENDS, _S.IDLE, Action.LOSE),
    *rows(_S.HELD, _E.GATE_OPENS, _S.PAUSED, Action.NOTHING, Guard.PAUSED),
    *rows(_S.HELD, _E.GATE_OPENS, _S.PLAYING),
    *rows(ACTIVE, _E.DISARMED, _S.IDLE, Action.DROP),
    *rows(MOVING, _E.STALLED, _S.IDLE, Action.DROP),
    *rows(_S.STOPPING, _E.AT_REST, _S.IDLE, Action.STOP),
    *rows(_S.PAUSING, _E.AT_REST, _S.PAUSED),
    *rows((_S.PLAYING, _S.STOPPING, _S.PAUSING, _S.PAUSED, _S.AT_BOUNDARY), _E.GOAL, _S.IDLE, Action.FINISH),
    # a work plan: nothing passes the end of a segment before tool and scene are as planned
    *rows(_S.PLAYING, _E.SEGMENT_END, _S.AT_BOUNDARY, Action.ARRIVE),
    *rows(_S.PAUSING, _E.SEGMENT_END, _S.PAUSED, Action.ARRIVE),
    *rows(_S.STOPPING, _E.SEGMENT_END, _S.IDLE, Action.STOP),
    *rows(_S.AT_BOUNDARY, _E.NEXT_SEGMENT, _S.PLAYING, Action.ENTER),
    # what has not begun when its approval, or a resume, is void never begins by itself
    *rows((_S.PLAYING, _S.HELD, _S.AT_BOUNDARY), _E.TIMEOUT, _S.IDLE, Action.STOP),
    *rows(_S.AT_BOUNDARY, _E.REFUSED, _S.IDLE, Action.STOP),
    *rows((_S.PLAYING, _S.PAUSING), _E.LOST, _S.STOPPING, Action.BRAKE),
    *rows((_S.PAUSED, _S.AT_BOUNDARY), _E.LOST, _S.IDLE, Action.STOP),
)

ROWS = state_table.rows_by_event(TABLE)

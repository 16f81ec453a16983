"""The state machine of the pose checking algorithm: one table of states, events, guards, actions and next states."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from construction_twin.core import state_table
from construction_twin.monitor.comparison import Comparison


class SyncState(Enum):
    """State of the pose checking algorithm; values are those of `Sync.msg`."""

    WAITING = 0
    IN_SYNC = 1
    HOLDING = 2
    REPLANNING = 3
    STALE = 4
    STOPPED = 5
    FAULT = 6


class SyncEvent(Enum):
    """Event of the gate; values are the words of `Transition.msg`."""

    STARTED = "started"
    NEW_SESSION = "new_session"
    MIRROR = "mirror"
    OPENED = "opened"
    POSE_DIFFERS = "pose_differs"
    FEEDBACK_STALE = "feedback_stale"
    SETPOINT_STALE = "setpoint_stale"
    SETPOINT_REFUSED = "setpoint_refused"
    REPLAN_ASKED = "replan_asked"
    REPLAN_FAILED = "replan_failed"
    POLICY_STOP = "policy_stop"
    ESCALATED = "escalated"
    GAVE_UP = "gave_up"
    STOPPED_BEFORE = "stopped_before"
    CONFIGURED = "configured"
    SERVOS_REFINED = "servos_refined"


class Guard(Enum):
    """Condition of a row; the values are the words of the documentation."""

    ALWAYS = ""
    UNCOUNTED = "the present hold was not counted yet"
    STOP_POLICY = "the policy was `stop` when the gate closed"
    TOO_MANY = "`escalate_count` holds were counted within `escalate_time`"
    HELD_TOO_LONG = "the gate has been closed for more than `give_up_time`"


class Action(Enum):
    """What is done before the next state is entered; the values are the words of the documentation."""

    NOTHING = ""
    FORGET = "poses, lag and counted holds are forgotten"
    HOLD = "the command is frozen; agreement counts from now on"
    HOLD_AND_COUNT = "the command is frozen; agreement counts from now on; the hold is counted"
    COUNT = "the hold is counted"
    KEEP_REASON = "the state's sentence stays"


Row = state_table.Row[SyncState, SyncEvent, Guard, Action]
_S, _E = SyncState, SyncEvent
rows = state_table.Rows(SyncState, SyncEvent, Guard, Action)

#: States of a gate that was closed by a violation, and may open again by itself.
HELD_STATES = (_S.HOLDING, _S.REPLANNING, _S.STALE, _S.FAULT)

#: What is not in the table changes nothing in that state.
TABLE: tuple[Row, ...] = (
    # a person has to see to what is STOPPED: only a new command session leads out
    *rows(_S, _E.NEW_SESSION, _S.WAITING, Action.FORGET),
    *rows((_S.WAITING, _S.IN_SYNC, *HELD_STATES), _E.MIRROR, _S.WAITING, Action.FORGET),
    *rows(_S.WAITING, _E.STARTED, _S.WAITING),
    *rows(_S.WAITING, _E.STOPPED_BEFORE, _S.STOPPED),
    *rows(_S.WAITING, _E.CONFIGURED, _S.WAITING, Action.KEEP_REASON),
    *rows(_S.IN_SYNC, _E.CONFIGURED, _S.IN_SYNC, Action.KEEP_REASON),
    *rows(_S.STOPPED, _E.CONFIGURED, _S.STOPPED, Action.KEEP_REASON),
    *rows(_S.IN_SYNC, _E.SERVOS_REFINED, _S.IN_SYNC, Action.KEEP_REASON),
    *rows((_S.WAITING, *HELD_STATES), _E.OPENED, _S.IN_SYNC),
    *rows(_S.IN_SYNC, _E.POSE_DIFFERS, _S.HOLDING, Action.HOLD_AND_COUNT),
    # silence is not counted: no pose has differed, and whether the link is lost is for the bridge to say
    *rows(_S.IN_SYNC, _E.FEEDBACK_STALE, _S.STALE, Action.HOLD),
    *rows(_S.IN_SYNC, _E.SETPOINT_STALE, _S.STALE, Action.HOLD),
    *rows(_S.IN_SYNC, _E.SETPOINT_REFUSED, _S.FAULT, Action.HOLD_AND_COUNT),
    # the silence has ended in a contradiction: that the arm was silent before does not excuse it
    *rows(_S.STALE, _E.POSE_DIFFERS, _S.HOLDING, Action.COUNT, Guard.UNCOUNTED),
    *rows(_S.REPLANNING, _E.POSE_DIFFERS, None, Action.COUNT, Guard.UNCOUNTED),
    # what may follow a violation at once
    *rows((_S.HOLDING, _S.STALE, _S.FAULT), _E.POLICY_STOP, _S.STOPPED, guard=Guard.STOP_POLICY),
    *rows((_S.HOLDING, _S.REPLANNING, _S.FAULT), _E.ESCALATED, _S.STOPPED, guard=Guard.TOO_MANY),
    # a source of setpoints that no robot can execute, FAULT, is not asked for a new plan
    *rows((_S.HOLDING, _S.STALE), _E.REPLAN_ASKED, _S.REPLANNING),
    *rows(_S.REPLANNING, _E.REPLAN_FAILED, _S.HOLDING),
    *rows(HELD_STATES, _E.GAVE_UP, _S.STOPPED, guard=Guard.HELD_TOO_LONG),
)

ROWS = state_table.rows_by_event(TABLE)


@dataclass(frozen=True)
class Transition:
    """One change of state.

    Attributes:
        at: When [ns], on the gate's own clock, until the monitor reports it in ROS time.
        reason: One sentence with the values.
        comparison: The newest comparison of the poses at that moment; None before the first.
        held_stamp: Stamp of the last setpoint that passed [ns]; 0 when none.
    """

    at: int
    source: SyncState
    target: SyncState
    event: SyncEvent
    reason: str
    comparison: Comparison | None
    held_stamp: int

    def __str__(self) -> str:
        return f"{self.source.name} -> {self.target.name} ({self.event.value}): {self.reason}"

"""The state machine of the action `follow_joint_trajectory`: states, events, guards and actions, and what follows from what.

Pure. What causes an event, and how guards and actions are carried out, is in `trajectory_goals`; the table only says what follows.
"""

from __future__ import annotations

from enum import Enum

from construction_twin.core import state_table


class GoalState(Enum):
    """What becomes of a goal; values are the words of the documentation."""

    FREE = "FREE"
    PLANNING = "PLANNING"
    DISCARDING = "DISCARDING"
    REVIEW = "REVIEW"
    WITHDRAWING = "WITHDRAWING"
    MOVING = "MOVING"
    BRAKING = "BRAKING"
    STOPPED = "STOPPED"
    SETTLING = "SETTLING"


class GoalEvent(Enum):
    """What can happen to a goal."""

    GOAL = "goal"
    CANCEL = "cancel"
    PLANNED = "planned"
    NOT_PLANNED = "not_planned"
    TURNED_DOWN = "turned_down"
    STARTED = "started"
    FINISHED = "finished"
    ENDED = "ended"
    LOST = "lost"
    OFF_PATH = "off_path"
    STILL = "still"
    AT_GOAL = "at_goal"
    TOO_LATE = "too_late"


class Guard(Enum):
    """What must be true for a row of the table to count; values are the words of the documentation."""

    ALWAYS = ""
    BUSY = "the executor follows a plan that is of no goal of this action"
    STRANGER = "the goal is from another client"


class Action(Enum):
    """What is done before the next state is entered; values are the words of the documentation."""

    NOTHING = ""
    ASK = "the planner is asked for a plan"
    TURN_AWAY = "the new goal is rejected, naming who has the arm"
    TURN_AWAY_BUSY = "the goal is rejected, naming the plan"
    LINE_UP = "the new goal waits; one that waited before is recalled"
    REPLACE = "the goal ends: recalled or preempted; the new one waits"
    WITHDRAW = "the plan is rejected in the client's name"
    WITHDRAW_FOR_NEXT = "the plan is rejected in the client's name; the new goal waits"
    ACCEPT = "the goal is active: its status says that it waits for approval"
    REFUSE = "the goal is rejected: INVALID_GOAL, with the planner's sentence"
    RECALL = "the goal ends: recalled"
    PREEMPT = "the goal ends: preempted"
    ABORT_INVALID = "the goal is aborted: INVALID_GOAL, with the reviewer's sentence"
    ABORT_PATH = "the goal is aborted: PATH_TOLERANCE_VIOLATED where the gate closed, else GOAL_TOLERANCE_VIOLATED"
    ABORT_GOAL = "the goal is aborted: GOAL_TOLERANCE_VIOLATED"
    END_STOPPED = "the goal ends: preempted, or aborted with PATH_TOLERANCE_VIOLATED, after what it braked for"
    GIVE_UP = "the same, and a goal that waits is recalled"
    BRAKE = "the executor's `stop_plan` is called"
    BRAKE_FOR_NEXT = "the executor's `stop_plan` is called; the new goal waits"
    BRAKE_OFF_PATH = "the executor's `stop_plan` is called, because a joint is off the path"
    SAY_MOVING = "the status says that it moves"
    SUCCEED = "the goal succeeds"


Row = state_table.Row[GoalState, GoalEvent, Guard, Action]
_S, _E, _A, _G = GoalState, GoalEvent, Action, Guard


def _row(state: GoalState, event: GoalEvent, action: Action, target: GoalState, guard: Guard = Guard.ALWAYS) -> Row:
    return state_table.Row(state, event, guard, action, target)


#: Of the rows for one state and event the first whose guard is true counts. What is not in the table changes nothing in that state.
#: A goal that waits is taken as soon as FREE is entered.
TABLE: tuple[Row, ...] = (
    _row(_S.FREE, _E.GOAL, _A.TURN_AWAY_BUSY, _S.FREE, _G.BUSY),
    _row(_S.FREE, _E.GOAL, _A.ASK, _S.PLANNING),
    # the planner's answer; nothing of a goal moves before it
    _row(_S.PLANNING, _E.PLANNED, _A.ACCEPT, _S.REVIEW),
    _row(_S.PLANNING, _E.NOT_PLANNED, _A.REFUSE, _S.FREE),
    _row(_S.PLANNING, _E.CANCEL, _A.RECALL, _S.DISCARDING),
    _row(_S.PLANNING, _E.GOAL, _A.TURN_AWAY, _S.PLANNING, _G.STRANGER),
    _row(_S.PLANNING, _E.GOAL, _A.REPLACE, _S.DISCARDING),
    # a plan that nobody wants any more must not stay under review
    _row(_S.DISCARDING, _E.PLANNED, _A.WITHDRAW, _S.WITHDRAWING),
    _row(_S.DISCARDING, _E.NOT_PLANNED, _A.NOTHING, _S.STOPPED),
    _row(_S.DISCARDING, _E.GOAL, _A.TURN_AWAY, _S.DISCARDING, _G.STRANGER),
    _row(_S.DISCARDING, _E.GOAL, _A.LINE_UP, _S.DISCARDING),
    # a person decides
    _row(_S.REVIEW, _E.STARTED, _A.SAY_MOVING, _S.MOVING),
    _row(_S.REVIEW, _E.TURNED_DOWN, _A.ABORT_INVALID, _S.FREE),
    _row(_S.REVIEW, _E.FINISHED, _A.SAY_MOVING, _S.SETTLING),
    _row(_S.REVIEW, _E.ENDED, _A.ABORT_PATH, _S.FREE),
    _row(_S.REVIEW, _E.CANCEL, _A.WITHDRAW, _S.WITHDRAWING),
    _row(_S.REVIEW, _E.GOAL, _A.TURN_AWAY, _S.REVIEW, _G.STRANGER),
    _row(_S.REVIEW, _E.GOAL, _A.WITHDRAW_FOR_NEXT, _S.WITHDRAWING),
    # the withdrawal and an approval may cross
    _row(_S.WITHDRAWING, _E.TURNED_DOWN, _A.PREEMPT, _S.STOPPED),
    _row(_S.WITHDRAWING, _E.TOO_LATE, _A.PREEMPT, _S.STOPPED),
    _row(_S.WITHDRAWING, _E.STARTED, _A.BRAKE, _S.BRAKING),
    _row(_S.WITHDRAWING, _E.FINISHED, _A.NOTHING, _S.STOPPED),
    _row(_S.WITHDRAWING, _E.ENDED, _A.NOTHING, _S.STOPPED),
    _row(_S.WITHDRAWING, _E.GOAL, _A.TURN_AWAY, _S.WITHDRAWING, _G.STRANGER),
    _row(_S.WITHDRAWING, _E.GOAL, _A.LINE_UP, _S.WITHDRAWING),
    # on the path
    _row(_S.MOVING, _E.FINISHED, _A.NOTHING, _S.SETTLING),
    _row(_S.MOVING, _E.ENDED, _A.ABORT_PATH, _S.FREE),
    _row(_S.MOVING, _E.LOST, _A.ABORT_GOAL, _S.FREE),
    _row(_S.MOVING, _E.OFF_PATH, _A.BRAKE_OFF_PATH, _S.BRAKING),
    _row(_S.MOVING, _E.CANCEL, _A.BRAKE, _S.BRAKING),
    _row(_S.MOVING, _E.GOAL, _A.TURN_AWAY, _S.MOVING, _G.STRANGER),
    _row(_S.MOVING, _E.GOAL, _A.BRAKE_FOR_NEXT, _S.BRAKING),
    # the first cause is the cause
    _row(_S.BRAKING, _E.FINISHED, _A.NOTHING, _S.STOPPED),
    _row(_S.BRAKING, _E.ENDED, _A.NOTHING, _S.STOPPED),
    _row(_S.BRAKING, _E.LOST, _A.NOTHING, _S.STOPPED),
    _row(_S.BRAKING, _E.GOAL, _A.TURN_AWAY, _S.BRAKING, _G.STRANGER),
    _row(_S.BRAKING, _E.GOAL, _A.LINE_UP, _S.BRAKING),
    # the executor sends no more of the path; a next plan begins where the twin comes to rest
    _row(_S.STOPPED, _E.STILL, _A.END_STOPPED, _S.FREE),
    _row(_S.STOPPED, _E.TOO_LATE, _A.GIVE_UP, _S.FREE),
    _row(_S.STOPPED, _E.GOAL, _A.TURN_AWAY, _S.STOPPED, _G.STRANGER),
    _row(_S.STOPPED, _E.GOAL, _A.LINE_UP, _S.STOPPED),
    # the path was played to its end; the arm may still be on its way
    _row(_S.SETTLING, _E.AT_GOAL, _A.SUCCEED, _S.FREE),
    _row(_S.SETTLING, _E.TOO_LATE, _A.ABORT_GOAL, _S.FREE),
    _row(_S.SETTLING, _E.LOST, _A.ABORT_GOAL, _S.FREE),
    _row(_S.SETTLING, _E.CANCEL, _A.PREEMPT, _S.FREE),
    _row(_S.SETTLING, _E.GOAL, _A.TURN_AWAY, _S.SETTLING, _G.STRANGER),
    _row(_S.SETTLING, _E.GOAL, _A.REPLACE, _S.STOPPED),
)

ROWS = state_table.by_cause(TABLE)

"""The state machine of the action `follow_joint_trajectory`, as a table. Pure; events and actions are in `trajectory_goals`."""

from __future__ import annotations

from enum import Enum

from construction_twin.core import state_table


class GoalState(Enum):
    """State of a goal."""

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
    """Event of a goal."""

    GOAL = "goal"
    CANCEL = "cancel"
    PLANNED = "planned"
    NOT_PLANNED = "not_planned"
    TURNED_DOWN = "turned_down"
    STARTED = "started"
    FINISHED = "finished"
    ENDED = "ended"
    LOST = "lost"
    STILL = "still"
    AT_GOAL = "at_goal"
    TOO_LATE = "too_late"


class Guard(Enum):
    """Condition of a row, in words."""

    ALWAYS = ""
    BUSY = "the executor follows a plan that is of no goal of this action"


class Action(Enum):
    """What is done before the next state is entered, in words."""

    NOTHING = ""
    REQUEST_PLAN = "the planner is asked for a plan"
    TURN_AWAY = "the goal is rejected, naming the plan"
    WITHDRAW = "the plan is rejected in the client's name"
    ACCEPT = "the goal is active: its status says that it waits for approval"
    REFUSE = "the goal is rejected: INVALID_GOAL, with the planner's sentence"
    PREEMPT = "the goal ends: recalled or preempted"
    ABORT_INVALID = "the goal is aborted: INVALID_GOAL, with the reviewer's sentence"
    ABORT_PATH = "the goal is aborted: PATH_TOLERANCE_VIOLATED where the gate closed, else GOAL_TOLERANCE_VIOLATED"
    ABORT_GOAL = "the goal is aborted: GOAL_TOLERANCE_VIOLATED"
    END_STOPPED = "the goal ends: preempted, at rest on its path"
    GIVE_UP = "the same, and a goal that waits is recalled"
    BRAKE = "the executor's `stop_plan` is called"
    SEND_MOVING = "the status says that it moves"
    SUCCEED = "the goal succeeds"


Row = state_table.Row[GoalState, GoalEvent, Guard, Action]
_S, _E, _A, _G = GoalState, GoalEvent, Action, Guard
rows = state_table.Rows(GoalState, GoalEvent, Guard, Action)

#: Of the rows for one state and event the first whose guard is true counts. What is not in the table changes nothing in that state.
#: A goal that comes while another one has the arm: see `TrajectoryGoals.on_goal`.
TABLE: tuple[Row, ...] = (
    *rows(_S.FREE, _E.GOAL, _S.FREE, _A.TURN_AWAY, _G.BUSY),
    *rows(_S.FREE, _E.GOAL, _S.PLANNING, _A.REQUEST_PLAN),
    # the planner's answer; nothing of a goal moves before it
    *rows(_S.PLANNING, _E.PLANNED, _S.REVIEW, _A.ACCEPT),
    *rows(_S.PLANNING, _E.NOT_PLANNED, _S.FREE, _A.REFUSE),
    *rows(_S.PLANNING, _E.CANCEL, _S.DISCARDING, _A.PREEMPT),
    # an orphaned plan must not stay under review
    *rows(_S.DISCARDING, _E.PLANNED, _S.WITHDRAWING, _A.WITHDRAW),
    *rows(_S.DISCARDING, _E.NOT_PLANNED, _S.STOPPED),
    # a person decides
    *rows(_S.REVIEW, _E.STARTED, _S.MOVING, _A.SEND_MOVING),
    *rows(_S.REVIEW, _E.TURNED_DOWN, _S.FREE, _A.ABORT_INVALID),
    *rows(_S.REVIEW, _E.FINISHED, _S.SETTLING, _A.SEND_MOVING),
    *rows(_S.REVIEW, _E.ENDED, _S.FREE, _A.ABORT_PATH),
    *rows(_S.REVIEW, _E.CANCEL, _S.WITHDRAWING, _A.WITHDRAW),
    # the withdrawal and an approval may cross
    *rows(_S.WITHDRAWING, _E.TURNED_DOWN, _S.STOPPED, _A.PREEMPT),
    *rows(_S.WITHDRAWING, _E.TOO_LATE, _S.STOPPED, _A.PREEMPT),
    *rows(_S.WITHDRAWING, _E.STARTED, _S.BRAKING, _A.BRAKE),
    *rows(_S.WITHDRAWING, _E.FINISHED, _S.STOPPED),
    *rows(_S.WITHDRAWING, _E.ENDED, _S.STOPPED),
    # on the path
    *rows(_S.MOVING, _E.FINISHED, _S.SETTLING),
    *rows(_S.MOVING, _E.ENDED, _S.FREE, _A.ABORT_PATH),
    *rows(_S.MOVING, _E.LOST, _S.FREE, _A.ABORT_GOAL),
    *rows(_S.MOVING, _E.CANCEL, _S.BRAKING, _A.BRAKE),
    # the first cause is the cause
    *rows(_S.BRAKING, _E.FINISHED, _S.STOPPED),
    *rows(_S.BRAKING, _E.ENDED, _S.STOPPED),
    *rows(_S.BRAKING, _E.LOST, _S.STOPPED),
    # the executor sends no more of the path; a next plan begins where the twin comes to rest
    *rows(_S.STOPPED, _E.STILL, _S.FREE, _A.END_STOPPED),
    *rows(_S.STOPPED, _E.TOO_LATE, _S.FREE, _A.GIVE_UP),
    # the path was played to its end; the arm may still be on its way
    *rows(_S.SETTLING, _E.AT_GOAL, _S.FREE, _A.SUCCEED),
    *rows(_S.SETTLING, _E.TOO_LATE, _S.FREE, _A.ABORT_GOAL),
    *rows(_S.SETTLING, _E.LOST, _S.FREE, _A.ABORT_GOAL),
    *rows(_S.SETTLING, _E.CANCEL, _S.STOPPED, _A.PREEMPT),
)

ROWS = state_table.rows_by_event(TABLE)

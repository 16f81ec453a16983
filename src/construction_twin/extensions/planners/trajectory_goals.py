"""Goals of other planners: from a trajectory to a plan under review, an execution and a result. Pure.

One goal has the arm at a time. `TrajectoryGoals` turns events into effects, which the node carries out. Times are on the monotonic
clock [ns].
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum

from construction_twin.core.sentences import Sentence, join_sentences
from construction_twin.core.state_table import row_of
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.states import ACTIVE, ExecutorState
from construction_twin.extensions.planners.goal_states import ROWS, Action, GoalEvent, GoalState
from construction_twin.extensions.planners.joint_tolerances import Tolerances
from construction_twin.extensions.planners.tracking import Sample
from construction_twin.review.plan_under_review import EXECUTOR
from construction_twin.robot.description import RobotModel

#: A call that failed, of `stop_plan` or `review_plan`, is made again after this time [ns].
RETRY = NANOSECONDS // 5
#: A withdrawn plan counts as gone after this long without the executor's report [ns].
WITHDRAWAL = 5 * NANOSECONDS
#: A goal ends this long after the executor's stop when the twin is not seen at rest [ns].
STOPPED = 10 * NANOSECONDS
#: A plan that takes this much longer than asked is said to [s].
NOTABLE = 0.001
#: Plans that were turned down are known for as many more, should the planner's answer be slower than the verdict.
VERDICTS = 20
UNKNOWN_REST = Sentence("the twin is not known to be at rest")
REPLACED = Sentence("replaced by a newer goal")
#: States in which the executor plays the goal's plan, or has just played it to its end.
PLAYED = (GoalState.MOVING, GoalState.BRAKING, GoalState.SETTLING)
#: States in which a goal of the same motion keeps the plan, and its place in the review.
TAKEN_OVER = (GoalState.PLANNING, GoalState.REVIEW)


class ResultCode(IntEnum):
    """Error codes of control_msgs/FollowJointTrajectoryResult; a header's stamp is never too old, because it is not used."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class Ending(Enum):
    """How a goal ends, in the words of actionlib."""

    REJECTED = "rejected"
    CANCELED = "canceled"  # recalled before it was accepted, preempted after
    ABORTED = "aborted"
    SUCCEEDED = "succeeded"


@dataclass(frozen=True)
class TrajectoryGoal:
    """A goal with the robot's joints.

    Attributes:
        client: Name of the node that sent it: an address, not a proof.
        time_tolerance: How much later than planned the arm may be at the goal [s].
        motion: Whatever is equal for two goals of the same motion.
    """

    id: str
    client: str
    goal: Tolerances
    time_tolerance: float
    motion: object


@dataclass(frozen=True)
class RequestPlan:
    """Effect: request a plan from the planner."""

    goal: TrajectoryGoal


@dataclass(frozen=True)
class Withdraw:
    """Effect: reject a plan in its client's name."""

    plan_id: str
    plan_hash: str
    client: str
    reason: str


@dataclass(frozen=True)
class Brake:
    """Effect: brake the executor along the path."""

    plan_id: str


@dataclass(frozen=True)
class Accept:
    """Effect: make a goal active."""

    goal_id: str
    text: str


@dataclass(frozen=True)
class Status:
    """Effect: set the text of an active goal's status."""

    goal_id: str
    text: str


@dataclass(frozen=True)
class End:
    """Effect: send a goal's result."""

    goal_id: str
    ending: Ending
    code: ResultCode
    sentence: str


Effect = RequestPlan | Withdraw | Brake | Accept | Status | End


@dataclass(frozen=True)
class GoalPlan:
    """The plan of a goal; `asked`: the requested duration [s], 0 for none; `retimed`: why the times were replaced."""

    id: str
    hash: str
    duration: float
    asked: float = 0.0
    retimed: str = ""


@dataclass(frozen=True)
class _PlanReport:
    """The executor's last report."""

    plan_id: str = ""
    state: ExecutorState = ExecutorState.WAITING
    outcome: str = ""
    reason: str = ""
    start: int = 0


#: How a goal ends by an action whose event brings the sentence.
_FAILURES = {
    Action.REFUSE: (Ending.REJECTED, ResultCode.INVALID_GOAL),
    Action.ABORT_INVALID: (Ending.ABORTED, ResultCode.INVALID_GOAL),
    Action.ABORT_GOAL: (Ending.ABORTED, ResultCode.GOAL_TOLERANCE_VIOLATED),
}


class TrajectoryGoals:
    """The goals of all clients; `plan` is of the goal that has the arm. A method for each input, and for each action of `ROWS`."""

    def __init__(self, robot: RobotModel, reviewed_by: str):
        self._robot = robot
        self._reviewed_by = reviewed_by
        self._report = _PlanReport()
        self.state = GoalState.FREE
        self.goal: TrajectoryGoal | None = None
        self._client = ""
        self.plan: GoalPlan | None = None
        self._next: TrajectoryGoal | None = None
        self._arriving: TrajectoryGoal | None = None
        self._why = ""
        self._retry_at = self._since = 0
        self._turned_down: dict[str, str] = {}
        self._effects: list[Effect] = []

    @property
    def plan_start(self) -> int:
        """Stamp of the first setpoint of the goal's plan [ns]; 0: it has not begun, or the executor plays another one."""
        return self._report.start if self.plan is not None and self.plan.id == self._report.plan_id else 0

    def pop_effects(self) -> list[Effect]:
        """Return the effects since the last call in their order, and forget them."""
        effects, self._effects = self._effects, []
        return effects

    def describe(self) -> str:
        """Return the state as one sentence, for operators."""
        if self.state is GoalState.FREE:
            return Sentence("no goal")
        if self.plan is None:
            return Sentence("goal of {client} is {state}", client=self._client, state=self.state.value)
        values = {"client": self._client, "state": self.state.value, "plan": self.plan.id}
        return Sentence("goal of {client} is {state}, plan {plan}", **values)

    # -- what clients ask

    def on_goal(self, goal: TrajectoryGoal, now: int) -> None:
        """Begin a goal; while another one has the arm it is rejected, takes the plan over, or cancels that one and waits."""
        if self.state is GoalState.FREE:
            self._arriving = goal
            self._on(GoalEvent.GOAL, now)
        elif goal.client != self._client:
            values = {"client": self._client, "state": self.describe()}
            sentence = Sentence("{client} has the arm ({state}); cancel that goal, or wait for its end", **values)
            self._end(goal, Ending.REJECTED, ResultCode.INVALID_GOAL, sentence)
        elif self.state in TAKEN_OVER and self.goal is not None and goal.motion == self.goal.motion:
            self._finish(Ending.CANCELED, ResultCode.GOAL_TOLERANCE_VIOLATED, REPLACED)
            self.goal = goal
            if self.plan is not None:
                self._accept()
        else:
            if self._next is not None:
                self._end(self._next, Ending.CANCELED, ResultCode.GOAL_TOLERANCE_VIOLATED, REPLACED)
            self._next, self._why = goal, self._why or REPLACED
            self._on(GoalEvent.CANCEL, now)

    def on_stand_still(self, goal: TrajectoryGoal, now: int) -> None:
        """Cancel the goals of a client that sends one without points."""
        ours = [each for each in (self.goal, self._next) if each is not None and each.client == goal.client]
        if not ours:
            sentence = Sentence(
                "the trajectory has no points, and no goal of yours is to be stopped; give at least one"
            )
            self._effects.append(End(goal.id, Ending.REJECTED, ResultCode.INVALID_GOAL, sentence))
            return
        self._effects.append(Accept(goal.id, Sentence("no points: your other goal is cancelled")))
        for each in reversed(ours):
            self.on_cancel(each.id, now)
        sentence = Sentence("no points: your other goal is cancelled, and ends when the arm is at rest")
        self._effects.append(End(goal.id, Ending.SUCCEEDED, ResultCode.SUCCESSFUL, sentence))

    def on_cancel(self, goal_id: str, now: int) -> None:
        """Cancel a goal that has not ended."""
        if self._next is not None and self._next.id == goal_id:
            sentence = Sentence("cancelled before it was planned")
            self._end(self._next, Ending.CANCELED, ResultCode.GOAL_TOLERANCE_VIOLATED, sentence)
            self._next = None
        elif self.goal is not None and self.goal.id == goal_id:
            if not self._why:
                self._why = Sentence("cancelled by its client")
            self._on(GoalEvent.CANCEL, now)

    # -- what the planner answers

    def on_planned(self, plan: GoalPlan, now: int) -> None:
        """Store the plan of the goal, which is under review."""
        self.plan = plan
        self._on(GoalEvent.PLANNED, now)
        # verdict and execution travel on connections of their own and may have been faster
        if plan.id in self._turned_down:
            self._on(GoalEvent.TURNED_DOWN, now, self._turned_down[plan.id])
        if self._report.plan_id == plan.id:
            self._follow_execution(now)

    def on_not_planned(self, sentence: str, now: int) -> None:
        """End a goal that has no plan."""
        self._on(GoalEvent.NOT_PLANNED, now, sentence)

    # -- what the executor says

    def on_verdict(self, plan_id: str, approved: bool, reviewer: str, reason: str, now: int) -> None:
        """Handle a verdict; an approval counts when the executor begins."""
        if approved:
            if self.plan is not None and plan_id == self.plan.id and self.state is GoalState.REVIEW:
                self._send_status(Sentence("plan {plan} was approved by {reviewer}", plan=plan_id, reviewer=reviewer))
            return
        sentence = Sentence("plan {plan} was rejected by {reviewer}", plan=plan_id, reviewer=reviewer)
        if reviewer == EXECUTOR:
            sentence = Sentence("plan {plan} was withdrawn by the executor", plan=plan_id)
        if reason:
            sentence = Sentence("{what}: {reason}", what=sentence, reason=reason)
        self._turned_down[plan_id] = sentence
        if len(self._turned_down) > VERDICTS:
            del self._turned_down[next(iter(self._turned_down))]
        if self.plan is not None and plan_id == self.plan.id:
            self._on(GoalEvent.TURNED_DOWN, now, sentence)

    def on_execution(self, plan_id: str, state: ExecutorState, outcome: str, reason: str, start: int, now: int) -> None:
        """Handle the executor's report of the newest plan, which began at a stamp [ns]."""
        before, self._report = self._report, _PlanReport(plan_id, state, outcome, reason, start)
        if self.plan is None:
            return
        if plan_id == self.plan.id:
            moving = self.state is GoalState.MOVING
            self._follow_execution(now)
            if moving and self.state is GoalState.MOVING and before.state is not state:
                self._send_status(f"{state.name}: {reason}")
        elif self.state in PLAYED:
            lost = Sentence("the executor no longer plays plan {plan}: {reason}", plan=self.plan.id, reason=reason)
            self._on(GoalEvent.LOST, now, lost)

    def on_call_failed(self, now: int) -> None:
        """Schedule a failed call of `stop_plan` or `review_plan` again."""
        self._retry_at = now + RETRY

    # -- what time and poses bring

    def tick(self, now: int, sample: Sample | None, at_rest: bool, settled: bool) -> None:
        """Handle the time and the newest sample; `at_rest`: the twin, `settled`: then the arm."""
        if self._retry_at and now >= self._retry_at:
            self._retry_at = 0
            self._repeat()
        if self.state is GoalState.WITHDRAWING and now - self._since > WITHDRAWAL:
            values = {"why": self._why, "plan": self._planned.id}
            self._why = Sentence("{why}; the executor does not say that plan {plan} is withdrawn: reject it", **values)
            self._on(GoalEvent.TOO_LATE, now)
        if at_rest:
            self._on(GoalEvent.STILL, now)
        elif self.state is GoalState.STOPPED and now - self._since > STOPPED:
            self._on(GoalEvent.TOO_LATE, now)
        if self.state is GoalState.SETTLING:
            self._check_goal(sample if settled else None, now)
        if self.state is GoalState.FREE and self._next is not None and at_rest:
            self._arriving, self._next = self._next, None
            self._on(GoalEvent.GOAL, now)

    def _check_goal(self, sample: Sample | None, now: int) -> None:
        assert self.goal is not None  # it settles
        violation: str = Sentence("twin and arm are not known to be at rest")
        if sample is not None:
            # the twin rests at the path's end, and the arm answers to that: what they show is the goal, and how far off it is
            violation = self.goal.goal.violation(self._robot, sample.error.position)
        if not violation:
            self._on(GoalEvent.AT_GOAL, now)
        elif now - self._since > self.goal.time_tolerance * NANOSECONDS:
            seconds = self.goal.time_tolerance
            late = Sentence("{seconds:g} s after the plan's end {problem}", seconds=seconds, problem=violation)
            self._on(GoalEvent.TOO_LATE, now, late)

    # -- the table

    @property
    def _planned(self) -> GoalPlan:
        assert self.plan is not None  # the planner has answered in every state in which this is asked for
        return self.plan

    def _follow_execution(self, now: int) -> None:
        report = self._report
        if report.state in ACTIVE:
            self._on(GoalEvent.STARTED, now)
        elif report.outcome == "finished":
            self._on(GoalEvent.FINISHED, now)
        elif report.outcome:
            self._on(GoalEvent.ENDED, now, report.reason)

    def _on(self, event: GoalEvent, now: int, reason: str = "") -> None:
        """Apply the first row of the table whose guard is true, if any."""
        row = row_of(ROWS, self.state, event, lambda _busy: self._report.state in ACTIVE)
        if row is None:
            return
        if row.action in _FAILURES:
            self._finish(*_FAILURES[row.action], reason)
        elif row.action is not Action.NOTHING:
            getattr(self, f"_{row.action.name.lower()}")()
        if row.target is not None and row.target is not self.state:
            self.state = row.target
            self._since, self._retry_at = now, 0
        if self.state is GoalState.FREE:
            self.goal = self.plan = None
            self._why = ""

    # -- actions: one method for each of the table that is none of `_FAILURES`

    def _request_plan(self) -> None:
        self.goal, self._arriving = self._arriving, None
        assert self.goal is not None  # the event brings it
        self._client = self.goal.client
        self._effects.append(RequestPlan(self.goal))

    def _turn_away(self) -> None:
        assert self._arriving is not None  # the event brings it
        values = {"plan": self._report.plan_id}
        sentence = Sentence("the arm follows plan {plan}, of no goal of this action; wait for its end", **values)
        self._end(self._arriving, Ending.REJECTED, ResultCode.INVALID_GOAL, sentence)
        self._arriving = None

    def _withdraw(self) -> None:
        plan, why = self._planned, self._why or Sentence("no longer wanted by its client")
        self._effects.append(Withdraw(plan.id, plan.hash, self._client, why))
        self._send_status(Sentence("{why}; plan {plan} is being withdrawn", why=self._why, plan=plan.id))

    def _accept(self) -> None:
        assert self.goal is not None  # it was planned
        plan = self._planned
        of: str = Sentence("plan {plan} of {seconds:.3f} s", plan=plan.id, seconds=plan.duration)
        if plan.asked and plan.duration > plan.asked + NOTABLE:
            of = Sentence("{plan} instead of {asked:.3f} s", plan=of, asked=plan.asked)
        waits = Sentence(
            "{plan} waits for approval; a person gives or refuses it by {service}", plan=of, service=self._reviewed_by
        )
        if plan.retimed:
            waits = Sentence("{waits}; timed anew, because {why}", waits=waits, why=plan.retimed)
        self._effects.append(Accept(self.goal.id, waits))

    def _preempt(self, where: str = "") -> None:
        self._finish(Ending.CANCELED, ResultCode.GOAL_TOLERANCE_VIOLATED, join_sentences(self._why, where))

    def _abort_path(self) -> None:
        report = self._report
        code = ResultCode.PATH_TOLERANCE_VIOLATED if report.outcome == "held" else ResultCode.GOAL_TOLERANCE_VIOLATED
        values = {"plan": self._planned.id, "outcome": report.outcome, "reason": report.reason}
        self._finish(Ending.ABORTED, code, Sentence("plan {plan} ended as {outcome}: {reason}", **values))

    def _end_stopped(self) -> None:
        where = Sentence("the arm is at rest on its path") if self._report.reason else Sentence("the arm is at rest")
        self._preempt(join_sentences(where, self._report.reason))

    def _give_up(self) -> None:
        self._preempt(join_sentences(UNKNOWN_REST, self._report.reason))
        if self._next is not None:
            sentence = Sentence("not planned: {unknown}; see whether it runs, and send it again", unknown=UNKNOWN_REST)
            self._end(self._next, Ending.CANCELED, ResultCode.GOAL_TOLERANCE_VIOLATED, sentence)
            self._next = None

    def _brake(self) -> None:
        self._effects.append(Brake(self._planned.id))
        self._send_status(Sentence("{why}; brakes on the path", why=self._why))

    def _send_moving(self) -> None:
        self._send_status(f"{self._report.state.name}: {self._report.reason}")

    def _succeed(self) -> None:
        reached = Sentence("plan {plan} was executed; the arm is at the goal", plan=self._planned.id)
        self._finish(Ending.SUCCEEDED, ResultCode.SUCCESSFUL, reached)

    def _repeat(self) -> None:
        """Make a call again that failed and is still needed."""
        if self.state is GoalState.WITHDRAWING:
            self._withdraw()
        elif self.state is GoalState.BRAKING:
            self._effects.append(Brake(self._planned.id))

    # -- results and status

    def _finish(self, ending: Ending, code: ResultCode, sentence: str) -> None:
        """End the active goal, if there is one."""
        if self.goal is not None:
            self._end(self.goal, ending, code, sentence)
        self.goal = None

    def _end(self, goal: TrajectoryGoal, ending: Ending, code: ResultCode, sentence: str) -> None:
        self._effects.append(End(goal.id, ending, code, sentence))

    def _send_status(self, text: str) -> None:
        if self.goal is not None:
            self._effects.append(Status(self.goal.id, text))

"""The executor's state machine: the rows of `states.TABLE`, applied to the plan that is played.

Pure. Stamps and `now` in ns, angles in rad.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from construction_twin.core.errors import ExecutionError
from construction_twin.core.reports import ToolReport
from construction_twin.core.sentences import Sentence, join_sentences
from construction_twin.core.side_effects import SideEffects
from construction_twin.core.state_table import row_of
from construction_twin.execution.engagement import REMEDY, Engagement, EngagementStore
from construction_twin.execution.playback import Playback, distance_along
from construction_twin.execution.segment_run import SegmentRun, ToolOrder
from construction_twin.execution.states import ACTIVE, OUTCOMES, ROWS, Action, ExecutorEvent, ExecutorState, Guard, Row
from construction_twin.review.plan_under_review import EXECUTOR, WITHDRAWN, ExecutionEnd, PlanUnderReview, Verdict
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan

_BY_GATE = (ExecutorEvent.GATE_HOLDS, ExecutorEvent.GATE_ENDS)
#: An arm that trails by so much is waited for, and is no longer when it trails by less than `KEEPS_UP` [s]. The gateway ends a
#: motion of which it had to put off 2 s.
TRAILS, KEEPS_UP = 1.0, 0.5


@dataclass(frozen=True, slots=True)
class TwinPose:
    """The twin's pose `q` [rad], the stamp of the command that it executes, and when it was received [ns]."""

    stamp: int
    q: tuple[float, ...]
    received: int


class PlayRate:
    """The newest limit on a plan's speed, 0 to 1, and whether the plan waits for a trailing arm.

    `standing`: the plan has come to rest because of either.
    """

    def __init__(self):
        self.fraction, self.reason = 1.0, ""
        self.standing = self.waits = False

    @property
    def rate(self) -> float:
        """The rate of play, a fraction of the planned speed."""
        return 0.0 if self.waits else self.fraction

    def on_lag(self, round_trip: float, servo_lag: float = 0.0) -> None:
        """Store how long the arm trails the setpoints: the round trip, and its servos' lag beyond that [s]; nan: unknown."""
        lag = round_trip + (servo_lag if 0.0 <= servo_lag < math.inf else 0.0)
        if round_trip >= 0.0 and lag < math.inf:
            self.waits = lag >= (KEEPS_UP if self.waits else TRAILS)

    def set_fraction(self, fraction: float, reason: str = "") -> None:
        """Store a limit and its reason; the path stays. ExecutionError keeps the old one: not a fraction."""
        # written so that a nan does not pass
        if not 0.0 <= fraction <= 1.0:
            raise ExecutionError(
                f"a rate of {fraction} was asked for; expected a fraction of the planned speed, 0 to 1"
            )
        self.fraction, self.reason = fraction, reason

    def sentence(self, cause: str) -> str:
        """Return the state of a playing plan under the present limit; `cause`: why it plays."""
        if self.standing and self.fraction == 0.0:
            return Sentence("stands still on the path, goes on by itself: {reason}", reason=self.reason)
        if self.waits:
            return Sentence(
                "waits on the path until the arm has caught up, goes on by itself: the arm trails by more than {trails:g} s, "
                "because replies to it are lost or it is slowed down",
                trails=TRAILS,
            )
        if self.fraction < 1.0:
            return Sentence(
                "{cause}; at {percent:.0f}% of the planned speed: {reason}",
                cause=cause,
                percent=100.0 * self.fraction,
                reason=self.reason,
            )
        return cause


class ExecutorMachine:
    """The executor's state, and how it changes: by the rows of the table, and in no other way.

    Args:
        saved: The engagement in which the executor before this one left the arm, if any.

    Attributes:
        cause: Why the state was entered; `reason` is the same with what the speed limit makes of it now.
        playback, segment_run: The present or last execution, and that of a work plan.
        setpoint: Sent last; None: none is known.
        events, orders: To be published: plans withdrawn or rejected, executions ended; to be asked of the tool: of ended plans.
        side_effects: Runs what tells of a stop, a pause or a rejection: it can fail none of them.
    """

    def __init__(self, robot: RobotModel, saved: Engagement | None):
        self.robot = robot
        self.state = ExecutorState.WAITING
        self.cause: str = Sentence("started; waits for twin and physical arm to agree")
        self.outcome = ""
        self.limit = PlayRate()
        self.playback: Playback | None = None
        self.segment_run: SegmentRun | None = None
        self.engagement = EngagementStore(saved)
        self.under_review = PlanUnderReview()
        self.side_effects = SideEffects()
        self.events: list[Verdict | ExecutionEnd] = []
        self.orders: list[ToolOrder] = []
        self.tool = ToolReport()
        self.now = 0
        self.setpoint: tuple[float, ...] | None = None
        self._setpoint_stamp = 0
        self._twin: TwinPose | None = None
        self._agreed = False
        # of the last setpoint that passed the gate
        self._passed = 0
        # the part of the reason for IDLE that says that the gate holds: when it opens, that is over
        self._closed = ""
        self._approved: Plan | None = None
        self._paused = False
        self._stopping: list[tuple[float, ...]] = []

    @property
    def reason(self) -> str:
        """Why the state was entered, with the present speed limit."""
        return self.limit.sentence(self.cause) if self.state is ExecutorState.PLAYING else self.cause

    @property
    def plan(self) -> Plan | None:
        """The plan that is played, or the last one that was."""
        return self.playback.plan if self.playback else None

    @property
    def plan_start(self) -> int:
        """Nominal stamp of that plan's first setpoint [ns]; 0 when none was sent."""
        return self.playback.start if self.playback else 0

    @property
    def rate(self) -> float:
        """Present fraction of the planned speed, 0 to 1; 0 when nothing is played."""
        return self._played.rate if self.state in ACTIVE else 0.0

    @property
    def _played(self) -> Playback:
        assert self.playback is not None  # a first plan was played
        return self.playback

    @property
    def _work(self) -> SegmentRun:
        assert self.segment_run is not None  # only a work plan has boundaries
        return self.segment_run

    def record_withdrawal(self, plan: Plan | None, reason: str) -> None:
        """Queue the verdict that a plan is not, or no longer, under review."""
        if plan is not None:
            self.events.append(Verdict(WITHDRAWN, plan.id, plan.hash, EXECUTOR, reason, plan))

    def _on(self, event: ExecutorEvent, reason: str = "") -> None:
        """Apply the first row of the table whose guard holds, if any."""
        row = row_of(ROWS, self.state, event, self._holds)
        if row is None:
            return
        self._act(row)
        # what a state is entered for is said of a change that takes place: the arm brakes without the sentence, too
        sentence = self.side_effects.run("the executor's sentence", self._sentence, row, reason) or reason
        if row.action in OUTCOMES:
            sentence = self._end(row.action, sentence)
        # a restart is reported although the state stays
        if row.target is not row.state or row.action is Action.FORGET_TWIN:
            self.cause, self._closed, self.limit.standing = sentence, "", False
        self.state = row.target or row.state
        if event in _BY_GATE and self.state is ExecutorState.IDLE:
            self._closed = reason

    def _holds(self, guard: Guard) -> bool:
        if guard is Guard.BEGUN:
            return self.plan_start != 0
        if guard is Guard.KNOWN:
            return self._played.has_stamp(self._passed)
        if guard is Guard.PAUSED:
            return self._paused
        if guard is Guard.BOUNDARY:
            return self.segment_run is not None and self.segment_run.at_boundary
        # a work plan; `begin` has set what was approved before the event
        plan = self._approved if self.state is ExecutorState.IDLE else self._played.plan
        return plan is not None and bool(plan.segments)

    def _act(self, row: Row) -> None:
        match row.action:
            case Action.START_FROM_TWIN:
                assert self._twin is not None  # the event says that its pose is known
                self.setpoint, self._setpoint_stamp = self._twin.q, 0
                self.engagement.on_pose(self._twin.q)
            case Action.FORGET_TWIN:
                self._twin, self._agreed, self.setpoint = None, False, None
            case Action.PLAY:
                assert self._approved is not None  # `begin` has set it
                plan, self.outcome = self._approved, ""
                self.playback = Playback(plan, self.robot)
                self.orders += [] if self.segment_run is None else self.segment_run.pop_orders()
                back = self.engagement.is_way_back(plan)
                self.segment_run = SegmentRun(plan, self.engagement, back) if plan.segments else None
            case Action.BRAKE:
                assert self.setpoint is not None  # the row's guard: one was sent
                self._stopping = [self.setpoint]
            case Action.STAND:
                self._played.rest_at_stamp(self._passed)
                self._paused = row.state in (ExecutorState.PAUSING, ExecutorState.PAUSED)
            case Action.PAUSE_AFTER_HOLD:
                self._paused = True
            case Action.ARRIVE:
                self._played.rest()
                self._work.arrive()
            case Action.ENTER:
                self._played.enter(self._work.enter())
            case Action.VOID:
                self._work.pause()
            case Action.REARM:
                self._work.resume(self.now)

    def _end(self, action: Action, sentence: str) -> str:
        """End the execution and its work plan; return the sentence for its end."""
        self.outcome, work, finished = OUTCOMES[action], self.segment_run, action is Action.FINISH
        if work is not None:
            if not finished:
                where = self.side_effects.run("where a work plan ends", lambda: work.where)
                where = where or Sentence("where it stands")
                sentence = Sentence("{reason}; {where} the rest is dropped", reason=sentence, where=where)
            was_engaged = self.engagement.engaged
            self.orders += work.end(finished, self._played.elapsed, sentence)
            if self.engagement.engaged and not was_engaged:
                waiting = self.under_review.clear()
                self.side_effects.run("the verdict on a waiting plan", self._withdraw_for_way_back, waiting)
            if not finished and self.engagement.engaged:
                sentence = Sentence("{end}; the arm is engaged: {remedy}", end=sentence, remedy=REMEDY)
            elif not finished:
                sentence = Sentence(
                    "{end}: look at arm and tool, then plan the task again from where things are", end=sentence
                )
        self.events.append(ExecutionEnd(self._played.plan, self.outcome, sentence))
        return sentence

    def _withdraw_for_way_back(self, plan: Plan | None) -> None:
        self.record_withdrawal(plan, Sentence("not the way back: {engaged}", engaged=self.engagement.sentence))

    def _sentence(self, row: Row, reason: str) -> str:
        """Return why the next state is entered, in words for the operator."""
        if row.event is ExecutorEvent.GATE_HOLDS:
            if row.state is ExecutorState.STOPPING:
                return join_sentences(self.cause, reason)
            if row.action is Action.LOSE:
                plan = self._played.plan.id
                return Sentence("{hold} at a setpoint that is none of plan {plan}", plan=plan, hold=reason)
            elapsed = self._played.elapsed
            return Sentence("{hold} {elapsed:.3f} s into the plan; goes on by itself", hold=reason, elapsed=elapsed)
        if row.target is ExecutorState.AT_BOUNDARY:
            where = self._work.where
            if row.event is ExecutorEvent.APPROVED:
                return Sentence("{reason}; stands {where}", reason=reason, where=where)
            return Sentence("stands {where}", where=where)
        if row.target is ExecutorState.PAUSED:
            return Sentence("at rest {elapsed:.3f} s into the plan; resume goes on", elapsed=self._played.elapsed)
        if row.event is ExecutorEvent.GATE_OPENS:
            return Sentence("twin and arm agree again; the same approval covers the rest")
        if row.event is ExecutorEvent.NEXT_SEGMENT:
            segment = self._work.segment
            assert segment is not None  # it was entered
            return Sentence("segment {number} ({name})", number=self._work.number + 1, name=repr(segment.name))
        if row.event in (ExecutorEvent.AT_REST, ExecutorEvent.SEGMENT_END) and row.state is ExecutorState.STOPPING:
            path = distance_along(self._stopping).text(self.robot)
            return Sentence("{reason}; at rest after {path}", reason=self.cause, path=path)
        return reason

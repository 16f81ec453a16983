"""The executor: one setpoint per cycle, from an approved plan or, idle, the twin's pose.

Pure: `step` is called once per 4 ms with the cycle's nominal stamp [ns]. Angles in rad. `now` is on the monotonic clock, but
for `stop`, `pause` and `restart`: these are compared with when a plan was asked for, on the robot's clock (`core.freshness`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from construction_twin.core.errors import ExecutionError, ReviewError
from construction_twin.core.freshness import LIFETIME
from construction_twin.core.limits import outside_tolerance
from construction_twin.core.reports import ExecutionReport, ToolReport
from construction_twin.core.sentences import Quantity, Sentence, both, replaced
from construction_twin.core.side_effects import SideEffects
from construction_twin.core.state_table import Machine, Occasion, conditions
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.boundary import ToolOrder
from construction_twin.execution.conflict_verdicts import ConflictVerdicts
from construction_twin.execution.engagement import REMEDY, Engagement, EngagementKeeper
from construction_twin.execution.playback import START_TOLERANCE, Playback, PlayRate, StopForecaster, distance_along
from construction_twin.execution.rehearsal_check import RehearsalCheck
from construction_twin.execution.segment_run import SegmentRun, awaited, lacks
from construction_twin.execution.states import (
    ACTIVE,
    OUTCOMES,
    ROWS,
    SURVIVED,
    Action,
    ExecutorEvent,
    ExecutorState,
    Guard,
    Row,
)
from construction_twin.monitor.gate import REPLAN, RESUME, SyncState
from construction_twin.review.plan_under_review import EXECUTOR, WITHDRAWN, Ending, PlanUnderReview, Verdict
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan

_BY_GATE = (ExecutorEvent.GATE_HOLDS, ExecutorEvent.GATE_ENDS)
#: States in which a plan begins, or goes on, without another word of a person.
_MAY_BEGIN = (ExecutorState.PLAYING, ExecutorState.HELD, ExecutorState.AT_BOUNDARY)
#: States in which a person's act is under way.
_BRAKING = (ExecutorState.STOPPING, ExecutorState.PAUSING)
#: The twin's pose counts as known this long after its last message [ns].
TWIN_TIMEOUT = NANOSECONDS // 2


@dataclass(frozen=True, slots=True)
class TwinPose:
    """The twin's pose `q` [rad], the stamp of the command that it executes, and when it was received [ns]."""

    stamp: int
    q: tuple[float, ...]
    received: int


def check_start_pose(plan: Plan, pose: tuple[float, ...], robot: RobotModel) -> None:
    """Check that a plan starts at a pose, shape (n,) [rad]."""
    start = tuple(plan.trajectory.positions[0])
    off = outside_tolerance(start, pose, START_TOLERANCE)
    if off is not None:
        raise ReviewError(
            Sentence(
                "plan {plan} starts {distance} from the present pose at {joint}; plan again",
                plan=plan.id,
                distance=Quantity(start[off] - pose[off], "m" if robot.linear[off] else "rad"),
                joint=robot.joint_names[off],
            )
        )


class Executor:
    """Plays approved plans as theta_next.

    Args:
        left: Where the executor before this one has left the arm engaged, if it has.

    Attributes:
        lag: How long the arm trails the setpoints, as far as is known [s]; set by `trail`.
        neighbour: Says whether another arm blocks the path of a plan; by default there is none.
        rehearsal: Says whether a plan has passed its rehearsal; by default none is required.
        rested: Moment of the newest stop or pause [ns of the robot's clock]; -1: none.
        limit: How fast plans are played; set by `limit_rate`.
        segment_run: The present or last execution of a work plan; None when the plan played last is none.
        reason: Why the state was entered, and what the speed limit makes of it now.
        side_effects: Runs what tells of a stop, a pause or a rejection: it can fail none of them.
    """

    def __init__(self, robot: RobotModel, left: Engagement | None = None):
        self._robot = robot
        self.side_effects = SideEffects()
        self.lag = 0.0
        self.neighbour = ConflictVerdicts()
        self.rehearsal = RehearsalCheck()
        self.under_review = PlanUnderReview()
        self._machine = Machine(
            ROWS,
            ExecutorState.WAITING,
            Sentence("started; waits for twin and physical arm to agree"),
            conditions(self._guards()),
            {action: self._with_sentence(act) for action, act in self._actions().items()},
            after=self._after,
        )
        self.reason = self.cause
        self.outcome = ""
        self._playback: Playback | None = None
        self._approved: Plan | None = None
        #: Until then the approval, or a resume, of a plan counts that has not begun to move [ns].
        self._begin_by = 0
        self._paused = False
        self._acted, self.rested = False, -1
        self._session = ""
        self.limit = PlayRate()
        self.engagement = EngagementKeeper(left)
        self.tool = ToolReport()
        self.segment_run: SegmentRun | None = None
        self._orders: list[ToolOrder] = []
        self._way_back: tuple[str, Engagement] | None = None
        self._now = 0
        self._stopping: list[tuple[float, ...]] = []
        self._events: list[Verdict | Ending] = []
        self.approval_obstacle, self.overridable = "", False
        self._sync = SyncState.WAITING
        # the part of the reason for IDLE that says that the gate holds: when it opens, that is over
        self._closed = ""
        self._agreed = False
        self._policy, self._passed = "", 0
        self._unarmed = ""
        self._twin: TwinPose | None = None
        self._setpoint: tuple[float, ...] | None = None
        self._setpoint_stamp = 0

    @property
    def state(self) -> ExecutorState:
        """What it does."""
        return self._machine.state

    @property
    def cause(self) -> str:
        """Why the state was entered; `reason` is the same with what the speed limit makes of it now."""
        return self._machine.reason

    @property
    def plan(self) -> Plan | None:
        """The plan that is played, or the last one that was."""
        return self._playback.plan if self._playback else None

    @property
    def plan_start(self) -> int:
        """Nominal stamp of that plan's first setpoint [ns]; 0 when none was sent."""
        return self._playback.start if self._playback else 0

    @property
    def _played(self) -> Playback:
        """The present or last execution. Call it only after a first plan was played."""
        assert self._playback is not None
        return self._playback

    @property
    def rate(self) -> float:
        """Present fraction of the planned speed, 0 to 1; 0 when nothing is played."""
        return self._played.rate if self.state in ACTIVE else 0.0

    @property
    def steady(self) -> bool:
        """True when the rate does not change at the moment."""
        return self.state not in ACTIVE or self._played.steady

    # -- inputs

    def on_twin(self, stamp: int, q: tuple[float, ...], now: int) -> None:
        """Take the twin's pose [rad], the stamp of the command it executes, and the time of reception [ns]."""
        self._twin = TwinPose(stamp, q, now)

    def on_sync(self, state: SyncState, agreed: bool, policy: str = REPLAN, held_stamp: int = 0) -> None:
        """Take the monitor's state; on anything but IN_SYNC the plan is held, or its rest is dropped.

        Args:
            policy: What happens after a violation; only ``resume`` keeps the plan.
            held_stamp: Nominal stamp of the last setpoint that passed the gate [ns]: there the plan waits, and goes on by itself.
        """
        self._sync, self._agreed, self._policy, self._passed = state, agreed, policy, held_stamp
        if self._closed and state is SyncState.IN_SYNC:
            self._machine.reason = replaced(self.cause, self._closed, Sentence("the gate held, and is open again"))
            self._begin_saying()
        if self.state not in ACTIVE:
            return
        if state is SyncState.IN_SYNC:
            self._on(ExecutorEvent.GATE_OPENS)
        else:
            ends = policy != RESUME or state not in SURVIVED
            reason = Sentence("the gate holds ({state})", state=state.name)
            self._on(ExecutorEvent.GATE_ENDS if ends else ExecutorEvent.GATE_HOLDS, reason)

    def on_link(self, armed: bool, reason: str, session: str = "", now: int = 0) -> None:
        """Store the link's state; not armed: drop the plan. A new command session ends what is executed, as `restart`."""
        if session and session != self._session:
            if self._session:
                self.restart(Sentence("new command session"), now)
            self._session = session
        self._unarmed = "" if armed else reason
        if not armed:
            self._on(ExecutorEvent.DISARMED, Sentence("the arm is no longer armed: {reason}", reason=reason))

    def on_scene(self, scene: str) -> None:
        """Take the present scene's hash: what was planned for another one is withdrawn, stopped or ended."""
        scenes = {"before": self.under_review.scene[:12] or "none", "after": scene[:12]}
        withdrawn = self.under_review.on_scene(scene)
        self.tell_withdrawn(withdrawn, Sentence("the scene changed from {before} to {after}; plan again", **scenes))
        if self.state not in ACTIVE:
            return
        reason = Sentence("the scene changed from {before} to {after}", **scenes)
        if self.segment_run is not None:
            if not self.segment_run.expects(scene):
                where = self.segment_run.where
                reason = Sentence("{change}, which was not planned {where}", change=reason, where=where)
                self._on(ExecutorEvent.LOST, reason)
        elif scene != self._played.plan.scene:
            self._on(ExecutorEvent.STOP, reason)

    def on_conflict(self, plan_id: str, problem: str, now: int) -> None:
        """Take a verdict of the watch over the other arm; what is against the plan that is played stops it."""
        self.neighbour.on_verdict(plan_id, problem, now)
        if problem and self.state in ACTIVE and self._played.plan.id == plan_id:
            self._on(ExecutorEvent.STOP, problem)

    def on_tool(self, report: ToolReport, now: int) -> None:
        """Take what is known of the tool, and the time of reception [ns]; a work plan that needs something else is stopped."""
        self.tool = report
        if self.segment_run is not None and self.state in ACTIVE:
            if problem := self.segment_run.problem(report, now):
                self._on(ExecutorEvent.LOST, problem)

    def take_orders(self) -> list[ToolOrder]:
        """Return what is to be asked of the tool since the last call, in this order."""
        orders, self._orders = self._orders, []
        return orders if self.segment_run is None else orders + self.segment_run.take_orders()

    def limit_rate(self, factor: float, reason: str = "") -> None:
        """Play at most at this fraction of the planned speed from now on; 0 stands still until it is raised. The path stays."""
        if self.limit.take(factor, reason):
            self._say()

    def trail(self, round_trip: float, servo_lag: float = 0.0) -> None:
        """Take how long the arm trails the setpoints [s]; one that trails by much is waited for on the path.

        Args:
            round_trip: From a setpoint to the arm's answer; nan, or no such time: not known; an arm that was waited for still is.
            servo_lag: What the arm trails by beyond that; nan, or no such time: not known, which counts as 0.
        """
        known = 0.0 <= round_trip < math.inf
        lag = round_trip + (servo_lag if 0.0 <= servo_lag < math.inf else 0.0) if known else math.nan
        self.lag = lag if 0.0 <= lag < math.inf else 0.0
        if self.limit.trail(lag):
            self._say()

    def restart(self, reason: str, now: int) -> None:
        """Drop everything, plans asked for until `now` [ns] too, and wait for twin and arm to agree again."""
        # of a new session's arm nothing is known yet
        self.limit.waits = False
        self.tell_withdrawn(self.under_review.void(now), reason)
        while self.state is not ExecutorState.WAITING:
            self._on(ExecutorEvent.NEW_SESSION, reason)
        self._on(ExecutorEvent.NEW_SESSION, reason)

    def stall(self, reason: str) -> None:
        """Drop a moving plan because setpoints could not be produced in time; the arm is left to the gateway's braking."""
        if not self.limit.standing:
            self._on(ExecutorEvent.STALLED, reason)

    # -- review, and the start of a plan

    def offer(self, plan: Plan, way_back: Engagement | None = None) -> None:
        """Put a plan under review in place of the one before, or raise ReviewError.

        `way_back`: the engagement that `check_way_back` has found this plan to be the way back out of.
        """
        left = self.engagement.left
        if left is not None and left is not way_back:
            raise ReviewError(Sentence("plan {plan} cannot be reviewed: {reason}", plan=plan.id, reason=self.engaged()))
        self.tell_withdrawn(self.under_review.offer(plan), Sentence("replaced by plan {plan}", plan=plan.id))
        self._way_back = None if way_back is None else (plan.id, way_back)

    def engaged(self) -> str:
        """Return where the arm was left and what to do, as a sentence; "" where it is not engaged."""
        left = self.engagement.left
        if left is None:
            return ""
        values = {"segment": repr(left.segment), "plan": left.plan_id, "reason": left.reason, "remedy": REMEDY}
        return Sentence("the arm was left in engaged segment {segment} of plan {plan} ({reason}); {remedy}", **values)

    def _is_way_back(self, plan: Plan) -> bool:
        return self.engagement.engaged and self._way_back == (plan.id, self.engagement.present)

    def check_release(self) -> Engagement:
        """Return the engagement that could be ended now, by a person who has freed the arm."""
        left = self.engagement.left
        if left is None:
            raise ExecutionError(Sentence("the arm is not engaged; there is nothing to release"))
        if self.state in ACTIVE:
            values = {"plan": self._played.plan.id, "state": self.state.name}
            raise ExecutionError(Sentence("plan {plan} is {state}; release the arm when it is at rest", **values))
        return left

    def rehearsal_problem(self, plan: Plan) -> str:
        """Return why its rehearsal is against approving a plan; empty: it is not. The way back of an engaged arm needs none."""
        return "" if self._is_way_back(plan) else self.rehearsal.problem(plan)

    def check_start(self, plan: Plan, override: bool = False) -> None:
        """Raise ReviewError where the plan under review may not start now, naming what is against it."""
        if self.state is not ExecutorState.IDLE:
            values = {"state": self.state.name, "reason": self.reason}
            raise ReviewError(Sentence("the executor is {state} ({reason}); approve when it is idle", **values))
        if self._sync is not SyncState.IN_SYNC:
            raise ReviewError(
                Sentence(
                    "twin and physical arm are not in sync ({state}); approve when they are", state=self._sync.name
                )
            )
        if self._unarmed:
            raise ReviewError(Sentence("the arm is not armed ({reason}); approve when it is", reason=self._unarmed))
        problem = self.neighbour.problem(plan.id)
        if not problem and self.engagement.engaged and not self._is_way_back(plan):
            problem = self.engaged()
        if not problem and plan.segments:
            problem = lacks(self.tool, plan) or self.tool.problem(plan.segments[0].requires)
            if not problem and self._way_back is not None and self._is_way_back(plan):
                if set(plan.segments[0].requires) != set(self._way_back[1].requires(self.tool)):
                    problem = Sentence(
                        "the tool reads something else since the way back was planned; call plan_way_back"
                    )
        if problem:
            raise ReviewError(Sentence("plan {plan} may not start: {reason}", plan=plan.id, reason=problem))
        self.under_review.check_scene()
        if not override and (unrehearsed := self.rehearsal_problem(plan)):
            raise ReviewError(unrehearsed)
        assert self._setpoint is not None  # in IDLE there always is one
        check_start_pose(plan, self._setpoint, self._robot)

    def look_for_obstacle(self) -> None:
        """Look anew why the plan under review could not be approved now, and whether only its rehearsal is against it."""
        plan = self.under_review.plan
        self.approval_obstacle, self.overridable = "", False
        if plan is None:
            return
        for override in (False, True):
            try:
                self.check_start(plan, override)
            except ReviewError as error:
                self.approval_obstacle = self.approval_obstacle or str(error)
            else:
                self.overridable = override
                return

    def is_ready(self) -> bool:
        """Return whether a plan is under review and nothing that passes by itself is against approving it."""
        ready = self.state is ExecutorState.IDLE and self._sync is SyncState.IN_SYNC and not self._unarmed
        plan = self.under_review.plan
        if not ready or plan is None or not self.under_review.scene or not self.under_review.scene_alive:
            return False
        if awaited(self.tool, plan) or (self.rehearsal.awaits(plan) and not self._is_way_back(plan)):
            return False
        return not self.neighbour.problem(plan.id)

    def reject(self, verdict: Verdict) -> None:
        """Take a plan out of review because a person said no; tell it with the next `take_events`. Its record is the caller's."""
        self._acted = True
        self.under_review.decide(verdict.plan_id, verdict.plan_hash, verdict.reviewer)
        self._events.append(verdict)

    def begin(self, plan: Plan, reason: str, may_wait: int = LIFETIME) -> None:
        """Play a plan that `Approval` has checked and recorded; it ends when it has not begun to move for `may_wait` [ns]."""
        self._approved, self._begin_by = plan, self._now + may_wait
        self._on(ExecutorEvent.APPROVED, reason)

    def tell_withdrawn(self, plan: Plan | None, reason: str) -> None:
        """Tell that a plan is not, or no longer, under review."""
        if plan is not None:
            self._events.append(Verdict(WITHDRAWN, plan.id, plan.hash, EXECUTOR, reason, plan))

    def take_events(self) -> list[Verdict | Ending]:
        """Return what is new, to be published: plans withdrawn or rejected, executions ended. Rejections are recorded already."""
        events, self._events = self._events, []
        return events

    def take_act(self) -> bool:
        """Return whether a person's stop, pause or rejection is to be told of: since the last call, or while the arm brakes."""
        acted, self._acted = self._acted, self._acted and self.state in _BRAKING
        return acted

    # -- reports

    def news(self) -> tuple:
        """Return what of `report` is worth a new one when it changes: first what is worth a line in a log, too."""
        work, active = self.segment_run, self.state in ACTIVE
        where = work and (work.number, active and work.at_boundary, active and work.expected_scene)
        # a limit that follows a sensor changes all the time: a hundredth is worth a report
        limit = round(self.limit.fraction, 2)
        logged = self.state, self.cause, self.limit.standing
        review = self.approval_obstacle, self.overridable, self.engagement.engaged
        return logged, self.reason, self.plan_start, self.outcome, self.steady, limit, where, review

    def report(self, stamp: int, moment: str) -> ExecutionReport:
        """Return what it does now, by the time `stamp` [ns] and the robot's clock."""
        plan, work, active = self.plan, self.segment_run, self.state in ACTIVE
        segment = work.segment if work is not None else None
        expected = work.expected_scene if work is not None and active else ""
        return ExecutionReport(
            state=self.state.value,
            text=self.state.name,
            reason=self.reason,
            plan_id=plan.id if plan is not None else "",
            outcome=self.outcome,
            plan_start=self.plan_start,
            duration=plan.trajectory.duration if plan is not None else 0.0,
            rate=self.rate,
            speed_limit=self.limit.fraction,
            segment=work.number if work is not None else -1,
            segment_name=segment.name if segment is not None else "",
            at_boundary=work is not None and active and work.at_boundary,
            wants_scene=bool(expected),
            engaged=self.engagement.engaged,
            expected_scene=expected,
            approval_obstacle=self.approval_obstacle,
            overridable=self.overridable,
            stamp=stamp,
            moment=moment,
        )

    # -- while a plan is played

    def stop(self, now: int) -> str:
        """Brake along the path as hard as the acceleration limits allow; return one sentence.

        Plans asked for until `now` [ns] are void, so that nothing that a person stopped is taken up again by itself.
        """
        self._acted, self.rested = True, now
        reason = Sentence("stop requested")
        waiting = self.under_review.void(now)
        is_active = self.state in ACTIVE
        sentence = self._stop(reason) if is_active else Sentence("nothing is playing ({state})", state=self.state.name)
        self.side_effects.run("the verdict on a waiting plan", self.tell_withdrawn, waiting, reason)
        return sentence

    def stop_plan(self, plan_id: str, reason: str, now: int) -> str:
        """Brake one plan along its path as `stop` does, and leave the plans alone that wait; return one sentence."""
        self._acted = True
        if self.state not in ACTIVE:
            values = {"plan": repr(plan_id), "state": self.state.name, "reason": self.reason}
            raise ExecutionError(Sentence("plan {plan} is not played: the executor is {state} ({reason})", **values))
        if self._played.plan.id != plan_id:
            plans = {"plan": repr(plan_id), "present": self._played.plan.id}
            raise ExecutionError(Sentence("plan {plan} is not played: the executor plays plan {present}", **plans))
        self.rested = now
        return self._stop(reason)

    def _stop(self, reason: str) -> str:
        if self.plan_start == 0:
            self._on(ExecutorEvent.STOP, Sentence("stopped before it began"))
            return Sentence("plan {plan} had not begun", plan=self._played.plan.id)
        brakes = self.state is ExecutorState.STOPPING
        self._on(ExecutorEvent.STOP, reason)
        if brakes:
            return Sentence("plan {plan} is braking already", plan=self._played.plan.id)
        if self.state is not ExecutorState.STOPPING:
            return Sentence("plan {plan} ended at rest", plan=self._played.plan.id)
        if not self.limit.waits:
            return Sentence("braking plan {plan}", plan=self._played.plan.id)
        # also where the setpoints rest already, the gateway still plays what it has put off
        return Sentence(
            "braking plan {plan}; the arm trails by much, and goes on until it is there", plan=self._played.plan.id
        )

    def braking(self) -> StopForecaster | None:
        """Return what tells where a stop that was just asked for will end, to be computed outside of any lock; else None."""
        return self._played.braking(self.lag) if self.state is ExecutorState.STOPPING else None

    def pause(self, now: int) -> str:
        """Brake along the path smoothly and rest on it. Plans asked for until `now` [ns] and not here are void."""
        if not ROWS[self.state, ExecutorEvent.PAUSE]:
            values = {"state": self.state.name, "reason": self.reason}
            raise ExecutionError(Sentence("nothing to pause: the executor is {state} ({reason})", **values))
        self._acted, self.rested = True, now
        before, plan = self.state, self._played.plan.id
        if before in (ExecutorState.PLAYING, ExecutorState.AT_BOUNDARY):
            self.under_review.void_coming(now)
        self._on(ExecutorEvent.PAUSE, Sentence("pause requested"))
        if self.segment_run is not None and before is ExecutorState.AT_BOUNDARY:
            where = self.side_effects.run("where a pause rests", lambda work: work.where, self.segment_run)
            return Sentence(
                "plan {plan} rests {where}; resume goes on", plan=plan, where=where or Sentence("at a boundary")
            )
        if before is ExecutorState.HELD:
            return Sentence("plan {plan} is HELD, and stays at rest when twin and arm agree; resume goes on", plan=plan)
        if before is not ExecutorState.PLAYING:
            return Sentence("plan {plan} is {state} already", plan=plan, state=before.name)
        return Sentence("plan {plan} comes to rest on its path; resume goes on", plan=plan)

    def resume(self, may_wait: int = LIFETIME) -> str:
        """Go on along the same path, within `may_wait` [ns] where it had not moved yet; return one sentence."""
        if not ROWS[self.state, ExecutorEvent.RESUME]:
            values = {"state": self.state.name, "reason": self.reason}
            raise ExecutionError(Sentence("nothing to resume: the executor is {state} ({reason})", **values))
        if self._sync is not SyncState.IN_SYNC:
            raise ExecutionError(
                Sentence("twin and physical arm are not in sync ({state}); resume when they are", state=self._sync.name)
            )
        if self._unarmed:
            raise ExecutionError(Sentence("the arm is not armed ({reason}); resume when it is", reason=self._unarmed))
        self._begin_by = self._now + may_wait
        self._on(ExecutorEvent.RESUME, Sentence("resumed"))
        rest = self._played.plan.trajectory.duration - self._played.elapsed
        return Sentence("plan {plan} goes on; {rest:.3f} s of it are left", plan=self._played.plan.id, rest=rest)

    # -- output

    def step(self, stamp: int, now: int) -> tuple[float, ...] | None:
        """Return the setpoint for the cycle with nominal stamp `stamp` [ns], or None when nothing may be sent."""
        self.neighbour.now = self._now = now
        machine = self._machine
        if machine.state is ExecutorState.WAITING and self._agreed and self._fresh_twin(now) is not None:
            self._on(ExecutorEvent.AGREED, Sentence("twin and physical arm agree"))
        if machine.state is ExecutorState.WAITING:
            return None
        if machine.state in _MAY_BEGIN and now > self._begin_by and not self._played.moved:
            waits, seconds = self._waits_for(), LIFETIME / NANOSECONDS
            void = Sentence("not begun, {waits}: an approval is void after {seconds:g} s", waits=waits, seconds=seconds)
            self._on(ExecutorEvent.TIMEOUT, void)
        if machine.state is ExecutorState.AT_BOUNDARY:
            self._wait_at_boundary(stamp, now)
        if machine.state is ExecutorState.IDLE:
            return self._repeat_twin(stamp, now)
        return self._advance(stamp)

    def _fresh_twin(self, now: int) -> TwinPose | None:
        return self._twin if self._twin is not None and now - self._twin.received <= TWIN_TIMEOUT else None

    def _repeat_twin(self, stamp: int, now: int) -> tuple[float, ...] | None:
        twin = self._fresh_twin(now)
        if twin is None:
            self._on(ExecutorEvent.TWIN_LOST, Sentence("the twin's pose is not known"))
            return None
        # until the twin has executed the last setpoint it has not arrived; repeating its pose would step back
        if twin.stamp >= self._setpoint_stamp:
            self._setpoint = twin.q
        return self._setpoint

    def _waits_for(self) -> str:
        """Return why a plan that was approved stands at its beginning."""
        if self.state is ExecutorState.HELD:
            return Sentence("the gate holds ({state})", state=self._sync.name)
        if self.segment_run is not None and self.state is ExecutorState.AT_BOUNDARY:
            return self.segment_run.waits_for()
        if self.limit.waits and self.limit.fraction > 0.0:
            return self.limit.sentence("")
        if self.limit.fraction < 1.0:
            return self.limit.reason
        return Sentence("as its motion was due too late")

    def _wait_at_boundary(self, stamp: int, now: int) -> None:
        work = self.segment_run
        assert work is not None  # only a work plan has boundaries
        scene = self.under_review.scene if self.under_review.scene_alive else ""
        event = work.update(stamp, now, self.tool, scene, self.limit.rate > 0.0)
        if event is not None:
            self._on(event.event, event.reason)
        else:
            cause = Sentence("stands {where}, {waits}", where=work.where, waits=work.waits_for())
            if cause != self.cause:
                self._machine.reason = cause
                self._say()

    def _advance(self, stamp: int) -> tuple[float, ...]:
        playback, machine = self._played, self._machine
        if machine.state is ExecutorState.STOPPING:
            self._setpoint = playback.brake(stamp)
            self._stopping.append(self._setpoint)
        else:
            rate = self.limit.rate if machine.state is ExecutorState.PLAYING else 0.0
            self._setpoint = playback.advance(stamp, rate)
        self._setpoint_stamp = stamp
        if self.segment_run is not None and playback.goal_stamp:
            self._on(ExecutorEvent.SEGMENT_END, Sentence("stopped {where}", where=self.segment_run.where))
        elif playback.goal_stamp and machine.state is not ExecutorState.HELD:
            # a hold may still come that takes back the last setpoints: then the plan must be there to go on
            if self._policy != RESUME or self._passed >= playback.goal_stamp:
                self._on(ExecutorEvent.GOAL, Sentence("goal reached"))
        elif playback.at_rest:
            self._on(ExecutorEvent.AT_REST)
            if machine.state is ExecutorState.PLAYING and not self.limit.standing and self.limit.rate == 0.0:
                self.limit.standing = True
                self._say()
        elif self.limit.standing:
            self.limit.standing = False
            self._say()
        return self._setpoint

    # -- the table

    def _on(self, event: ExecutorEvent, reason: str = "") -> None:
        """Take an event: the first row of the table whose guard is true counts; without one nothing changes."""
        self._machine.on(event, Occasion(reason))

    def _guards(self) -> dict[Guard, Callable[[Occasion], bool]]:
        return {
            Guard.BEGUN: lambda occasion: self.plan_start != 0,
            Guard.KNOWN: lambda occasion: self._played.knows(self._passed),
            Guard.PAUSED: lambda occasion: self._paused,
            Guard.WORK: lambda occasion: self._is_work(),
            Guard.BOUNDARY: lambda occasion: self.segment_run is not None and self.segment_run.at_boundary,
        }

    def _is_work(self) -> bool:
        # `begin` has set it before the event
        plan = self._approved if self.state is ExecutorState.IDLE else self._played.plan
        return plan is not None and bool(plan.segments)

    def _actions(self) -> dict[Action, Callable[[Row], None]]:
        return {
            Action.NOTHING: lambda row: None,
            Action.START_FROM_TWIN: self._start_from_twin,
            Action.FORGET_TWIN: self._forget_twin,
            Action.PLAY: self._play,
            Action.BRAKE: self._brake,
            Action.STAND: self._stand,
            Action.NOTE_PAUSE: self._note_pause,
            Action.ARRIVE: self._arrive,
            Action.ENTER: lambda row: self._played.enter(self._run_at_boundary.enter()),
            Action.VOID: lambda row: self._run_at_boundary.pause(),
            Action.REARM: lambda row: self._run_at_boundary.resume(self._now),
            **{action: self._end for action in OUTCOMES},
        }

    def _with_sentence(self, act: Callable[[Row], None]) -> Callable[[Row, Occasion], str]:
        """Return an action that answers with the sentence for the state that is entered."""

        def carry_out(row: Row, occasion: Occasion) -> str:
            act(row)
            # what a state is entered for is said of a change that takes place: the arm brakes without the sentence, too
            sentence = self.side_effects.run("the executor's sentence", self._sentence, row, occasion.reason)
            sentence = sentence or occasion.reason
            if row.action in OUTCOMES:
                sentence = self._end_work(row.action, sentence)
                self._events.append(Ending(self._played.plan, self.outcome, sentence))
            return sentence if self._is_told(row) else self.cause

        return carry_out

    @staticmethod
    def _is_told(row: Row) -> bool:
        # a restart is told although the state stays
        return row.target is not row.state or row.action is Action.FORGET_TWIN

    def _after(self, row: Row, occasion: Occasion) -> None:
        if self._is_told(row):
            self._begin_saying()
        if row.event in _BY_GATE and self.state is ExecutorState.IDLE:
            self._closed = occasion.reason

    # -- actions

    def _start_from_twin(self, row: Row) -> None:
        assert self._twin is not None  # the event says that its pose is known
        self._setpoint, self._setpoint_stamp = self._twin.q, 0
        self.engagement.see(self._twin.q)

    def _forget_twin(self, row: Row) -> None:
        self._twin, self._agreed, self._setpoint = None, False, None

    def _play(self, row: Row) -> None:
        assert self._approved is not None  # `begin` has set it
        self._playback, self.outcome = Playback(self._approved, self._robot), ""
        self._orders += [] if self.segment_run is None else self.segment_run.take_orders()
        self.segment_run = None
        if self._approved.segments:
            self.segment_run = SegmentRun(self._approved, self.engagement, self._is_way_back(self._approved))

    def _brake(self, row: Row) -> None:
        assert self._setpoint is not None  # the row's guard: one was sent
        self._stopping = [self._setpoint]

    def _stand(self, row: Row) -> None:
        self._played.rest_where(self._passed)
        self._paused = row.state in (ExecutorState.PAUSING, ExecutorState.PAUSED)

    def _note_pause(self, row: Row) -> None:
        self._paused = True

    @property
    def _run_at_boundary(self) -> SegmentRun:
        assert self.segment_run is not None  # only a work plan has boundaries
        return self.segment_run

    def _arrive(self, row: Row) -> None:
        work = self._run_at_boundary
        self._played.arrive()
        work.arrive()

    def _end(self, row: Row) -> None:
        self.outcome = OUTCOMES[row.action]

    def _end_work(self, action: Action, sentence: str) -> str:
        """End the execution of a work plan, if it was one; return the sentence for its end."""
        work = self.segment_run
        if work is None:
            return sentence
        if action is not Action.FINISH:
            where = self.side_effects.run("where a work plan ends", lambda: work.where) or Sentence("where it stands")
            sentence = Sentence("{reason}; {where} the rest is dropped", reason=sentence, where=where)
        was_engaged = self.engagement.engaged
        self._orders += work.end(action is Action.FINISH, self._played.elapsed, sentence)
        if self.engagement.engaged and not was_engaged:
            waiting = self.under_review.clear()
            self.side_effects.run("the verdict on a waiting plan", self._withdraw_other, waiting)
        if action is Action.FINISH:
            return sentence
        if self.engagement.engaged:
            return Sentence("{end}; the arm is engaged: {remedy}", end=sentence, remedy=REMEDY)
        return Sentence("{end}: look at arm and tool, then plan the task again from where things are", end=sentence)

    def _withdraw_other(self, plan: Plan | None) -> None:
        self.tell_withdrawn(plan, Sentence("not the way back: {engaged}", engaged=self.engaged()))

    def _sentence(self, row: Row, reason: str) -> str:
        """Return why the next state is entered, in words for the operator."""
        if row.event is ExecutorEvent.GATE_HOLDS:
            if row.state is ExecutorState.STOPPING:
                return both(self.cause, reason)
            if row.action is Action.LOSE:
                return Sentence(
                    "{hold} at a setpoint that is none of plan {plan}", plan=self._played.plan.id, hold=reason
                )
            elapsed = self._played.elapsed
            return Sentence("{hold} {elapsed:.3f} s into the plan; goes on by itself", hold=reason, elapsed=elapsed)
        if row.target is ExecutorState.AT_BOUNDARY:
            where = self._run_at_boundary.where
            if row.event is ExecutorEvent.APPROVED:
                return Sentence("{reason}; stands {where}", reason=reason, where=where)
            return Sentence("stands {where}", where=where)
        if row.target is ExecutorState.PAUSED:
            return Sentence("at rest {elapsed:.3f} s into the plan; resume goes on", elapsed=self._played.elapsed)
        if row.event is ExecutorEvent.GATE_OPENS:
            return Sentence("twin and arm agree again; the same approval covers the rest")
        if row.event is ExecutorEvent.NEXT_SEGMENT:
            work = self._run_at_boundary
            assert work.segment is not None  # it was entered
            return Sentence("segment {number} ({name})", number=work.number, name=repr(work.segment.name))
        if row.event in (ExecutorEvent.AT_REST, ExecutorEvent.SEGMENT_END) and row.state is ExecutorState.STOPPING:
            path = distance_along(self._stopping).text(self._robot)
            return Sentence("{reason}; at rest after {path}", reason=self.cause, path=path)
        return reason

    def _begin_saying(self) -> None:
        self.limit.standing, self._closed = False, ""
        self._say()

    def _say(self) -> None:
        self.reason = self.limit.sentence(self.cause) if self.state is ExecutorState.PLAYING else self.cause

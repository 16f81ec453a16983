"""The executor: one setpoint per cycle, from an approved plan or, idle, the twin's pose.

`step` is called once per 4 ms with the cycle's nominal stamp [ns]. Angles in rad. `now` is on the monotonic clock, but for `stop`,
`pause` and `restart`: these are compared with when a plan was asked for, on the robot's clock (`core.freshness`).
"""

from __future__ import annotations

from construction_twin.core.errors import ExecutionError, ReviewError
from construction_twin.core.freshness import LIFETIME
from construction_twin.core.reports import ToolReport
from construction_twin.core.sentences import Sentence, replace_part
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.engagement import Engagement
from construction_twin.execution.machine import ExecutorMachine, TwinPose
from construction_twin.execution.segment_run import ToolOrder
from construction_twin.execution.states import ACTIVE, ROWS, SURVIVED, ExecutorEvent, ExecutorState
from construction_twin.monitor.settings import REPLAN, RESUME
from construction_twin.monitor.states import SyncState
from construction_twin.review.plan_under_review import ExecutionEnd, Verdict
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan

#: States in which a plan begins, or goes on, without another word of a person.
_MAY_BEGIN = (ExecutorState.PLAYING, ExecutorState.HELD, ExecutorState.AT_BOUNDARY)
#: States in which a person's act is under way.
_BRAKING = (ExecutorState.STOPPING, ExecutorState.PAUSING)
#: The twin's pose counts as known this long after its last message [ns].
TWIN_TIMEOUT = NANOSECONDS // 2


class Executor(ExecutorMachine):
    """Plays approved plans as theta_next: `step` is the cycle; inputs and requests become events.

    `unarmed`: why the arm is not armed, empty: it is; `rested`: the newest stop or pause [ns of the robot's clock], or -1.
    """

    def __init__(self, robot: RobotModel, saved: Engagement | None = None):
        super().__init__(robot, saved)
        self.sync, self._policy = SyncState.WAITING, ""
        self.unarmed, self._session = "", ""
        self._acted, self.rested = False, -1
        #: Until then the approval, or a resume, of a plan counts that has not begun to move [ns].
        self._begin_by = 0

    # -- the cycle

    def step(self, stamp: int, now: int) -> tuple[float, ...] | None:
        """Return the setpoint for the cycle with nominal stamp `stamp` [ns], or None when nothing may be sent."""
        self.now, limit, work = now, self.limit, self.segment_run
        twin = self._twin if self._twin is not None and now - self._twin.received <= TWIN_TIMEOUT else None
        if self.state is ExecutorState.WAITING and self._agreed and twin is not None:
            self._on(ExecutorEvent.AGREED, Sentence("twin and physical arm agree"))
        if self.state is ExecutorState.WAITING:
            return None

        # what has not begun in time never does
        if self.state in _MAY_BEGIN and now > self._begin_by and not self._played.moved:
            waits, seconds = self._waits_for(), LIFETIME / NANOSECONDS
            void = Sentence("not begun, {waits}: an approval is void after {seconds:g} s", waits=waits, seconds=seconds)
            self._on(ExecutorEvent.TIMEOUT, void)

        # a work plan stands until tool and scene are as planned
        if self.state is ExecutorState.AT_BOUNDARY:
            scene = self.under_review.scene if self.under_review.scene_alive else ""
            event = self._work.update(stamp, now, self.tool, scene, limit.rate > 0.0)
            if event is not None:
                self._on(event.event, event.reason)
            else:
                self.cause = Sentence("stands {where}, {waits}", where=self._work.where, waits=self._work.waits_for())

        if self.state is ExecutorState.IDLE:
            if twin is None:
                self._on(ExecutorEvent.TWIN_LOST, Sentence("the twin's pose is not known"))
                return None
            # until the twin has executed the last setpoint it has not arrived; repeating its pose would step back
            if twin.stamp >= self._setpoint_stamp:
                self.setpoint = twin.q
            return self.setpoint

        playback = self._played
        if self.state is ExecutorState.STOPPING:
            self.setpoint = playback.stop(stamp)
            self._stopping.append(self.setpoint)
        else:
            self.setpoint = playback.play(stamp, limit.rate if self.state is ExecutorState.PLAYING else 0.0)
        self._setpoint_stamp = stamp

        if playback.goal_stamp and work is not None:
            self._on(ExecutorEvent.SEGMENT_END, Sentence("stopped {where}", where=work.where))
        elif playback.goal_stamp and self.state is not ExecutorState.HELD:
            # a hold may still come that takes back the last setpoints: then the plan must be there to go on
            if self._policy != RESUME or self._passed >= playback.goal_stamp:
                self._on(ExecutorEvent.GOAL, Sentence("goal reached"))
        elif playback.at_rest:
            self._on(ExecutorEvent.AT_REST)
            limit.standing = limit.standing or (self.state is ExecutorState.PLAYING and limit.rate == 0.0)
        else:
            limit.standing = False
        return self.setpoint

    def _waits_for(self) -> str:
        """Return what an approved plan waits for at its beginning."""
        if self.state is ExecutorState.HELD:
            return Sentence("the gate holds ({state})", state=self.sync.name)
        if self.state is ExecutorState.AT_BOUNDARY:
            return self._work.waits_for()
        if self.limit.waits and self.limit.fraction > 0.0:
            return self.limit.sentence("")
        return self.limit.reason if self.limit.fraction < 1.0 else Sentence("as its motion was due too late")

    def pop_orders(self) -> list[ToolOrder]:
        """Return the orders to the tool since the last call."""
        orders, self.orders = self.orders, []
        return orders if self.segment_run is None else orders + self.segment_run.pop_orders()

    def pop_events(self) -> list[Verdict | ExecutionEnd]:
        """Return the new verdicts and ends, to be published; rejections are recorded already."""
        events, self.events = self.events, []
        return events

    def pop_act_flag(self) -> bool:
        """Return whether a person has stopped, paused or rejected since the last call, or the arm still brakes for it."""
        acted, self._acted = self._acted, self._acted and self.state in _BRAKING
        return acted

    # -- what comes from outside

    def on_twin(self, stamp: int, q: tuple[float, ...], now: int) -> None:
        """Store the twin's pose [rad], the stamp of the command it executes, and the time of reception [ns]."""
        self._twin = TwinPose(stamp, q, now)

    def on_sync(self, state: SyncState, agreed: bool, policy: str = REPLAN, held_stamp: int = 0) -> None:
        """Store the monitor's state; on any but IN_SYNC hold the plan, or drop its rest.

        Only the policy ``resume`` keeps it: it waits at `held_stamp`, the last setpoint that passed [ns], and goes on by itself.
        """
        self.sync, self._agreed, self._policy, self._passed = state, agreed, policy, held_stamp
        if self._closed and state is SyncState.IN_SYNC:
            self.cause = replace_part(self.cause, self._closed, Sentence("the gate held, and is open again"))
            self._closed = ""
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
        self.unarmed = "" if armed else reason
        if not armed:
            self._on(ExecutorEvent.DISARMED, Sentence("the arm is no longer armed: {reason}", reason=reason))

    def on_scene(self, scene: str) -> None:
        """Store the scene's hash; withdraw, stop or end a plan made for another scene."""
        scenes = {"before": self.under_review.scene[:12] or "none", "after": scene[:12]}
        withdrawn = self.under_review.on_scene(scene)
        self.record_withdrawal(withdrawn, Sentence("the scene changed from {before} to {after}; plan again", **scenes))
        if self.state not in ACTIVE:
            return
        reason, work = Sentence("the scene changed from {before} to {after}", **scenes), self.segment_run
        if work is None and scene != self._played.plan.scene:
            self._on(ExecutorEvent.STOP, reason)
        elif work is not None and not work.allows_scene(scene):
            reason = Sentence("{change}, which was not planned {where}", change=reason, where=work.where)
            self._on(ExecutorEvent.LOST, reason)

    def on_conflict(self, plan_id: str, problem: str) -> None:
        """Store the neighbour watch's objection to a plan, empty for none; stop the plan if it is played."""
        if problem and self.state in ACTIVE and self._played.plan.id == plan_id:
            self._on(ExecutorEvent.STOP, problem)

    def on_tool(self, report: ToolReport, now: int) -> None:
        """Store the tool's report and its time of reception [ns]; stop a work plan that requires other inputs."""
        self.tool = report
        if self.segment_run is not None and self.state in ACTIVE:
            if problem := self.segment_run.obstacle(report, now):
                self._on(ExecutorEvent.LOST, problem)

    def restart(self, reason: str, now: int) -> None:
        """Drop everything, plans asked for until `now` [ns] too, and wait for twin and arm to agree again."""
        # of a new session's arm nothing is known yet
        self.limit.waits = False
        self.record_withdrawal(self.under_review.void(now), reason)
        while self.state is not ExecutorState.WAITING:
            self._on(ExecutorEvent.NEW_SESSION, reason)
        self._on(ExecutorEvent.NEW_SESSION, reason)

    def stall(self, reason: str) -> None:
        """Drop a moving plan after a gap in the setpoints; the gateway brakes the arm."""
        if not self.limit.standing:
            self._on(ExecutorEvent.STALLED, reason)

    # -- review, and the start of a plan: `Approval`

    def offer(self, plan: Plan, way_back: Engagement | None = None) -> None:
        """Put a plan under review in place of the one before, or raise ReviewError; `way_back`: the engagement it leads out of."""
        active = self.engagement.active
        if active is not None and active is not way_back:
            reason = self.engagement.sentence
            raise ReviewError(Sentence("plan {plan} cannot be reviewed: {reason}", plan=plan.id, reason=reason))
        self.record_withdrawal(self.under_review.offer(plan), Sentence("replaced by plan {plan}", plan=plan.id))
        self.engagement.way_back = None if way_back is None else (plan.id, way_back)

    def reject(self, verdict: Verdict) -> None:
        """Reject the plan under review; `pop_events` reports it, the caller records it."""
        self._acted = True
        self.under_review.decide(verdict.plan_id, verdict.plan_hash, verdict.reviewer)
        self.events.append(verdict)

    def begin(self, plan: Plan, reason: str, may_wait: int = LIFETIME) -> None:
        """Play a plan that `Approval` has checked and recorded; end it unless it moves within `may_wait` [ns]."""
        self._approved, self._begin_by = plan, self.now + may_wait
        self._on(ExecutorEvent.APPROVED, reason)

    # -- what persons ask for while a plan is played

    def stop(self, now: int) -> str:
        """Brake along the path as hard as the limits allow; return one sentence. Plans asked for until `now` [ns] are void."""
        self._acted, self.rested = True, now
        reason = Sentence("stop requested")
        waiting = self.under_review.void(now)
        is_active = self.state in ACTIVE
        sentence = self._stop(reason) if is_active else Sentence("nothing is playing ({state})", state=self.state.name)
        self.side_effects.run("the verdict on a waiting plan", self.record_withdrawal, waiting, reason)
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
        plan, braked = self._played.plan.id, self.state is ExecutorState.STOPPING
        if self.plan_start == 0:
            self._on(ExecutorEvent.STOP, Sentence("stopped before it began"))
            return Sentence("plan {plan} had not begun", plan=plan)
        self._on(ExecutorEvent.STOP, reason)
        if braked:
            return Sentence("plan {plan} is braking already", plan=plan)
        if self.state is not ExecutorState.STOPPING:
            return Sentence("plan {plan} ended at rest", plan=plan)
        if not self.limit.waits:
            return Sentence("braking plan {plan}", plan=plan)
        # also where the setpoints rest already, the gateway still plays what it has put off
        return Sentence("braking plan {plan}; the arm trails by much, and goes on until it is there", plan=plan)

    def pause(self, now: int) -> str:
        """Brake smoothly and rest on the path; plans requested until `now` [ns] that arrive later are void."""
        if not ROWS[self.state, ExecutorEvent.PAUSE]:
            values = {"state": self.state.name, "reason": self.reason}
            raise ExecutionError(Sentence("nothing to pause: the executor is {state} ({reason})", **values))
        self._acted, self.rested = True, now
        before, plan = self.state, self._played.plan.id
        if before in (ExecutorState.PLAYING, ExecutorState.AT_BOUNDARY):
            self.under_review.void_requests_before(now)
        self._on(ExecutorEvent.PAUSE, Sentence("pause requested"))
        if before is ExecutorState.AT_BOUNDARY:
            where = self.side_effects.run("where a pause rests", lambda: self._work.where)
            where = where or Sentence("at a boundary")
            return Sentence("plan {plan} rests {where}; resume goes on", plan=plan, where=where)
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
        if self.sync is not SyncState.IN_SYNC:
            raise ExecutionError(
                Sentence("twin and physical arm are not in sync ({state}); resume when they are", state=self.sync.name)
            )
        if self.unarmed:
            raise ExecutionError(Sentence("the arm is not armed ({reason}); resume when it is", reason=self.unarmed))
        self._begin_by = self.now + may_wait
        self._on(ExecutorEvent.RESUME, Sentence("resumed"))
        rest = self._played.plan.trajectory.duration - self._played.elapsed
        return Sentence("plan {plan} goes on; {rest:.3f} s of it are left", plan=self._played.plan.id, rest=rest)

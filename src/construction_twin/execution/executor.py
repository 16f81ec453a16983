"""The executor: one setpoint per cycle, from an approved plan or, idle, the twin's pose.

Pure: `step` is called once per 4 ms with the cycle's nominal stamp [ns]. Angles in rad. `now` is on a clock that nobody sets, but
for `stop` and `restart`: these are compared with when a plan was made, on the clock of the stamps.
"""

from __future__ import annotations

from construction_twin.core.errors import ExecutionError, ReviewError
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.conflict_verdicts import NeighbourWatch
from construction_twin.execution.play_rate import PlayRate
from construction_twin.execution.playback import Braking, Playback
from construction_twin.execution.start_pose import check_start_pose
from construction_twin.execution.states import ACTIVE, MOVING, RESTING, SURVIVED, ExecutorState
from construction_twin.execution.stopping import distance_along
from construction_twin.monitor.gate import REPLAN, RESUME, SyncState
from construction_twin.review.queue import APPROVED, EXECUTOR, REJECTED, WITHDRAWN, Ending, ReviewDesk, Verdict
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import Plan

#: The twin's pose counts as known this long after its last message [ns].
TWIN_TIMEOUT = NANOSECONDS // 2


class Executor:
    """Plays approved plans as theta_next.

    Parameters
    ----------
    robot : RobotModel

    Attributes
    ----------
    lag : float
        How long the arm trails the setpoints, as far as is known [s]; only stated, never acted upon.
    neighbour : NeighbourWatch
        Says whether another arm stands in the way of a plan; by default there is none.
    limit : PlayRate, set by `limit_rate`
    cause, reason : str
        Why the state was entered; and the same with what the speed limit makes of it now.
    """

    def __init__(self, robot: RobotModel):
        self._robot = robot
        self.lag = 0.0
        self.neighbour = NeighbourWatch()
        self.desk = ReviewDesk()
        self.state = ExecutorState.WAITING
        self.cause = self.reason = "started; waits for twin and physical arm to agree"
        self.outcome = ""
        self._playback: Playback | None = None
        self._after_hold = ExecutorState.PLAYING
        self.limit = PlayRate()
        self._stopping: list[tuple[float, ...]] = []
        self._events: list[Verdict | Ending] = []
        self._sync = SyncState.WAITING
        self._agreed = False
        self._policy, self._passed = "", 0
        self._unarmed = ""
        self._twin: tuple[int, tuple[float, ...], int] | None = None
        self._setpoint: tuple[float, ...] | None = None
        self._setpoint_stamp = 0

    @property
    def plan(self) -> Plan | None:
        """The plan that is played, or the last one that was."""
        return self._playback.plan if self._playback else None

    @property
    def plan_start(self) -> int:
        """Nominal stamp of that plan's first setpoint [ns]; 0 when none was sent."""
        return self._playback.start if self._playback else 0

    @property
    def rate(self) -> float:
        """Present fraction of the planned speed, 0 to 1; 0 when nothing is played."""
        return self._playback.rate if self.state in ACTIVE else 0.0

    @property
    def steady(self) -> bool:
        """True when the rate does not change at the moment."""
        return self.state not in ACTIVE or self._playback.steady

    # -- inputs

    def on_twin(self, stamp: int, q: tuple[float, ...], now: int) -> None:
        """Take the twin's pose [rad], the stamp of the command it executes, and the time of reception [ns]."""
        self._twin = stamp, q, now

    def on_sync(self, state: SyncState, agreed: bool, policy: str = REPLAN, held_stamp: int = 0) -> None:
        """Take the monitor's state; on anything but IN_SYNC the plan is held, or its rest is dropped.

        Parameters
        ----------
        state : SyncState
        agreed : bool
        policy : str
            What happens after a violation; only ``resume`` keeps the plan.
        held_stamp : int
            Nominal stamp of the last setpoint that passed the gate [ns]: there the plan waits, and goes on by itself.
        """
        self._sync, self._agreed, self._policy, self._passed = state, agreed, policy, held_stamp
        if self.state not in ACTIVE:
            return
        if state is SyncState.IN_SYNC:
            if self.state is ExecutorState.HELD:
                self._go_on()
        elif policy != RESUME or state not in SURVIVED:
            self._finish("held", f"the gate holds ({state.name})")
        elif self.state is not ExecutorState.HELD:
            self._hold(state, held_stamp)

    def on_link(self, armed: bool, reason: str) -> None:
        """Take the link's state; without a physical arm there is none. While the arm is not armed nothing is played."""
        self._unarmed = "" if armed else reason
        if not armed and self.state in ACTIVE:
            self._finish("dropped", f"the arm is no longer armed: {reason}")

    def on_scene(self, scene: str) -> None:
        """Take the present scene's hash: what was planned for another one is withdrawn, stopped or ended."""
        before = self.desk.scene
        reason = f"the scene changed from {before[:12] or 'none'} to {scene[:12]}"
        self.turn_down(self.desk.on_scene(scene), f"{reason}; plan again")
        if self.state in ACTIVE and scene != self.plan.scene:
            self._halt(reason)

    def limit_rate(self, factor: float, reason: str = "") -> None:
        """Play at most at this fraction of the planned speed from now on; 0 stands still until it is raised. The path stays.

        Parameters
        ----------
        factor : float
            0 to 1.
        reason : str, optional
            Why, for the operator.

        Raises
        ------
        ExecutionError
        """
        if self.limit.take(factor, reason):
            self._say()

    def restart(self, reason: str, now: int) -> None:
        """Drop everything, plans asked for until `now` [ns] too, and wait for twin and arm to agree again."""
        self.turn_down(self.desk.void(now), reason)
        if self.state in ACTIVE:
            self._finish("dropped", reason)
        self._wait(reason)

    def stall(self, reason: str) -> None:
        """Drop a moving plan because setpoints could not be produced in time; the arm is left to the gateway's braking."""
        if self.state in MOVING and not self.limit.standing:
            self._finish("dropped", reason)

    # -- review

    def offer(self, plan: Plan) -> None:
        """Put a plan on the desk in place of the one before; ReviewError when it cannot be reviewed."""
        self.turn_down(self.desk.offer(plan), f"replaced by plan {plan.id}")

    def examine(self, plan_id: str, plan_hash: str, approve: bool, reviewer: str, reason: str = "") -> Verdict:
        """Return the verdict that could be carried out now; nothing is changed.

        Raises
        ------
        ReviewError
            When it cannot be taken; an approval that came at the wrong moment leaves the plan on the desk.
        """
        self.desk.check(plan_id, plan_hash, reviewer)
        plan = self.desk.plan
        if approve:
            self._check_start(plan)
        return Verdict(APPROVED if approve else REJECTED, plan.id, plan.hash, reviewer, reason, plan)

    def carry_out(self, verdict: Verdict) -> str:
        """Apply a verdict that was recorded; an approval starts the plan with the next cycle.

        Returns
        -------
        sentence : str

        Raises
        ------
        ReviewError
            When it cannot be taken any more.
        """
        self.examine(verdict.plan_id, verdict.plan_hash, verdict.approved, verdict.reviewer)
        plan = self.desk.decide(verdict.plan_id, verdict.plan_hash, verdict.reviewer)
        if not verdict.approved:
            return f"plan {plan.id} rejected by {verdict.reviewer}"
        self._playback, self.outcome = Playback(plan, self._robot), ""
        self._enter(ExecutorState.PLAYING, f"approved by {verdict.reviewer}")
        return f"plan {plan.id} approved by {verdict.reviewer}; it takes {plan.trajectory.duration:.3f} s"

    def ready_to_approve(self) -> bool:
        """Return whether a plan is on the desk and neither state nor missing scene stands against approving it."""
        ready = self.state is ExecutorState.IDLE and self._sync is SyncState.IN_SYNC and not self._unarmed
        ready = ready and self.desk.plan is not None and bool(self.desk.scene) and self.desk.scene_alive
        return ready and not self.neighbour.problem(self.desk.plan.id)

    def withdraw(self, plan_id: str, reason: str) -> None:
        """Take a plan off the desk, if it still lies there."""
        if self.desk.plan is not None and self.desk.plan.id == plan_id:
            self.turn_down(self.desk.clear(), reason)

    def turn_down(self, plan: Plan | None, reason: str) -> None:
        """Tell that a plan is not, or no longer, on the desk."""
        if plan is not None:
            self._events.append(Verdict(WITHDRAWN, plan.id, plan.hash, EXECUTOR, reason, plan))

    def take_events(self) -> list[Verdict | Ending]:
        """Return what happened by itself since the last call: plans withdrawn, executions ended."""
        events, self._events = self._events, []
        return events

    # -- while a plan is played

    def stop(self, now: int) -> str:
        """Brake along the path as hard as the acceleration limits allow; return one sentence.

        Plans asked for until `now` [ns] are void, so that nothing that a person stopped is taken up again by itself.
        """
        self.turn_down(self.desk.void(now), "stop requested")
        if self.state not in ACTIVE:
            return f"nothing is playing ({self.state.name})"
        if self.plan_start == 0:
            self._finish("stopped", "stopped before it began")
            return f"plan {self.plan.id} had not begun"
        return self._halt("stop requested")

    def braking(self) -> Braking | None:
        """Return what tells where a stop that was just asked for will end, to be computed outside of any lock; else None."""
        return self._playback.braking(self.lag) if self.state is ExecutorState.STOPPING else None

    def pause(self, now: int) -> str:
        """Brake along the path smoothly and rest on it; return a sentence. Plans asked for until `now` [ns] and not here are void.

        Raises
        ------
        ExecutionError
            When nothing is playing.
        """
        if self.state in (ExecutorState.PAUSING, ExecutorState.PAUSED):
            return f"plan {self.plan.id} is {self.state.name} already"
        if self.state is ExecutorState.HELD:
            self._after_hold = ExecutorState.PAUSED
            return f"plan {self.plan.id} is HELD; when twin and arm agree again it stays at rest, and resume goes on"
        if self.state is not ExecutorState.PLAYING:
            raise ExecutionError(f"nothing to pause: the executor is {self.state.name} ({self.reason})")
        self.desk.void_coming(now)
        self._enter(ExecutorState.PAUSING, "pause requested")
        return f"plan {self.plan.id} comes to rest on its path; resume goes on"

    def resume(self) -> str:
        """Go on along the same path; return one sentence. The approval that started the plan covers it.

        Raises
        ------
        ExecutionError
            When nothing is paused, or twin and arm are not in sync and armed.
        """
        if self.state not in (ExecutorState.PAUSING, ExecutorState.PAUSED):
            raise ExecutionError(f"nothing to resume: the executor is {self.state.name} ({self.reason})")
        if self._sync is not SyncState.IN_SYNC:
            raise ExecutionError(f"twin and physical arm are not in sync ({self._sync.name}); resume when they are")
        if self._unarmed:
            raise ExecutionError(f"the arm is not armed ({self._unarmed}); resume when it is")
        if problem := self.neighbour.problem(self.plan.id):
            raise ExecutionError(f"plan {self.plan.id} may not go on: {problem}")
        self._enter(ExecutorState.PLAYING, "resumed")
        rest = self.plan.trajectory.duration - self._playback.elapsed
        return f"plan {self.plan.id} goes on; {rest:.3f} s of it are left"

    # -- output

    def step(self, stamp: int, now: int) -> tuple[float, ...] | None:
        """Return the setpoint for the cycle with nominal stamp `stamp` [ns], or None when nothing may be sent."""
        self.neighbour.now = now
        if self.state in ACTIVE and self.state is not ExecutorState.STOPPING:
            if problem := self.neighbour.problem(self.plan.id):
                self._halt(problem)
        if self.state is ExecutorState.WAITING:
            self._try_to_begin(now)
        if self.state is ExecutorState.WAITING:
            return None
        if self.state is ExecutorState.IDLE:
            return self._repeat_twin(stamp, now)
        return self._advance(stamp)

    def _try_to_begin(self, now: int) -> None:
        if self._agreed and self._twin_fresh(now):
            self._setpoint, self._setpoint_stamp = self._twin[1], 0
            self._enter(ExecutorState.IDLE, "twin and physical arm agree")

    def _twin_fresh(self, now: int) -> bool:
        return self._twin is not None and now - self._twin[2] <= TWIN_TIMEOUT

    def _repeat_twin(self, stamp: int, now: int) -> tuple[float, ...] | None:
        if not self._twin_fresh(now):
            self._wait("the twin's pose is not known")
            return None
        twin_stamp, pose, _ = self._twin
        # until the twin has executed our last setpoint its pose is on the way there; repeating it would step back
        if twin_stamp >= self._setpoint_stamp:
            self._setpoint = pose
        return self._setpoint

    def _advance(self, stamp: int) -> tuple[float, ...]:
        playback = self._playback
        if self.state is ExecutorState.STOPPING:
            self._setpoint = playback.brake(stamp)
            self._stopping.append(self._setpoint)
        else:
            rate = self.limit.fraction if self.state is ExecutorState.PLAYING else 0.0
            self._setpoint = playback.advance(stamp, rate)
        self._setpoint_stamp = stamp
        if playback.goal_stamp and self.state is not ExecutorState.HELD:
            # a hold may still come that takes back the last setpoints: then the plan must be there to go on
            if self._policy != RESUME or self._passed >= playback.goal_stamp:
                self._finish("finished", "goal reached")
        elif playback.at_rest:
            self._on_rest()
        elif self.limit.standing:
            self.limit.standing = False
            self._say()
        return self._setpoint

    def _on_rest(self) -> None:
        if self.state is ExecutorState.STOPPING:
            way = distance_along(self._stopping)
            self._finish("stopped", f"{self.cause}; at rest after {way.text(self._robot)}")
        elif self.state is ExecutorState.PAUSING:
            self._enter(ExecutorState.PAUSED, self._where_paused())
        elif self.state is ExecutorState.PLAYING and not self.limit.standing and self.limit.fraction == 0.0:
            self.limit.standing = True
            self._say()

    def _where_paused(self) -> str:
        return f"at rest {self._playback.elapsed:.3f} s into the plan; resume goes on"

    # -- plans

    def _check_start(self, plan: Plan) -> None:
        if self.state is not ExecutorState.IDLE:
            raise ReviewError(f"the executor is {self.state.name} ({self.reason}); approve when it is idle")
        if self._sync is not SyncState.IN_SYNC:
            raise ReviewError(f"twin and physical arm are not in sync ({self._sync.name}); approve when they are")
        if self._unarmed:
            raise ReviewError(f"the arm is not armed ({self._unarmed}); approve when it is")
        if problem := self.neighbour.problem(plan.id):
            raise ReviewError(f"plan {plan.id} may not start: {problem}")
        self.desk.check_scene()
        check_start_pose(plan, self._setpoint, self._robot)

    def _halt(self, reason: str) -> str:
        if self.state is ExecutorState.STOPPING:
            # the first cause is the cause, and the way is measured from there
            return f"plan {self.plan.id} is braking already"
        if self.state in RESTING or self.plan_start == 0:
            self._finish("stopped", reason)
            return f"plan {self.plan.id} ended at rest"
        self._stopping = [self._setpoint]
        self._enter(ExecutorState.STOPPING, reason)
        return f"braking plan {self.plan.id}"

    def _hold(self, state: SyncState, held_stamp: int) -> None:
        cause = f"the gate holds ({state.name})"
        if self.state is ExecutorState.STOPPING:
            self._finish("stopped", f"{self.cause}; {cause}")
        elif not self._playback.rest_where(held_stamp):
            self._finish("held", f"{cause} at a setpoint that is not known to be of plan {self.plan.id}")
        else:
            paused = self.state in (ExecutorState.PAUSING, ExecutorState.PAUSED)
            self._after_hold = ExecutorState.PAUSED if paused else ExecutorState.PLAYING
            where = f"{self._playback.elapsed:.3f} s into the plan"
            self._enter(ExecutorState.HELD, f"{cause} {where}; goes on by itself when twin and arm agree again")

    def _go_on(self) -> None:
        if self._after_hold is ExecutorState.PAUSED:
            self._enter(ExecutorState.PAUSED, self._where_paused())
        else:
            self._enter(ExecutorState.PLAYING, "twin and arm agree again; the same approval covers the rest")

    def _finish(self, outcome: str, reason: str) -> None:
        self.outcome = outcome
        self._events.append(Ending(self.plan, outcome, reason))
        self._enter(ExecutorState.IDLE, reason)

    def _wait(self, reason: str) -> None:
        self._twin, self._agreed, self._setpoint = None, False, None
        self._enter(ExecutorState.WAITING, reason)

    def _enter(self, state: ExecutorState, reason: str) -> None:
        self.state, self.cause, self.limit.standing = state, reason, False
        self._say()

    def _say(self) -> None:
        self.reason = self.limit.sentence(self.cause) if self.state is ExecutorState.PLAYING else self.cause

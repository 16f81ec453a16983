"""The executor: one setpoint per cycle, from an approved plan or, idle, the twin's pose.

Pure: `step` is called once per 4 ms with the cycle's nominal stamp [ns]. Angles in rad.
"""

from __future__ import annotations

from enum import Enum

from construction_twin.errors import ReviewError
from construction_twin.gate import SyncState
from construction_twin.limits import outside_tolerance
from construction_twin.review import ReviewDesk, Verdict
from construction_twin.robot import RobotModel
from construction_twin.plan import Plan
from construction_twin.units import CYCLE, NANOSECONDS

#: A plan may start this far from the present pose [rad]; rounding, not motion.
START_TOLERANCE = 1e-6
#: The twin's pose counts as known this long after its last message [ns].
TWIN_TIMEOUT = NANOSECONDS // 2
#: Halvings with which a stop looks for the shortest next step on the path that every joint can brake to.
STOP_HALVINGS = 10


class ExecutorState(Enum):
    """What the executor is doing; values are those of `Execution.msg`."""

    WAITING = 0
    IDLE = 1
    PLAYING = 2
    STOPPING = 3


class Executor:
    """Plays approved plans as theta_next.

    Parameters
    ----------
    robot : RobotModel
    auto_approve : bool
        Approve every plan by itself as soon as it may start.
    """

    def __init__(self, robot: RobotModel, auto_approve: bool = False):
        self._robot = robot
        self._auto_approve = auto_approve
        self.desk = ReviewDesk()
        self.state = ExecutorState.WAITING
        self.reason = "started; waits for twin and physical arm to agree"
        self.outcome = ""
        self.plan: Plan | None = None
        self.plan_start = 0
        self._verdicts: list[Verdict] = []
        self._sync = SyncState.WAITING
        self._agreed = False
        self._unarmed = ""
        self._twin: tuple[int, tuple[float, ...], int] | None = None
        self._setpoint: tuple[float, ...] | None = None
        self._setpoint_stamp = 0
        self._before: tuple[float, ...] = ()
        self._elapsed = 0.0
        self._progress = CYCLE

    # -- inputs

    def on_twin(self, stamp: int, q: tuple[float, ...], now: int) -> None:
        """Take the twin's pose [rad], the stamp of the command it executes, and the time of reception [ns]."""
        self._twin = stamp, q, now

    def on_sync(self, state: SyncState, agreed: bool) -> None:
        """Take the monitor's state; on anything but IN_SYNC the rest of the plan is dropped."""
        self._sync, self._agreed = state, agreed
        if self.state in (ExecutorState.PLAYING, ExecutorState.STOPPING) and state is not SyncState.IN_SYNC:
            self._finish("held", f"the gate holds ({state.name})")

    def on_link(self, armed: bool, reason: str) -> None:
        """Take the link's state; without a physical arm there is none. While the arm is not armed nothing is played."""
        self._unarmed = "" if armed else reason
        if not armed and self.state in (ExecutorState.PLAYING, ExecutorState.STOPPING):
            self._finish("dropped", f"the arm is no longer armed: {reason}")

    def restart(self, reason: str, now: int) -> None:
        """Drop everything, plans asked for until `now` [ns] too, and wait for twin and arm to agree again."""
        self.desk.void(now)
        if self.state in (ExecutorState.PLAYING, ExecutorState.STOPPING):
            self._finish("dropped", reason)
        self._wait(reason)

    def review(self, plan_id: str, plan_hash: str, approve: bool, reviewer: str, reason: str = "") -> str:
        """Apply a verdict to the plan on the desk; an approval starts it with the next cycle.

        Returns
        -------
        sentence : str

        Raises
        ------
        ReviewError
            When it cannot be applied; an approval that came at the wrong moment leaves the plan on the desk.
        """
        self.desk.check(plan_id, plan_hash, reviewer)
        if approve:
            self._check_start(self.desk.plan)
        plan = self.desk.decide(plan_id, plan_hash, reviewer)
        self._verdicts.append(Verdict(plan.id, plan.hash, approve, reviewer, reason))
        if not approve:
            return f"plan {plan_id} rejected by {reviewer}"
        self._play(plan, f"approved by {reviewer}")
        return f"plan {plan_id} approved by {reviewer}; it takes {plan.trajectory.duration:.3f} s"

    def stop(self, now: int) -> str:
        """Brake along the path within the acceleration limits; return one sentence.

        Plans asked for until `now` [ns] are void, so that nothing that a person stopped is taken up again by itself.
        """
        self.desk.void(now)
        if self.state is not ExecutorState.PLAYING:
            return f"nothing is playing ({self.state.name})"
        if self.plan_start == 0:
            self._finish("stopped", "stopped before it began")
            return f"plan {self.plan.id} had not begun"
        self._enter(ExecutorState.STOPPING, "stop requested")
        return f"braking plan {self.plan.id}"

    def take_verdicts(self) -> list[Verdict]:
        """Return the verdicts since the last call, those of `auto_approve` included."""
        verdicts, self._verdicts = self._verdicts, []
        return verdicts

    def stall(self, reason: str) -> None:
        """Drop the plan because setpoints could not be produced in time; the arm is left to the gateway's braking."""
        if self.state in (ExecutorState.PLAYING, ExecutorState.STOPPING):
            self._finish("dropped", reason)

    # -- output

    def step(self, stamp: int, now: int) -> tuple[float, ...] | None:
        """Return the setpoint for the cycle with nominal stamp `stamp` [ns], or None when nothing may be sent."""
        if self.state is ExecutorState.WAITING:
            self._try_to_begin(now)
        if self.state is ExecutorState.IDLE and self._auto_approve and self.desk.plan is not None:
            self._approve_by_itself()
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
        trajectory = self.plan.trajectory
        if self.plan_start == 0:
            self.plan_start = stamp
        elif self.state is ExecutorState.PLAYING:
            self._elapsed = (stamp - self.plan_start) / NANOSECONDS
        else:
            self._slow_down()
        q, _, _ = trajectory.sample(self._elapsed)
        self._before = self._setpoint
        self._setpoint, self._setpoint_stamp = tuple(q.tolist()), stamp
        if self._elapsed >= trajectory.duration:
            self._finish("finished", "goal reached")
        elif self.state is ExecutorState.STOPPING and self._progress == 0.0:
            self._finish("stopped", "stopped on request")
        return self._setpoint

    def _slow_down(self) -> None:
        """Advance on the path as little as every joint's acceleration limit allows: the arm brakes on its path."""
        self._progress = self._least_progress()
        self._elapsed = min(self._elapsed + self._progress, self.plan.trajectory.duration)

    def _least_progress(self) -> float:
        if self._can_brake_to(0.0):
            return 0.0
        least, most = 0.0, self._progress
        for _ in range(STOP_HALVINGS):
            middle = (least + most) / 2
            least, most = (least, middle) if self._can_brake_to(middle) else (middle, most)
        return most

    def _can_brake_to(self, progress: float) -> bool:
        """Tell whether every joint may go there in one cycle: the same second difference that gate and gateway measure."""
        q, _, _ = self.plan.trajectory.sample(self._elapsed + progress)
        return all(
            abs(value - 2 * last + before) <= limit * CYCLE * CYCLE
            for value, last, before, limit in zip(q.tolist(), self._setpoint, self._before, self._robot.acceleration)
        )

    # -- plans

    def _check_start(self, plan: Plan) -> None:
        if self.state is not ExecutorState.IDLE:
            raise ReviewError(f"the executor is {self.state.name} ({self.reason}); approve when it is idle")
        if self._sync is not SyncState.IN_SYNC:
            raise ReviewError(f"twin and physical arm are not in sync ({self._sync.name}); approve when they are")
        if self._unarmed:
            raise ReviewError(f"the arm is not armed ({self._unarmed}); approve when it is")
        off = outside_tolerance(tuple(plan.trajectory.positions[0]), self._setpoint, START_TOLERANCE)
        if off is not None:
            distance = plan.trajectory.positions[0][off] - self._setpoint[off]
            joint = self._robot.joint_names[off]
            raise ReviewError(f"plan {plan.id} starts {distance:.6f} rad from the present pose at {joint}; plan again")

    def _approve_by_itself(self) -> None:
        if self._sync is not SyncState.IN_SYNC or self._unarmed:
            return
        plan = self.desk.plan
        try:
            self.review(plan.id, plan.hash, True, "auto_approve", "the launch argument auto_approve is on")
        except ReviewError as error:
            self.desk.clear()
            self._verdicts.append(Verdict(plan.id, plan.hash, False, "auto_approve", str(error)))

    def _play(self, plan: Plan, reason: str) -> None:
        self.plan, self.plan_start, self._elapsed, self._progress = plan, 0, 0.0, CYCLE
        self.outcome = ""
        self._enter(ExecutorState.PLAYING, reason)

    def _finish(self, outcome: str, reason: str) -> None:
        self.outcome = outcome
        self._enter(ExecutorState.IDLE, reason)

    def _wait(self, reason: str) -> None:
        self._twin, self._agreed, self._setpoint = None, False, None
        self._enter(ExecutorState.WAITING, reason)

    def _enter(self, state: ExecutorState, reason: str) -> None:
        self.state, self.reason = state, reason

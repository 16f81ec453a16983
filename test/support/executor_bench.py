"""An executor in its loop, and motions for it to play; for the tests of executor, approval and progress."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import plan_samples

from construction_twin.core.units import CYCLE, CYCLE_NS
from construction_twin.execution.approval import Approval
from construction_twin.execution.executor import Executor, ExecutorState
from construction_twin.monitor.gate import SyncState
from construction_twin.robot.description import read_robot_files
from construction_twin.robot.plan import Plan
from construction_twin.robot.trajectory import Trajectory

ROOT = Path(__file__).parents[2]
ROBOT = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
ACCELERATION = np.array(ROBOT.acceleration)
JERK = np.array(ROBOT.jerk)
GOAL = tuple(q + d for q, d in zip(ROBOT.home, (0.5, 0.2, -0.3, 0.4, -0.2, 0.6)))
SCENE = "5ce0e"


def reach(start=ROBOT.home, goal=GOAL, duration: float = 2.0, waypoints: int = 2) -> Trajectory:
    """A minimum-jerk motion from rest to rest; `duration` need not be a multiple of the cycle."""
    s = np.linspace(0.0, 1.0, waypoints)[:, None]
    start, way = np.array(start), np.array(goal) - np.array(start)
    return Trajectory(
        ROBOT.joint_names,
        s[:, 0] * duration,
        np.vstack([start + way * (10 * s**3 - 15 * s**4 + 6 * s**5)[:-1], start + way]),
        way * (30 * s**2 - 60 * s**3 + 30 * s**4) / duration,
        way * (60 * s - 180 * s**2 + 120 * s**3) / duration**2,
    )


def make_plan(name: str = "p", motion: Trajectory | None = None, scene: str = SCENE, created_ns: int = 0) -> Plan:
    """Return a plan of a motion, of `reach` by default."""
    return plan_samples.make_plan(motion or reach(), name, scene, created_ns)


class Bench:
    """An executor in its loop, the twin one cycle behind; `passing` is what the gate does with its setpoints."""

    def __init__(self):
        self.executor = Executor(ROBOT)
        self.executor.on_scene(SCENE)
        self.records = []
        self.record = self.records.append
        self.approval = Approval(self.executor, lambda record: self.record(record), nullcontext())
        self.stamp = 1000 * CYCLE_NS
        self.twin = ROBOT.home
        self.passing = True
        self.outputs = []

    @property
    def state(self) -> ExecutorState:
        """The executor's state."""
        return self.executor.state

    def step(self):
        """One cycle; return the setpoint."""
        self.stamp += CYCLE_NS
        setpoint = self.executor.step(self.stamp, self.stamp)
        self.outputs.append(setpoint)
        if self.passing and setpoint is not None:
            self.twin = setpoint
        self.executor.on_twin(self.stamp, self.twin, self.stamp)
        return setpoint

    def run(self, cycles: int) -> list:
        """Run some cycles; return the setpoints."""
        return [self.step() for _ in range(cycles)]

    def run_until(self, *states: ExecutorState) -> list:
        """Run until the executor is in one of these states; return the setpoints."""
        outputs = []
        while self.state not in states:
            outputs.append(self.step())
            assert len(outputs) < 10_000, self.executor.reason
        return outputs

    def run_until_idle(self) -> list:
        """Run until the executor is idle; return the setpoints."""
        return self.run_until(ExecutorState.IDLE)

    def ready(self) -> Bench:
        """Let twin and arm agree."""
        self.executor.on_sync(SyncState.IN_SYNC, True)
        self.run(3)
        assert self.state is ExecutorState.IDLE
        return self

    def review(self, plan_id: str, plan_hash: str, approve: bool, reviewer: str, reason: str = "") -> str:
        """Give a verdict; return the sentence."""
        return self.approval.review(plan_id, plan_hash, approve, reviewer, reason).sentence

    def approve(self, plan: Plan) -> str:
        """Put a plan under review and approve it."""
        self.executor.offer(plan)
        return self.review(plan.id, plan.hash, True, "Ada")

    def play(self, plan: Plan, cycles: int) -> Plan:
        """Approve a plan and run some cycles of it."""
        self.approve(plan)
        self.run(cycles)
        return plan


def within_acceleration(outputs) -> bool:
    """Tell whether every second difference of the setpoints is inside the acceleration limits."""
    change = np.abs(np.diff([q for q in outputs if q is not None], 2, axis=0)) / CYCLE**2
    return bool((change <= ACCELERATION * (1 + 1e-6)).all())


def limited_motion(rng: np.random.Generator, waypoints: int, span: float) -> Trajectory:
    """A random smooth motion whose largest acceleration is exactly a joint's limit."""
    lower, upper = np.array(ROBOT.lower), np.array(ROBOT.upper)
    positions = np.array(ROBOT.home) + span * rng.uniform(-0.4, 0.4, (waypoints, 6)) * (upper - lower)
    positions[0] = ROBOT.home
    velocities, accelerations = (rng.normal(0.0, scale * span, (waypoints, 6)) for scale in (0.5, 1.0))
    velocities[[0, -1]] = accelerations[[0, -1]] = 0.0
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.3, 1.0, waypoints - 1))])
    trial = Trajectory(ROBOT.joint_names, times, positions, velocities, accelerations)
    use = (np.abs(trial.sample_many(np.linspace(0.0, trial.duration, 4000))[2]) / ACCELERATION).max() * 1.001
    slower = np.sqrt(use)
    return Trajectory(ROBOT.joint_names, times * slower, positions, velocities / slower, accelerations / use)

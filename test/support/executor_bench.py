"""An executor in its loop, and motions for it to play; for the tests of executor, approval and progress."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import plan_samples

from construction_twin.core.freshness import Moment
from construction_twin.core.reports import SwitchReport, SwitchState, ToolReport
from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS
from construction_twin.execution.approval import Approval
from construction_twin.execution.engagement import Engagement
from construction_twin.execution.executor import Executor, ExecutorState
from construction_twin.execution.segment_run import ToolOrder
from construction_twin.monitor.states import SyncState
from construction_twin.robot.description import read_robot_files
from construction_twin.robot.executed_path import ExecutedPath
from construction_twin.robot.plan import Plan, content_hash
from construction_twin.robot.segments import Segment, Signal, Switch
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


def make_plan(name: str = "p", motion: Trajectory | None = None, scene: str = SCENE, asked_ns: int = 0) -> Plan:
    """Return a plan of a motion, of `reach` by default."""
    return plan_samples.make_plan(motion or reach(), name, scene, asked_ns)


GRIPPED = (Signal("gripped", True),)
FREE = (Signal("gripped", False),)
LATER = ("5ce1e", "5ce2e", "5ce3e", "5ce4e")


def joined(*motions: Trajectory) -> Trajectory:
    """Return motions that follow each other at rest as one."""
    begins = np.cumsum([0.0] + [motion.duration for motion in motions])
    rows = [slice(0 if number == 0 else 1, None) for number in range(len(motions))]
    return Trajectory(
        ROBOT.joint_names,
        np.concatenate([begin + motion.times[r] for begin, motion, r in zip(begins, motions, rows)]),
        *(
            np.vstack([getattr(motion, name)[r] for motion, r in zip(motions, rows)])
            for name in ("positions", "velocities", "accelerations")
        ),
    )


def between(*shares: float, duration: float = 0.8) -> Trajectory:
    """Return a motion through places on the way from home to `GOAL`, 0 to 1, at rest at each."""
    home, way = np.array(ROBOT.home), np.array(GOAL) - np.array(ROBOT.home)
    poses = [tuple(home + share * way) for share in shares]
    return joined(*(reach(a, b, duration, 9) for a, b in zip(poses, poses[1:])))


def make_work_plan(
    name: str = "w", motion: Trajectory | None = None, asked_ns: int = 0, **changes: dict[int, dict]
) -> Plan:
    """Return a plan of four segments: to the stock, approach and grip (engaged), lift (engaged), carry and let go.

    Args:
        changes: ``segment_<number>``: fields of that segment that are to be different.
    """
    motion = motion or between(0.0, 0.3, 0.4, 0.3, 0.6)
    ends = [float(motion.times[8 * number]) for number in range(1, 5)]
    grip, drop = Switch("vacuum", True, GRIPPED, 1.0), Switch("vacuum", False, FREE, 1.0)
    segments = [
        Segment("to stock", ends[0], False, (), (), SCENE, SCENE),
        Segment("approach", ends[1], True, FREE, (grip,), SCENE, LATER[0]),
        Segment("lift", ends[2], True, GRIPPED, (), LATER[0], LATER[0]),
        Segment("carry", ends[3], False, GRIPPED, (drop,), LATER[0], LATER[1]),
    ]
    for number, segment in enumerate(segments):
        segments[number] = replace(segment, **changes.get(f"segment_{number}", {}))
    return plan_of(motion, tuple(segments), name, asked_ns)


def plan_of(motion: Trajectory, segments: tuple[Segment, ...], name: str, asked_ns: int = 0) -> Plan:
    """Return a work plan of a motion and its segments."""
    plain = plan_samples.make_plan(motion, name, segments[0].scene, asked_ns)
    return replace(plain, hash=content_hash(motion, "t1", segments), task="t1", segments=segments)


class Gripper:
    """Gateway and gripper as an executor sees them: arms, fires in the cycle in which the playout passes the stamp, reads back.

    `closing` are the cycles from the switch to the input, `jams` an output that does not fire; without `answers` it acts all alike.
    """

    def __init__(self):
        self.outputs = {"vacuum": False}
        self.jams = ""
        self.playout, self.closing, self.answers = 5 * CYCLE_NS, 10, True
        self.inputs = {"gripped": False}
        self.known, self.refuses, self.works = True, "", True
        self.fired: list[tuple[str, bool]] = []
        self.orders: list[ToolOrder] = []
        self._armed: dict[str, ToolOrder] = {}
        self._switches: dict[str, SwitchReport] = {}
        self._coming: list[tuple[int, bool]] = []

    def take(self, order: ToolOrder) -> None:
        self.orders.append(order)
        if not order.id:
            self.void("asked for")
        elif self.refuses:
            self._switches[order.id] = SwitchReport(SwitchState.REFUSED, self.refuses)
        else:
            assert order.id not in self._switches, "an id is used once"
            self._armed[order.id] = order
            self._switches[order.id] = SwitchReport(SwitchState.ARMED, "")

    def void(self, why: str) -> None:
        """Forget what is armed, as the gateway does on its own when it brakes."""
        for name in self._armed:
            self._switches[name] = SwitchReport(SwitchState.VOID, why)
        self._armed.clear()

    def cycle(self, stamp: int) -> None:
        """One cycle, with the newest setpoint's stamp."""
        for name, order in list(self._armed.items()):
            if stamp - self.playout >= order.stamp and order.switch.output != self.jams:
                del self._armed[name]
                self._switches[name] = SwitchReport(SwitchState.FIRED, "")
                self.fired.append((order.switch.output, order.switch.value))
                if order.switch.output == "vacuum":
                    self._coming.append((stamp + self.closing * CYCLE_NS, order.switch.value))
        while self._coming and stamp >= self._coming[0][0]:
            value = self._coming.pop(0)[1]
            if self.works:
                self.inputs = {"gripped": value}

    def report(self) -> ToolReport:
        return ToolReport(
            self.known, "frame", self.outputs, dict(self.inputs), dict(self._switches), "no session" * (not self.known)
        )


class Bench:
    """An executor in its loop, the twin one cycle behind; `passing` is what the gate does with its setpoints.

    `tool` is what a work plan switches; with `edits` somebody changes the scene as it asks, and with `writes` the disk takes what
    it has to.
    """

    def __init__(self, left: Engagement | None = None):
        self.tool: Gripper | None = None
        self.edits = self.writes = True
        self._told: ToolReport | None = None
        self.executor = Executor(ROBOT, left)
        #: What tells the age of verdicts [ns]; it stands still unless a test moves it.
        self.clock = NANOSECONDS
        self.executor.on_scene(SCENE)
        self.records = []
        self.record = self.records.append
        self.approval = Approval(
            self.executor, lambda record: self.record(record), nullcontext(), lambda: self.present()
        )
        self.stamp = 1000 * CYCLE_NS
        self.twin = ROBOT.home
        self.passing = True
        self.outputs = []

    @property
    def state(self) -> ExecutorState:
        return self.executor.state

    def present(self) -> Moment:
        """Return the present moment, by which the age of verdicts is told."""
        return Moment("c0ffee00", self.clock)

    def step(self):
        self.stamp += CYCLE_NS
        setpoint = self.executor.step(self.stamp, self.stamp)
        self.outputs.append(setpoint)
        if self.passing and setpoint is not None:
            self.twin = setpoint
        self.executor.on_twin(self.stamp, self.twin, self.stamp)
        self._serve()
        return setpoint

    def _serve(self) -> None:
        """What others do for a work plan, between two cycles."""
        executor, work = self.executor, self.executor.segment_run
        orders = executor.pop_orders()
        if self.tool is not None:
            for order in orders:
                self.tool.take(order)
            self.tool.cycle(self.stamp)
            self.tell()
        if self.writes:
            executor.engagement.written = executor.engagement.present
        if self.edits and work is not None and work.wants_scene and self.state is ExecutorState.AT_BOUNDARY:
            executor.on_scene(work.expected_scene)

    def tell(self) -> None:
        """Let the executor hear of the tool, when there is something new to say."""
        report = self.tool.report() if self.tool.answers else self._told
        if report is not None and report != self._told:
            self._told = report
            self.executor.on_tool(report, self.stamp)

    def with_tool(self) -> Bench:
        self.tool = Gripper()
        self.tell()
        return self

    def run_into(self, segment: int, cycles: int = 30) -> list:
        """Run until it moves in a segment of a work plan, and some cycles of it; return the setpoints."""
        outputs = []
        while self.executor.segment_run is None or (self.executor.segment_run.number, self.state) != (
            segment,
            ExecutorState.PLAYING,
        ):
            outputs.append(self.step())
            assert len(outputs) < 10_000 and self.state is not ExecutorState.IDLE, self.executor.reason
        return outputs + self.run(cycles)

    def run_to_end_of(self, segment: int) -> list:
        """Run until it stands at the end of a segment; return the setpoints."""
        outputs = []
        while self.executor.segment_run is None or (self.executor.segment_run.number, self.state) != (
            segment,
            ExecutorState.AT_BOUNDARY,
        ):
            outputs.append(self.step())
            assert len(outputs) < 10_000 and self.state is not ExecutorState.IDLE, self.executor.reason
        return outputs

    def run(self, cycles: int) -> list:
        return [self.step() for _ in range(cycles)]

    def run_until(self, *states: ExecutorState) -> list:
        """Run until the executor is in one of these states; return the setpoints."""
        outputs = []
        while self.state not in states:
            outputs.append(self.step())
            assert len(outputs) < 10_000, self.executor.reason
        return outputs

    def run_until_idle(self) -> list:
        return self.run_until(ExecutorState.IDLE)

    def ready(self) -> Bench:
        """Let twin and arm agree."""
        self.executor.on_sync(SyncState.IN_SYNC, True)
        self.run(3)
        assert self.state is ExecutorState.IDLE
        return self

    def review(
        self, plan_id: str, plan_hash: str, approve: bool, reviewer: str, reason: str = "", seen: Moment | None = None
    ) -> str:
        return self.approval.review(plan_id, plan_hash, approve, reviewer, reason, seen).answer

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


def motion_back(path: ExecutedPath, begin: float, until: float = 0.0, pace: float = 3.0) -> Trajectory:
    """Return the motion from rest at a time along an executed path back to an earlier one, `pace` times as slow."""
    duration = max(pace * (begin - until), 0.2)
    times = np.linspace(0.0, duration, max(2, round(duration / 0.01) + 1))
    x = times / duration
    s = begin - (begin - until) * (10 * x**3 - 15 * x**4 + 6 * x**5)
    sd = -(begin - until) * (30 * x**2 - 60 * x**3 + 30 * x**4) / duration
    sdd = -(begin - until) * (60 * x - 180 * x**2 + 120 * x**3) / duration**2
    q, qd, qdd, _ = path.trajectory.sample_many(s)
    velocities, accelerations = qd * sd[:, None], qdd * sd[:, None] ** 2 + qd * sdd[:, None]
    velocities[[0, -1]] = accelerations[[0, -1]] = 0.0
    return Trajectory(ROBOT.joint_names, times, q, velocities, accelerations)


def plan_back(
    motion: Trajectory, requires=(), scene: str = SCENE, name: str = "back", asked_ns: int = 0, **changes
) -> Plan:
    """Return the plan of a way back, as the planner makes it; `changes` are fields of its segment."""
    segment = Segment("way back", motion.duration, True, requires, (), scene, scene)
    return plan_of(motion, (replace(segment, **changes),), name, asked_ns)

"""The executor: nothing without approval, exactly what was approved, and stops inside the limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.errors import ReviewError
from construction_twin.executor import START_TOLERANCE, TWIN_TIMEOUT, Executor, ExecutorState
from construction_twin.gate import SyncState
from construction_twin.robot import read_robot_files
from construction_twin.planning.timing import time_path
from construction_twin.plan import Plan
from construction_twin.trajectory import Trajectory
from construction_twin.units import CYCLE, CYCLE_NS

ROOT = Path(__file__).parents[2]
ROBOT = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
ACCELERATION = np.array(ROBOT.acceleration)
GOAL = tuple(q + d for q, d in zip(ROBOT.home, (0.5, 0.2, -0.3, 0.4, -0.2, 0.6)))


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


def make_plan(name: str = "p", motion: Trajectory | None = None) -> Plan:
    motion = motion or reach()
    return Plan(name, motion.content_hash(), "test", "none", 0, 0.0, motion)


class Bench:
    """An executor in its loop, the twin one cycle behind; `passing` is what the gate does with its setpoints."""

    def __init__(self, auto_approve: bool = False):
        self.executor = Executor(ROBOT, auto_approve)
        self.stamp = 1000 * CYCLE_NS
        self.twin = ROBOT.home
        self.passing = True
        self.outputs = []

    @property
    def state(self) -> ExecutorState:
        return self.executor.state

    def step(self):
        self.stamp += CYCLE_NS
        setpoint = self.executor.step(self.stamp, self.stamp)
        self.outputs.append(setpoint)
        if self.passing and setpoint is not None:
            self.twin = setpoint
        self.executor.on_twin(self.stamp, self.twin, self.stamp)
        return setpoint

    def run(self, cycles: int) -> list:
        return [self.step() for _ in range(cycles)]

    def run_until_idle(self) -> list:
        outputs = []
        while self.state is not ExecutorState.IDLE:
            outputs.append(self.step())
        return outputs

    def ready(self) -> Bench:
        self.executor.on_sync(SyncState.IN_SYNC, True)
        self.run(3)
        assert self.state is ExecutorState.IDLE
        return self

    def approve(self, plan: Plan) -> str:
        self.executor.desk.offer(plan)
        return self.executor.review(plan.id, plan.hash, True, "Ada")


@pytest.fixture
def bench() -> Bench:
    return Bench().ready()


class TestIdle:
    def test_sends_nothing_before_twin_and_arm_agree(self):
        bench = Bench()
        bench.executor.on_sync(SyncState.WAITING, False)
        assert set(bench.run(10)) == {None} and bench.state is ExecutorState.WAITING

    def test_sends_nothing_without_a_twin(self):
        executor = Executor(ROBOT)
        executor.on_sync(SyncState.WAITING, True)
        assert executor.step(CYCLE_NS, CYCLE_NS) is None

    def test_repeats_the_twin_s_pose_as_soon_as_they_agree(self):
        bench = Bench()
        bench.step()
        bench.executor.on_sync(SyncState.WAITING, True)
        assert bench.run(50) == [ROBOT.home] * 50 and bench.state is ExecutorState.IDLE

    def test_follows_a_twin_that_is_elsewhere(self, bench):
        bench.twin, bench.passing = GOAL, False
        bench.run(2)
        assert bench.step() == GOAL

    def test_waits_when_the_twin_falls_silent(self, bench):
        last = bench.stamp
        assert bench.executor.step(last + TWIN_TIMEOUT, last + TWIN_TIMEOUT) is not None
        assert bench.executor.step(last + TWIN_TIMEOUT + CYCLE_NS, last + TWIN_TIMEOUT + 1) is None
        assert bench.state is ExecutorState.WAITING

    def test_after_a_wait_they_must_agree_anew(self, bench):
        bench.executor.restart("new command session", bench.stamp)
        assert set(bench.run(10)) == {None}
        bench.executor.on_sync(SyncState.WAITING, True)
        assert bench.step() == ROBOT.home


class TestApproval:
    def test_nothing_moves_without_it(self, bench):
        bench.executor.desk.offer(make_plan())
        assert set(bench.run(1000)) == {ROBOT.home} and bench.executor.plan is None

    def test_starts_the_plan_with_the_next_cycle_and_records_who_approved(self, bench):
        plan = make_plan()
        assert "2.000 s" in bench.approve(plan)
        assert bench.state is ExecutorState.PLAYING
        bench.step()
        assert bench.executor.plan_start == bench.stamp
        (verdict,) = bench.executor.take_verdicts()
        assert (verdict.plan_id, verdict.plan_hash, verdict.approved, verdict.reviewer) == ("p", plan.hash, True, "Ada")
        assert bench.executor.take_verdicts() == []

    def test_covers_one_execution(self, bench):
        plan = make_plan(motion=reach(goal=ROBOT.home))
        bench.approve(plan)
        bench.run_until_idle()
        with pytest.raises(ReviewError, match="decided already"):
            bench.approve(plan)
        assert bench.state is ExecutorState.IDLE

    def test_a_rejected_plan_is_not_played_and_cannot_be_approved(self, bench):
        plan = make_plan()
        bench.executor.desk.offer(plan)
        bench.executor.review("p", plan.hash, False, "Ada", "too close to the wall")
        assert bench.executor.take_verdicts()[0].reason == "too close to the wall"
        with pytest.raises(ReviewError, match="decided already"):
            bench.approve(plan)
        assert set(bench.run(10)) == {ROBOT.home}

    @pytest.mark.parametrize("joint", range(6))
    @pytest.mark.parametrize("share, accepted", [(0.99, True), (1.01, False), (-1.01, False)])
    def test_only_from_the_pose_it_was_planned_from(self, bench, joint, share, accepted):
        start = tuple(q + share * START_TOLERANCE * (i == joint) for i, q in enumerate(ROBOT.home))
        plan = make_plan(motion=reach(start=start))
        if accepted:
            bench.approve(plan)
            assert bench.state is ExecutorState.PLAYING
            return
        with pytest.raises(ReviewError, match=ROBOT.joint_names[joint]):
            bench.approve(plan)
        assert bench.state is ExecutorState.IDLE and bench.executor.desk.plan is plan

    def test_only_with_the_hash_that_was_looked_at(self, bench):
        bench.executor.desk.offer(make_plan())
        with pytest.raises(ReviewError, match="hash"):
            bench.executor.review("p", "0" * 64, True, "Ada")
        assert bench.state is ExecutorState.IDLE

    @pytest.mark.parametrize("sync", [state for state in SyncState if state is not SyncState.IN_SYNC])
    def test_only_in_sync(self, bench, sync):
        bench.executor.on_sync(sync, True)
        with pytest.raises(ReviewError, match=sync.name):
            bench.approve(make_plan())
        bench.executor.on_sync(SyncState.IN_SYNC, True)
        bench.executor.review("p", "", True, "Ada")
        assert bench.state is ExecutorState.PLAYING

    def test_only_while_the_arm_is_armed(self, bench):
        bench.executor.on_link(False, "gateway is holding")
        with pytest.raises(ReviewError, match="gateway is holding"):
            bench.approve(make_plan())
        bench.executor.on_link(True, "session 2")
        bench.executor.review("p", "", True, "Ada")
        assert bench.state is ExecutorState.PLAYING

    def test_not_while_another_plan_is_played(self, bench):
        bench.approve(make_plan())
        bench.run(10)
        with pytest.raises(ReviewError, match="PLAYING"):
            bench.approve(make_plan("q", reach(start=bench.twin)))
        assert bench.executor.plan.id == "p"

    def test_not_before_twin_and_arm_agree(self):
        with pytest.raises(ReviewError, match="WAITING"):
            Bench().approve(make_plan())


class TestAutoApprove:
    def test_plays_by_itself_and_leaves_a_verdict(self):
        bench = Bench(auto_approve=True).ready()
        bench.executor.desk.offer(make_plan())
        bench.step()
        assert bench.state is ExecutorState.PLAYING
        assert [(v.approved, v.reviewer) for v in bench.executor.take_verdicts()] == [(True, "auto_approve")]

    def test_waits_until_in_sync(self):
        bench = Bench(auto_approve=True).ready()
        bench.executor.on_sync(SyncState.HOLDING, False)
        bench.executor.desk.offer(make_plan())
        assert set(bench.run(100)) == {ROBOT.home}
        bench.executor.on_sync(SyncState.IN_SYNC, True)
        bench.step()
        assert bench.state is ExecutorState.PLAYING

    def test_drops_a_plan_from_another_pose_and_says_why_once(self):
        bench = Bench(auto_approve=True).ready()
        bench.executor.desk.offer(make_plan(motion=reach(start=GOAL, goal=ROBOT.home)))
        assert set(bench.run(100)) == {ROBOT.home}
        (verdict,) = bench.executor.take_verdicts()
        assert not verdict.approved and "from the present pose" in verdict.reason


class TestPlaying:
    @pytest.mark.parametrize("duration", [2.0, 2.001, 1.9999, 2.003999999])
    @pytest.mark.parametrize("waypoints", [2, 37])
    def test_setpoints_are_the_trajectory_on_the_grid_and_the_last_is_the_goal(self, bench, duration, waypoints):
        plan = make_plan(motion=reach(duration=duration, waypoints=waypoints))
        bench.approve(plan)
        outputs = bench.run_until_idle()
        expected = [tuple(plan.trajectory.sample(k * CYCLE_NS / 1e9)[0].tolist()) for k in range(len(outputs))]
        assert outputs == expected
        assert outputs[-1] == tuple(plan.trajectory.positions[-1]) == GOAL != outputs[-2]
        assert len(outputs) == -(-round(duration * 1e9) // CYCLE_NS) + 1
        assert (bench.executor.outcome, bench.executor.plan_start) == (
            "finished",
            bench.stamp - (len(outputs) - 1) * CYCLE_NS,
        )

    @pytest.mark.parametrize("duration", [1.0, 1.0013, 1.0039])
    def test_begins_and_ends_inside_the_limits(self, bench, duration):
        bench.approve(make_plan(motion=reach(goal=tuple(q + 0.1 for q in ROBOT.home), duration=duration)))
        bench.run_until_idle()
        bench.run(3)
        assert within_acceleration(bench.outputs)

    def test_never_steps_back_after_the_end(self, bench):
        """The twin still reports poses before the goal for a while."""
        motion = reach()
        bench.approve(make_plan(motion=motion))
        bench.run_until_idle()
        for late in range(20, 0, -1):
            q = tuple(motion.sample(motion.duration - late * CYCLE)[0].tolist())
            bench.executor.on_twin(bench.stamp - late * CYCLE_NS, q, bench.stamp)
            assert bench.executor.step(bench.stamp + (21 - late) * CYCLE_NS, bench.stamp) == GOAL

    def test_ends_at_the_pose_the_twin_rounded_the_goal_to(self, bench):
        bench.approve(make_plan())
        bench.run_until_idle()
        rounded = tuple(q + 1e-6 for q in GOAL)
        bench.executor.on_twin(bench.stamp, rounded, bench.stamp)
        assert bench.executor.step(bench.stamp + CYCLE_NS, bench.stamp + CYCLE_NS) == rounded

    def test_plans_can_follow_one_another(self, bench):
        bench.approve(make_plan())
        bench.run_until_idle()
        bench.step()
        bench.approve(make_plan("q", reach(start=bench.twin, goal=ROBOT.home)))
        assert bench.run_until_idle()[-1] == ROBOT.home

    @pytest.mark.parametrize("sync", [SyncState.HOLDING, SyncState.STALE, SyncState.REFUSING, SyncState.WAITING])
    def test_a_hold_drops_the_rest_and_returns_to_the_twin(self, bench, sync):
        bench.approve(make_plan())
        bench.run(200)
        held, bench.passing = bench.twin, False
        ahead = bench.run(5)
        bench.executor.on_sync(sync, False)
        assert (bench.state, bench.executor.outcome) == (ExecutorState.IDLE, "held")
        assert bench.step() in (ahead[-1], held)
        assert set(bench.run(500)) == {held}

    def test_a_hold_while_braking_drops_the_rest_too(self, bench):
        bench.approve(make_plan())
        bench.run(200)
        bench.executor.stop(bench.stamp)
        bench.run(2)
        bench.executor.on_sync(SyncState.HOLDING, False)
        assert (bench.state, bench.executor.outcome) == (ExecutorState.IDLE, "held")

    def test_a_restart_drops_the_plan_and_the_desk(self, bench):
        bench.approve(make_plan())
        bench.run(100)
        waiting = make_plan("q", reach(start=bench.twin))
        bench.executor.desk.offer(waiting)
        bench.executor.restart("new command session", 0)
        assert (bench.state, bench.executor.outcome) == (ExecutorState.WAITING, "dropped")
        bench.executor.on_sync(SyncState.IN_SYNC, True)
        bench.run(5)
        with pytest.raises(ReviewError, match="decided already"):
            bench.approve(waiting)
        assert len(set(bench.run(100))) == 1

    def test_a_plan_asked_for_before_a_restart_is_void_when_it_arrives(self, bench):
        bench.executor.restart("new command session", bench.stamp)
        with pytest.raises(ReviewError, match="last stop or reset"):
            bench.executor.desk.offer(replace(make_plan(), created_ns=bench.stamp - 1))
        bench.executor.desk.offer(replace(make_plan(), created_ns=bench.stamp))

    @pytest.mark.parametrize("stopping", [False, True])
    def test_an_arm_that_is_no_longer_armed_drops_the_plan(self, bench, stopping):
        bench.approve(make_plan())
        bench.run(200)
        if stopping:
            bench.executor.stop(bench.stamp)
        bench.executor.on_link(False, "gateway is holding")
        assert (bench.state, bench.executor.outcome) == (ExecutorState.IDLE, "dropped")
        assert len(set(bench.run(50))) == 1

    def test_a_stall_drops_the_plan(self, bench):
        bench.executor.stall("not run for 0.1 s")
        assert bench.executor.outcome == ""
        bench.approve(make_plan())
        bench.run(100)
        bench.executor.stall("not run for 0.1 s")
        assert (bench.state, bench.executor.outcome) == (ExecutorState.IDLE, "dropped")
        assert len(set(bench.run(50))) == 1


def within_acceleration(outputs) -> bool:
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


def stop_after(motion: Trajectory, cycles: int) -> tuple[Bench, list]:
    bench = Bench().ready()
    bench.approve(make_plan(motion=motion))
    bench.run(cycles)
    bench.executor.stop(bench.stamp)
    braking = bench.run_until_idle() if bench.state is not ExecutorState.IDLE else []
    bench.run(3)
    return bench, braking


class TestStop:
    def test_brakes_along_the_path_and_rests_there(self, bench):
        motion = reach()
        bench, braking = stop_after(motion, 250)
        assert bench.executor.outcome == "stopped" and set(bench.outputs[-3:]) == {braking[-1]}
        assert 1 < len(braking) < 250 and within_acceleration(bench.outputs)
        start, way = np.array(ROBOT.home), np.array(GOAL) - np.array(ROBOT.home)
        share = (np.array(braking) - start) / way
        assert np.ptp(share, axis=1).max() < 1e-12
        assert (np.diff(share[:, 0]) >= 0.0).all() and share[-1, 0] < 0.8

    def test_brakes_about_as_short_as_the_limits_allow(self):
        motion = reach()
        _, braking = stop_after(motion, 250)
        _, velocity, _ = motion.sample(249 * CYCLE)
        assert len(braking) * CYCLE <= 1.1 * (np.abs(velocity) / ACCELERATION).max() + 3 * CYCLE

    def test_before_the_first_setpoint_nothing_moves(self, bench):
        bench.approve(make_plan())
        bench.executor.stop(bench.stamp)
        assert (bench.state, bench.executor.outcome) == (ExecutorState.IDLE, "stopped")
        assert set(bench.run(100)) == {ROBOT.home}

    def test_takes_the_waiting_plan_off_the_desk(self, bench):
        plan = make_plan()
        bench.executor.desk.offer(plan)
        assert "nothing is playing" in bench.executor.stop(bench.stamp)
        with pytest.raises(ReviewError, match="decided already"):
            bench.executor.review(plan.id, plan.hash, True, "Ada")

    def test_a_plan_asked_for_before_the_stop_is_void_when_it_arrives(self, bench):
        bench.executor.stop(bench.stamp)
        with pytest.raises(ReviewError, match="before the last stop"):
            bench.executor.desk.offer(make_plan())

    def test_a_stopped_plan_does_not_go_on(self, bench):
        plan = make_plan()
        bench.approve(plan)
        bench.run(250)
        bench.executor.stop(bench.stamp)
        bench.run_until_idle()
        assert len(set(bench.run(500))) == 1
        with pytest.raises(ReviewError, match="decided already"):
            bench.executor.review("p", plan.hash, True, "Ada")

    def test_a_second_stop_changes_nothing(self, bench):
        bench.approve(make_plan())
        bench.run(250)
        bench.executor.stop(bench.stamp)
        bench.run(3)
        bench.executor.stop(bench.stamp)
        bench.run_until_idle()
        bench.run(2)
        assert bench.executor.outcome == "stopped" and within_acceleration(bench.outputs)

    @settings(max_examples=40, deadline=None)
    @given(st.integers(0, 2**32), st.integers(2, 6), st.sampled_from([0.01, 0.1, 1.0]), st.floats(0.0, 1.01))
    def test_brakes_inside_the_acceleration_limits_wherever_it_is_asked_to(self, seed, waypoints, span, share):
        motion = limited_motion(np.random.default_rng(seed), waypoints, span)
        bench, braking = stop_after(motion, int(share * motion.duration / CYCLE))
        assert within_acceleration(bench.outputs)
        assert len(braking) * CYCLE < 2.0 or bench.executor.outcome == "finished"

    @pytest.mark.parametrize("share", [0.05, 0.3, 0.5, 0.9])
    def test_brakes_a_planned_motion_inside_the_limits(self, share):
        way = np.array([ROBOT.home, GOAL, np.array(ROBOT.home) + [0.2, 0.4, -0.1, -0.5, 0.3, 1.0]])
        motion = time_path(way, ROBOT)
        bench, _ = stop_after(motion, int(share * motion.duration / CYCLE))
        assert bench.executor.outcome == "stopped" and within_acceleration(bench.outputs)

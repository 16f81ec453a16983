"""The executor: exactly what was approved, and nothing when twin and arm do not agree."""

from __future__ import annotations

import math

import numpy as np
import pytest
from executor_bench import GOAL, ROBOT, Bench, make_plan, reach, within_acceleration
from hypothesis import assume, given
from hypothesis import strategies as st

from construction_twin.core.errors import ExecutionError
from construction_twin.core.units import CYCLE, CYCLE_NS
from construction_twin.execution.executor import TWIN_TIMEOUT, Executor, ExecutorState
from construction_twin.monitor.states import SyncState
from construction_twin.robot.trajectory import Trajectory


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

    @pytest.mark.parametrize("sync", [SyncState.HOLDING, SyncState.STALE, SyncState.FAULT, SyncState.WAITING])
    def test_a_hold_drops_the_rest_and_returns_to_the_twin(self, bench, sync):
        bench.approve(make_plan())
        bench.run(200)
        held, bench.passing = bench.twin, False
        ahead = bench.run(5)
        bench.executor.on_sync(sync, False)
        assert (bench.state, bench.executor.outcome) == (ExecutorState.IDLE, "held")
        assert bench.step() in (ahead[-1], held)
        assert set(bench.run(500)) == {held}

    def test_a_gate_that_is_open_again_is_no_reason_any_more(self, bench):
        bench.approve(make_plan())
        bench.run(200)
        bench.executor.on_sync(SyncState.REPLANNING, False)
        assert bench.executor.reason == "the gate holds (REPLANNING)"
        bench.executor.on_sync(SyncState.HOLDING, False)
        assert bench.executor.reason == "the gate holds (REPLANNING)"
        bench.executor.on_sync(SyncState.IN_SYNC, True)
        assert (bench.state, bench.executor.outcome) == (ExecutorState.IDLE, "held")
        assert bench.executor.reason == "the gate held, and is open again"

    def test_what_else_was_said_of_a_hold_stays_when_the_gate_opens(self, bench):
        bench.approve(make_plan())
        bench.run(200)
        bench.executor.stop(bench.stamp)
        bench.run(2)
        bench.executor.on_sync(SyncState.HOLDING, False, "resume", bench.stamp)
        before = bench.executor.reason
        bench.executor.on_sync(SyncState.IN_SYNC, True)
        assert bench.executor.reason == before.replace("the gate holds (HOLDING)", "the gate held, and is open again")
        assert bench.executor.reason.startswith("stop requested") and before != bench.executor.reason

    @pytest.mark.parametrize("stopping", [False, True])
    def test_an_arm_that_is_no_longer_armed_drops_the_plan(self, bench, stopping):
        bench.approve(make_plan())
        bench.run(200)
        if stopping:
            bench.executor.stop(bench.stamp)
        bench.executor.on_link(False, "gateway is holding")
        assert (bench.state, bench.executor.outcome) == (ExecutorState.IDLE, "dropped")
        assert len(set(bench.run(50))) == 1

    def test_what_runs_is_what_was_approved_to_the_last_bit(self, bench):
        """Rebuilt from the bytes whose hash was approved, the trajectory gives the very setpoints that were sent."""
        plan = make_plan(motion=reach(waypoints=7))
        copies = [np.frombuffer(rows.tobytes()).reshape(rows.shape) for rows in rows_of(plan.trajectory)]
        approved = Trajectory(ROBOT.joint_names, *copies)
        bench.executor.offer(plan)
        bench.review("p", approved.content_hash(), True, "Ada")
        outputs = bench.run_until_idle()
        assert outputs == [tuple(approved.sample(k * CYCLE_NS / 1e9)[0].tolist()) for k in range(len(outputs))]
        assert bench.executor.plan.trajectory.content_hash() == bench.records[0].plan_hash

    @pytest.mark.parametrize(
        "end, outcome",
        [
            (lambda bench: bench.run_until_idle(), "finished"),
            (lambda bench: (bench.executor.stop(bench.stamp), bench.run_until_idle()), "stopped"),
            (lambda bench: bench.executor.on_sync(SyncState.HOLDING, False), "held"),
            (lambda bench: bench.executor.on_link(False, "gateway is holding"), "dropped"),
            (lambda bench: bench.executor.restart("new command session", bench.stamp), "dropped"),
            (lambda bench: bench.executor.stall("not run for 0.1 s"), "dropped"),
        ],
        ids=["end", "stop", "hold", "link", "restart", "stall"],
    )
    def test_what_became_of_it_is_reported_once(self, bench, end, outcome):
        plan = bench.play(make_plan(), 100)
        assert bench.executor.pop_events() == []
        end(bench)
        bench.run(10)
        (event,) = bench.executor.pop_events()
        assert (event.plan, event.outcome, event.outcome) == (plan, outcome, bench.executor.outcome)
        assert event.reason

    def test_a_rate_limit_slows_it_down_from_the_first_cycle_on(self, bench):
        bench.executor.limit.set_fraction(0.5)
        bench.approve(make_plan())
        outputs = bench.run_until_idle()
        assert len(outputs) == pytest.approx(1000, abs=2) and outputs[-1] == GOAL
        assert within_acceleration(bench.outputs)

    @pytest.mark.parametrize("factor", [-0.1, 1.001, float("nan")])
    def test_refuses_a_rate_that_is_no_share_of_the_planned_one(self, bench, factor):
        with pytest.raises(ExecutionError, match="expected a fraction of the planned speed, 0 to 1"):
            bench.executor.limit.set_fraction(factor)


def rows_of(motion: Trajectory) -> tuple[np.ndarray, ...]:
    return motion.times, motion.positions, motion.velocities, motion.accelerations


class TestWords:
    """What a plan says of the speed limit is always of the present one."""

    def playing(self) -> Bench:
        bench = Bench().ready()
        bench.play(make_plan(), 100)
        return bench

    def test_a_limit_that_is_gone_is_not_spoken_of(self):
        bench = self.playing()
        bench.executor.limit.set_fraction(0.25, "somebody is near")
        bench.run(3)
        assert bench.executor.reason == "approved by Ada; at 25% of the planned speed: somebody is near"
        bench.executor.limit.set_fraction(1.0, "nobody is near")
        assert bench.executor.reason == bench.executor.cause == "approved by Ada"

    def test_who_stands_says_why_now(self):
        bench = self.playing()
        bench.executor.limit.set_fraction(0.0, "separation 0.50 m")
        while not bench.executor.limit.standing:
            bench.step()
        assert bench.executor.reason == "stands still on the path, goes on by itself: separation 0.50 m"
        bench.executor.limit.set_fraction(0.0, "the sensor is silent")
        assert bench.executor.reason.endswith("by itself: the sensor is silent")
        bench.executor.limit.set_fraction(0.25, "somebody is near")
        bench.run(20)
        assert not bench.executor.limit.standing and "at 25% of the planned speed" in bench.executor.reason
        bench.executor.limit.set_fraction(1.0, "")
        assert bench.executor.reason == "approved by Ada"

    def test_an_arm_that_trails_by_much_is_waited_for_on_the_path_until_it_has_caught_up(self):
        bench = self.playing()
        bench.executor.limit.on_lag(0.99)
        assert bench.executor.reason == "approved by Ada" and bench.executor.limit.rate == 1.0
        bench.executor.limit.on_lag(1.0)
        while not bench.executor.limit.standing:
            bench.step()
        assert bench.executor.reason.startswith(
            "waits on the path until the arm has caught up, goes on by itself: the arm "
        )
        assert "trails by more than 1 s" in bench.executor.reason and bench.state is ExecutorState.PLAYING
        standing = bench.run(3)
        assert (np.diff(standing, axis=0) == 0.0).all()
        # not as soon as it trails by a little less
        bench.executor.limit.on_lag(0.5)
        bench.run(3)
        assert bench.executor.limit.standing
        bench.executor.limit.on_lag(0.49)
        assert bench.run_until_idle()[-1] == GOAL and bench.executor.outcome == "finished"
        assert within_acceleration(bench.outputs)

    def test_a_limit_of_0_is_why_it_stands_although_the_arm_trails_too(self):
        bench = self.playing()
        bench.executor.limit.on_lag(2.0)
        bench.executor.limit.set_fraction(0.0, "separation 0.50 m")
        while not bench.executor.limit.standing:
            bench.step()
        assert bench.executor.reason == "stands still on the path, goes on by itself: separation 0.50 m"
        bench.executor.limit.set_fraction(1.0, "")
        assert bench.executor.reason.startswith("waits on the path until the arm has caught up")

    @given(st.floats(), st.floats())
    def test_what_is_no_known_lag_neither_begins_nor_ends_a_wait(self, unknown, servo_lag):
        assume(not 0.0 <= unknown < math.inf)
        bench = self.playing()
        for waits in (False, True):
            bench.executor.limit.on_lag(unknown, servo_lag)
            assert bench.executor.limit.waits is waits
            bench.executor.limit.on_lag(1.0)
        bench.executor.limit.on_lag(unknown, servo_lag)
        assert bench.executor.limit.waits
        bench.executor.limit.on_lag(0.4, math.nan)
        assert not bench.executor.limit.waits

    def test_a_new_session_waits_for_no_arm_of_the_one_before(self):
        bench = self.playing()
        bench.executor.limit.on_lag(2.0)
        bench.executor.restart("new session", bench.stamp)
        assert not bench.executor.limit.waits

    def test_it_stops_while_it_waits_and_says_that_the_arm_is_not_there_yet(self):
        bench = self.playing()
        bench.executor.limit.on_lag(2.0)
        bench.run(1)
        told = "braking plan p; the arm trails by much, and goes on until it is there"
        assert bench.executor.stop(bench.stamp) == told
        assert bench.run_until_idle()[-1] != GOAL and bench.executor.outcome == "stopped"
        bench = self.playing()
        bench.executor.limit.on_lag(2.0)
        while not bench.executor.limit.standing:
            bench.step()
        before = bench.step()
        assert bench.executor.stop(bench.stamp) == told
        assert set(bench.run_until_idle()) == {before} and bench.executor.outcome == "stopped"

    def test_it_pauses_and_resumes_while_it_waits(self):
        bench = self.playing()
        bench.executor.limit.on_lag(2.0)
        bench.executor.pause(bench.stamp)
        while bench.state is not ExecutorState.PAUSED:
            bench.step()
        bench.executor.resume()
        standing = bench.run(50)
        assert (np.diff(standing, axis=0) == 0.0).all() and bench.state is ExecutorState.PLAYING
        bench.executor.limit.on_lag(0.1)
        assert bench.run_until_idle()[-1] == GOAL and within_acceleration(bench.outputs)

    def test_other_states_do_not_speak_of_it(self):
        bench = self.playing()
        bench.executor.limit.set_fraction(0.25, "somebody is near")
        bench.executor.pause(bench.stamp)
        bench.run(3)
        assert bench.executor.reason == "pause requested"

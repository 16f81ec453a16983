"""Stop, pause and resume: on the path, inside the limits, under the same approval."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from executor_bench import ACCELERATION, GOAL, ROBOT, Bench, limited_motion, make_plan, reach, within_acceleration
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.core.errors import ExecutionError, ReviewError
from construction_twin.core.units import CYCLE
from construction_twin.execution.executor import ExecutorState
from construction_twin.execution.playback import StoppingPath, distance_along
from construction_twin.monitor.states import SyncState
from construction_twin.robot.trajectory import Trajectory


@pytest.fixture
def bench() -> Bench:
    return Bench().ready()


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
        fraction = (np.array(braking) - start) / way
        assert np.ptp(fraction, axis=1).max() < 1e-12
        assert (np.diff(fraction[:, 0]) >= 0.0).all() and fraction[-1, 0] < 0.8

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

    def test_a_plan_asked_for_before_the_stop_is_void_when_it_arrives(self, bench):
        bench.executor.stop(bench.stamp)
        with pytest.raises(ReviewError, match="plan p was asked for before the last stop, pause"):
            bench.executor.offer(make_plan())

    def test_of_one_plan_leaves_the_others_alone(self, bench):
        bench.approve(make_plan())
        bench.run(250)
        waiting = make_plan("waiting")
        bench.executor.offer(waiting)
        with pytest.raises(ExecutionError, match="plan 'waiting' is not played: the executor plays plan p"):
            bench.executor.stop_plan("waiting", "cancelled", bench.stamp)
        assert bench.state is ExecutorState.PLAYING
        assert bench.executor.stop_plan("p", "cancelled by /client", bench.stamp) == "braking plan p"
        assert bench.state is ExecutorState.STOPPING and bench.executor.reason == "cancelled by /client"
        assert bench.executor.stop_plan("p", "again", bench.stamp) == "plan p is braking already"
        bench.run_until_idle()
        assert bench.executor.outcome == "stopped" and bench.executor.under_review.plan is waiting
        # what was asked for before is not void either
        bench.executor.offer(make_plan("coming"))
        with pytest.raises(ExecutionError, match=r"plan 'p' is not played: the executor is IDLE \(cancelled by"):
            bench.executor.stop_plan("p", "too late", bench.stamp)

    @settings(max_examples=40, deadline=None)
    @given(st.integers(0, 2**32), st.integers(2, 6), st.sampled_from([0.01, 0.1, 1.0]), st.floats(0.0, 1.01))
    def test_brakes_inside_the_acceleration_limits_wherever_it_is_asked_to(self, seed, waypoints, span, fraction):
        motion = limited_motion(np.random.default_rng(seed), waypoints, span)
        bench, braking = stop_after(motion, int(fraction * motion.duration / CYCLE))
        assert within_acceleration(bench.outputs)
        assert len(braking) * CYCLE < 2.0 or bench.executor.outcome == "finished"

    def test_a_changed_scene_stops_on_the_path(self, bench):
        bench.play(make_plan(), 250)
        bench.executor.on_scene("0ther")
        assert bench.state is ExecutorState.STOPPING
        bench.run_until_idle()
        bench.run(3)
        assert bench.executor.outcome == "stopped" and "the scene changed" in bench.executor.reason
        assert within_acceleration(bench.outputs) and np.abs(np.array(bench.twin) - GOAL).max() > 0.01

    def test_a_changed_scene_while_it_brakes_changes_neither_cause_nor_way(self, bench):
        bench.play(make_plan(), 250)
        bench.executor.stop(bench.stamp)
        braking = [bench.twin, *bench.run(5)]
        bench.executor.on_scene("0ther")
        assert bench.executor.reason == "stop requested"
        braking += bench.run_until_idle()
        assert bench.executor.reason == f"stop requested; at rest after {distance_along(braking).text(ROBOT)}"
        assert bench.executor.pop_events()[0].reason == bench.executor.reason

    def test_a_hold_while_it_brakes_ends_the_plan_as_stopped(self, bench):
        bench.play(make_plan(), 250)
        bench.executor.stop(bench.stamp)
        bench.run(4)
        held, bench.passing = bench.stamp, False
        bench.run(2)
        bench.executor.on_sync(SyncState.HOLDING, False, "resume", held)
        assert (bench.state, bench.executor.outcome) == (ExecutorState.IDLE, "stopped")
        assert "HOLDING" in bench.executor.reason

    def test_a_changed_scene_ends_a_plan_that_has_not_begun(self, bench):
        bench.approve(make_plan())
        bench.executor.on_scene("0ther")
        assert (bench.state, bench.executor.outcome) == (ExecutorState.IDLE, "stopped")
        assert set(bench.run(100)) == {ROBOT.home}


class TestStoppingPath:
    def test_names_the_joint_that_moves_most(self):
        text = StoppingPath((0.0, 0.1, 0.2, 0.0, -0.0, 0.05), 0.2124).text(ROBOT)
        assert text == f"0.212 s and at most {np.rad2deg(0.2):.3f} deg of joint_a3"

    def test_names_the_linear_joint_too_in_mm(self):
        robot = replace(ROBOT, linear=(True, *ROBOT.linear[1:]))
        path = StoppingPath((0.25, np.deg2rad(0.1), 0, 0, 0, 0), 1.0)
        assert "0.100 deg of joint_a2, 250.000 mm of joint_a1" in path.text(robot)

    def test_ways_there_and_back_add_up(self):
        assert distance_along([(0.0, 1.0), (0.5, 1.0), (0.25, 0.0)]) == StoppingPath((0.75, 1.0), 2 * CYCLE)
        assert distance_along([(0.0, 1.0)]) == StoppingPath((0.0, 0.0), 0.0)


def pause_after(bench: Bench, cycles: int, motion: Trajectory | None = None) -> list:
    """Play a plan for some cycles and pause it; return the setpoints of the pausing."""
    bench.play(make_plan(motion=motion), cycles)
    bench.executor.pause(bench.stamp)
    return bench.run_until(ExecutorState.PAUSED)


class TestPause:
    def test_rests_on_the_path_and_repeats_the_setpoint(self, bench):
        pausing = pause_after(bench, 250)
        assert set(bench.run(500)) == {pausing[-1]}
        assert bench.state is ExecutorState.PAUSED and within_acceleration(bench.outputs)
        fraction = (np.array(pausing[-1]) - ROBOT.home) / (np.array(GOAL) - ROBOT.home)
        assert np.ptp(fraction) < 1e-12 and 0.5 < fraction[0] < 0.9

    def test_a_plan_asked_for_before_the_pause_is_void_when_it_arrives_and_one_that_waits_is_not(self, bench):
        bench.play(make_plan(), 250)
        waiting = make_plan("waits")
        bench.executor.under_review.offer(waiting)
        bench.executor.pause(bench.stamp)
        assert bench.executor.under_review.plan is waiting
        with pytest.raises(ReviewError, match="was asked for before the last stop, pause or reset"):
            bench.executor.under_review.offer(make_plan("late", asked_ns=bench.stamp - 1))
        bench.executor.under_review.offer(make_plan("new", asked_ns=bench.stamp + 1))

    def test_goes_on_along_the_same_path_to_the_goal_without_another_approval(self, bench):
        pause_after(bench, 250)
        bench.run(50)
        assert "goes on" in bench.executor.resume()
        outputs = bench.run_until_idle()
        assert outputs[-1] == GOAL and bench.executor.outcome == "finished"
        assert len(bench.records) == 1 and within_acceleration(bench.outputs)
        fractions = (np.array(bench.outputs[4:]) - ROBOT.home) / (np.array(GOAL) - ROBOT.home)
        assert np.ptp(fractions, axis=1).max() < 1e-12 and (np.diff(fractions[:, 0]) >= 0.0).all()

    def test_again_and_again_is_no_error(self, bench):
        bench.play(make_plan(), 250)
        bench.executor.pause(bench.stamp)
        assert "PAUSING already" in bench.executor.pause(bench.stamp)
        bench.run_until(ExecutorState.PAUSED)
        assert "PAUSED already" in bench.executor.pause(bench.stamp)

    def test_needs_something_that_plays(self, bench):
        with pytest.raises(ExecutionError, match=r"nothing to pause: the executor is IDLE \("):
            bench.executor.pause(bench.stamp)
        with pytest.raises(ExecutionError, match="nothing to resume: the executor is"):
            bench.executor.resume()
        bench.play(make_plan(), 10)
        with pytest.raises(ExecutionError, match=r"nothing to resume: the executor is PLAYING \("):
            bench.executor.resume()

    @settings(max_examples=30, deadline=None)
    @given(st.data(), st.integers(0, 2**32), st.integers(2, 5), st.sampled_from([0.01, 0.1, 1.0]))
    def test_any_sequence_stays_inside_the_limits_and_on_the_path(self, data, seed, waypoints, span):
        motion = limited_motion(np.random.default_rng(seed), waypoints, span)
        bench = Bench().ready()
        bench.approve(make_plan(motion=motion))
        for action in data.draw(st.lists(st.sampled_from(["pause", "resume"]), max_size=6)):
            bench.run(data.draw(st.integers(0, 150)))
            if (
                bench.state
                in {"pause": (ExecutorState.PLAYING,), "resume": (ExecutorState.PAUSING, ExecutorState.PAUSED)}[action]
            ):
                bench.executor.pause(bench.stamp) if action == "pause" else bench.executor.resume()
        if data.draw(st.booleans()):
            bench.executor.stop(bench.stamp)
        elif bench.state in (ExecutorState.PAUSING, ExecutorState.PAUSED):
            bench.executor.resume()
        bench.run_until_idle()
        bench.run(3)
        assert within_acceleration(bench.outputs)
        if bench.executor.outcome == "finished":
            assert bench.outputs[-1] == tuple(motion.positions[-1])
        assert len(set(bench.outputs[-3:])) == 1

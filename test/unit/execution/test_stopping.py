"""How far a stop goes: stated in advance, kept, and reported as it happened."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from executor_bench import ROBOT, Bench, limited_motion, make_plan, reach
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.core.units import CYCLE
from construction_twin.execution.executor import ExecutorState
from construction_twin.execution.playback import SETPOINTS_AT_ONCE, StoppingForecast, StoppingPath, distance_along
from construction_twin.monitor.states import SyncState


def way(rows) -> np.ndarray:
    return np.abs(np.diff(rows, axis=0)).sum(axis=0)


class TestText:
    def test_names_the_joint_that_moves_most(self):
        text = StoppingPath((0.0, 0.1, 0.2, 0.0, -0.0, 0.05), 0.2124).text(ROBOT)
        assert text == f"0.212 s and at most {np.rad2deg(0.2):.3f} deg of joint_a3"

    def test_names_the_linear_joint_too_in_mm(self):
        robot = replace(ROBOT, linear=(True, *ROBOT.linear[1:]))
        assert "0.100 deg of joint_a2, 250.000 mm of joint_a1" in StoppingPath(
            (0.25, np.deg2rad(0.1), 0, 0, 0, 0), 1.0
        ).text(robot)

    def test_tells_of_the_arm_only_where_its_lag_is_known(self):
        one = StoppingPath((0.1,) * 6, 0.2)
        assert "the arm" not in StoppingForecast(one, one, 0.0).text(ROBOT)
        assert "the arm, 0.050 s behind" in StoppingForecast(one, one, 0.05).text(ROBOT)


def test_ways_there_and_back_add_up():
    assert distance_along([(0.0, 1.0), (0.5, 1.0), (0.25, 0.0)]) == StoppingPath((0.75, 1.0), 2 * CYCLE)
    assert distance_along([(0.0, 1.0)]) == StoppingPath((0.0, 0.0), 0.0)


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 2**32),
    st.integers(2, 6),
    st.sampled_from([0.01, 0.1, 1.0]),
    st.floats(0.0, 1.0),
    st.sampled_from([1.0, 0.4]),
    st.one_of(st.floats(0.0, 0.3), st.floats(0.9, 2.5)),
)
def test_the_motion_after_a_stop_is_the_stated_one(seed, waypoints, span, fraction, rate, lag):
    motion = limited_motion(np.random.default_rng(seed), waypoints, span)
    bench = Bench().ready()
    bench.executor.limit.set_fraction(rate)
    bench.play(make_plan(motion=motion), 1 + int(fraction * motion.duration / CYCLE))
    bench.executor.limit.on_lag(lag)
    if bench.state is not ExecutorState.PLAYING:
        return
    bench.executor.stop(bench.stamp)
    forecast = bench.executor.braking().forecast()
    asked = len(bench.outputs) - 1
    bench.run_until_idle()
    bench.run(3)
    np.testing.assert_allclose(forecast.setpoints.joints, way(bench.outputs[asked:]), rtol=0, atol=1e-12)
    # an arm that is behind by up to `lag` has at most this way before it
    late = asked - int(lag / CYCLE)
    assert (np.array(forecast.arm.joints) >= way(bench.outputs[max(late, 3) :]) - 1e-12).all()
    assert forecast.arm.time >= forecast.setpoints.time


def test_looking_ahead_changes_nothing():
    with_it, without = Bench().ready(), Bench().ready()
    for bench in (with_it, without):
        bench.play(make_plan(), 250)
        bench.executor.limit.set_fraction(0.5)
        bench.run(5)
        bench.executor.stop(bench.stamp)
        if bench is with_it:
            bench.executor.braking().forecast()
        bench.run_until_idle()
    assert with_it.outputs == without.outputs


def test_looking_ahead_pauses_again_and_again_for_those_who_wait():
    bench = Bench().ready()
    bench.play(make_plan(), 250)
    bench.executor.limit.on_lag(0.2)
    bench.executor.stop(bench.stamp)
    pauses = []
    forecast = bench.executor.braking().forecast(lambda: pauses.append(1))
    computed = round(forecast.setpoints.time / CYCLE) + 51
    assert len(pauses) >= computed // SETPOINTS_AT_ONCE - 1
    assert forecast == bench.executor.braking().forecast()


def test_nothing_is_stated_unless_it_brakes():
    bench = Bench().ready()
    assert bench.executor.braking() is None
    bench.play(make_plan(), 100)
    assert bench.executor.braking() is None


def test_the_reason_tells_what_became_of_it():
    bench = Bench().ready()
    bench.play(make_plan(motion=reach()), 250)
    bench.executor.stop(bench.stamp)
    stated = bench.executor.braking().forecast().setpoints.text(ROBOT)
    bench.run_until_idle()
    assert bench.executor.reason == f"stop requested; at rest after {stated}"
    assert bench.executor.pop_events()[0].reason == bench.executor.reason


def test_a_stop_that_is_held_goes_no_further_than_stated():
    bench = Bench().ready()
    bench.play(make_plan(), 250)
    bench.executor.stop(bench.stamp)
    stated = bench.executor.braking().forecast().setpoints.joints
    asked = bench.twin
    bench.run(4)
    held, bench.passing = bench.stamp, False
    bench.run(2)
    bench.executor.on_sync(SyncState.HOLDING, False, "resume", held)
    assert (bench.state, bench.executor.outcome) == (ExecutorState.IDLE, "stopped")
    bench.run(5)
    assert (np.abs(np.subtract(bench.twin, asked)) <= np.array(stated)).all()
    assert "HOLDING" in bench.executor.reason

"""Progress along a path: however the rate changes, the setpoints stay on it and inside the limits."""

from __future__ import annotations

import numpy as np
import pytest
from executor_bench import ACCELERATION, JERK, ROBOT, limited_motion, reach
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.core.units import CYCLE
from construction_twin.execution.playback import Progress
from construction_twin.planning.timing import time_path
from construction_twin.robot.trajectory import Trajectory

GOALS = st.sampled_from([0.0, 0.1, 0.5, 1.0])


def start(motion: Trajectory, rate: float = 1.0) -> tuple[Progress, list]:
    """Begin; the list of setpoints starts with the rest before it."""
    progress = Progress(motion, ROBOT.acceleration, ROBOT.jerk)
    return progress, [progress.begin(rate)] * 3


def planned(seed: int, points: int = 3, span: float = 0.3, **timing) -> Trajectory:
    """A random motion as the planner times it: inside the acceleration and jerk limits."""
    rng = np.random.default_rng(seed)
    path = np.array(ROBOT.home) + span * rng.uniform(-1.0, 1.0, (points, 6))
    path[0] = ROBOT.home
    return time_path(path, ROBOT, **timing)


def fractions(outputs: list) -> tuple[float, float]:
    """Largest fractions of the acceleration and jerk limits, the rest after the last setpoint included."""
    rows = np.array(outputs + outputs[-1:] * 3)
    acceleration = np.abs(np.diff(rows, 2, axis=0)) / CYCLE**2 / ACCELERATION
    return acceleration.max(), (np.abs(np.diff(rows, 3, axis=0)) / CYCLE**3 / JERK).max()


def play(progress: Progress, outputs: list, rates) -> list[float]:
    """Ask for one rate after the other; return the elapsed times."""
    elapsed = []
    for rate in rates:
        outputs.append(progress.advance(rate))
        elapsed.append(progress.elapsed)
    return elapsed


def play_until_rest(progress: Progress, outputs: list) -> None:
    while not progress.at_rest and not progress.finished:
        outputs.append(progress.advance(0.0))


def play_to_the_end(progress: Progress, outputs: list) -> None:
    while not progress.finished:
        outputs.append(progress.advance(1.0))
        assert len(outputs) < 20_000


def test_a_rate_that_is_reached_stays_exactly():
    progress, outputs = start(reach(duration=8.0))
    play(progress, outputs, [1.0] * 200)
    elapsed = play(progress, outputs, [0.5] * 400)
    np.testing.assert_allclose(np.diff(elapsed[-100:]), 0.002, rtol=0, atol=1e-15)
    elapsed = play(progress, outputs, [1.0] * 400)
    np.testing.assert_allclose(np.diff(elapsed[-100:]), 0.004, rtol=0, atol=1e-15)


def test_at_rest_means_at_rest():
    progress, outputs = start(reach(duration=4.0))
    play(progress, outputs, [1.0] * 400)
    assert not progress.at_rest
    while not progress.at_rest:
        play(progress, outputs, [0.0])
    play(progress, outputs, [0.0] * 50)
    assert len(set(outputs[-51:])) == 1 and progress.at_rest
    play(progress, outputs, [1.0])
    assert not progress.at_rest


@pytest.mark.parametrize("speed_scale, bound", [(0.3, 2.0), (0.6, 2.5), (1.0, 6.0)])
def test_pauses_and_resumes_of_planned_motions_are_gentle(speed_scale, bound):
    """Shares of the jerk limits; braking hard, which jumps to the acceleration limit, takes more than ten times them."""
    soft, hard = [], []
    for seed in range(12):
        motion = planned(seed, 2, 0.6, speed_scale=speed_scale)
        for fraction in (0.2, 0.4, 0.6, 0.8):
            progress, outputs = start(motion)
            play(progress, outputs, [1.0] * int(fraction * motion.duration / CYCLE))
            play_until_rest(progress, outputs)
            play_to_the_end(progress, outputs)
            soft.append(fractions(outputs)[1])
            progress, outputs = start(motion)
            play(progress, outputs, [1.0] * int(fraction * motion.duration / CYCLE))
            while not progress.at_rest and not progress.finished:
                outputs.append(progress.brake())
            hard.append(fractions(outputs)[1])
    assert max(soft) <= bound
    assert np.median(hard) >= 10.0


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32),
    st.integers(2, 6),
    st.sampled_from([0.01, 0.1, 1.0]),
    st.lists(st.tuples(st.one_of(GOALS, st.just("brake")), st.integers(1, 150)), max_size=8),
)
def test_even_a_motion_at_the_acceleration_limit_stays_inside_it(seed, points, span, changes):
    motion = limited_motion(np.random.default_rng(seed), points, span)
    progress, outputs = start(motion)
    elapsed = [0.0]
    for rate, cycles in changes:
        for _ in range(cycles):
            outputs.append(progress.brake() if rate == "brake" else progress.advance(rate))
            elapsed.append(progress.elapsed)
    while not progress.finished:
        outputs.append(progress.advance(1.0))
        elapsed.append(progress.elapsed)
    # the differences of positions around 1 rad carry 1e-15 / (4 ms)^2 of rounding
    assert fractions(outputs)[0] <= 1.0 + 1e-9
    assert outputs[2:] == [tuple(motion.sample(t)[0].tolist()) for t in elapsed]
    assert np.diff(elapsed).min() >= 0.0 and np.diff(elapsed).max() <= CYCLE + 1e-12


@pytest.mark.parametrize("fraction", [0.1, 0.3, 0.5, 0.7, 0.9])
@pytest.mark.parametrize("speed_scale", [0.3, 1.0])
def test_a_pause_takes_little_longer_than_braking_hard(fraction, speed_scale):
    motion = planned(7, 2, 0.6, speed_scale=speed_scale)

    def cycles_to_rest(step) -> int:
        progress, outputs = start(motion)
        play(progress, outputs, [1.0] * int(fraction * motion.duration / CYCLE))
        cycles = 0
        while not progress.at_rest and not progress.finished:
            step(progress)
            cycles += 1
        return cycles

    hard = cycles_to_rest(lambda progress: progress.brake())
    assert cycles_to_rest(lambda progress: progress.advance(0.0)) <= hard + 80


def test_a_ramp_whose_goal_changes_goes_on_smoothly():
    motion = planned(3, 3, 0.6, speed_scale=0.5)
    progress, outputs = start(motion)
    play(progress, outputs, [1.0] * int(0.4 * motion.duration / CYCLE))
    for rate in (0.0, 1.0, 0.0, 0.5, 1.0):
        play(progress, outputs, [rate] * 13)
    play_to_the_end(progress, outputs)
    acceleration, jerk = fractions(outputs)
    assert acceleration <= 1.0 and jerk <= 2.5


@pytest.mark.parametrize("cycles", [1, 10, 40, 100])
def test_a_pause_does_not_wait_for_the_end_of_a_ramp_up(cycles):
    motion = planned(7, 2, 0.6)
    progress, outputs = start(motion)
    play(progress, outputs, [1.0] * int(0.3 * motion.duration / CYCLE))
    play_until_rest(progress, outputs)
    play(progress, outputs, [1.0] * cycles)
    before = len(outputs)
    play_until_rest(progress, outputs)
    assert len(outputs) - before <= 150 and not progress.finished
    play_to_the_end(progress, outputs)
    assert fractions(outputs)[0] <= 1.0 + 1e-9

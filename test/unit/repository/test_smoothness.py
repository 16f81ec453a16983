"""The smoothness benchmark: the target holds on simulated arrivals, and the naive gateway beside it does not."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def smoothness():
    """The benchmark's module."""
    spec = importlib.util.spec_from_file_location("smoothness", ROOT / "benchmarks" / "smoothness.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


@pytest.fixture(scope="module")
def results(smoothness):
    return smoothness.measure()


def test_the_motion_uses_at_least_half_of_the_limits(smoothness):
    robot = smoothness.read_robot()
    motion = smoothness.planned_motion(robot)
    velocity, acceleration = np.diff(motion, axis=0) / 0.004, np.diff(motion, 2, axis=0) / 0.004**2
    assert (np.abs(velocity).max(axis=0) / robot.velocity).max() >= 0.5
    assert (np.abs(acceleration).max(axis=0) / robot.acceleration).max() >= 0.5


def test_every_profile_without_a_cut_whose_stalls_are_below_the_bound_meets_the_target(smoothness, results):
    bound = smoothness.make_config(smoothness.read_robot()).playout_delay_max
    within = {
        name for name, profile in smoothness.PROFILES.items() if not profile.cut and profile.longest_stall < bound
    }
    assert within == set(smoothness.PROFILES) - {"cut_1s"}
    for name in within:
        ours = results[name]["ours"]
        assert max(ours["acc_ratio"], ours["jerk_ratio"]) <= smoothness.TARGET, (name, ours)


def test_the_naive_gateway_is_as_smooth_on_an_ideal_link_and_on_no_other(results):
    assert results["ideal"]["naive"]["acc_ratio"] == pytest.approx(1.0, abs=0.01)
    assert all(row["naive"]["acc_ratio"] > 10.0 for name, row in results.items() if name != "ideal")


def test_after_a_cut_the_arm_brakes_at_its_limits_and_no_more(results):
    # what the motion would have gone on to do is missing, what braking does is added
    assert results["cut_1s"]["ours"]["acc_ratio"] <= 1.1


def test_stalls_delay_but_never_reorder_and_loss_loses_its_share(smoothness):
    sent = np.arange(10_000, dtype=np.int64) * 4_000_000
    for name, profile in smoothness.PROFILES.items():
        arrivals = profile.arrivals(sent, 1)
        there = [at for at in arrivals if at is not None]
        assert there == sorted(there)
        assert all(at >= moment for at, moment in zip(arrivals, sent.tolist()) if at is not None)
        assert 1 - len(there) / len(sent) == pytest.approx(profile.loss, abs=0.01), name
        assert max(b - a for a, b in zip(there, there[1:])) >= profile.longest_stall * 1e9


@pytest.mark.parametrize(
    "name", ["ideal", "delay_20_10", "stall_50ms_1s", "stall_200ms_5s", "cut_1s", "loss_1", "loss_5"]
)
def test_without_properties_it_stays_inside_the_limits_on_arrival_times(smoothness, name):
    """Delay and stalls below `silence` are played as they were meant; what is lost or comes later stops the arm."""
    robot = smoothness.read_robot()
    motion = smoothness.planned_motion(robot)
    played = smoothness.play(motion, smoothness.make_config(robot, properties=False), smoothness.PROFILES[name])
    moved = played.positions[round((smoothness.WARM_UP - 1.0) / 0.004) :]
    velocity, acceleration = np.diff(moved, axis=0) / 0.004, np.diff(moved, 2, axis=0) / 0.004**2
    assert (np.abs(velocity).max(axis=0) <= np.array(robot.velocity) * 1.001).all()
    # with the rounding of 6 decimals
    assert (np.abs(acceleration).max(axis=0) <= np.array(robot.acceleration) * 1.02).all()
    stops = {reason for reason in played.status["counters"] if reason.startswith("stops_")}
    lossless, short = not name.startswith("loss"), name in ("ideal", "delay_20_10", "stall_50ms_1s")
    assert stops == (set() if short else {"stops_silence"} if lossless else {"stops_refused"})
    if short:
        assert smoothness.ratios(played, motion, robot)["acc_ratio"] <= smoothness.TARGET

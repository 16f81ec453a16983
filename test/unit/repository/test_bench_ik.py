"""The benchmark of inverse kinematics, on few poses: its file has the promised shape, and its KR 120 figures hold."""

from __future__ import annotations

import importlib.util
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[3]
HAS_TRACIK = importlib.util.find_spec("pytracik") is not None


@pytest.fixture(scope="module")
def bench():
    spec = importlib.util.spec_from_file_location("bench_ik", ROOT / "benchmarks" / "ik.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # its dataclasses look their module up
    spec.loader.exec_module(module)
    module.LIMIT_S = math.inf  # how fast this machine is at the moment is no matter of a test
    yield module
    del sys.modules[spec.name]


@pytest.fixture(scope="module")
def result(bench, tmp_path_factory) -> dict:
    path = tmp_path_factory.mktemp("bench") / "new" / "ik.json"
    options = [] if HAS_TRACIK else ["--no-tracik"]
    bench.main(["--poses", "60", "--checks", "10", "--seed", "3", "--output", str(path), *options])
    return json.loads(path.read_text())


def test_file_has_the_promised_shape(result):
    figures = {"poses", "solved", "median_us", "p99_us", "nearest", "residual_m", "residual_rad"}
    for robot in ("kr120", "ur_like", "track7"):
        assert set(result[robot]) == figures
        assert result[robot]["poses"] == 60
        assert 0.0 <= result[robot]["solved"] <= 1.0 and 0.0 <= result[robot]["nearest"] <= 1.0
        assert 0.0 < result[robot]["median_us"] <= result[robot]["p99_us"]
    others = {"tracik_speed"} if HAS_TRACIK else set()
    assert set(result) == {"kr120", "ur_like", "track7", "environment"} | others
    if HAS_TRACIK:
        assert set(result["tracik_speed"]) == {"solved", "median_us", "p99_us"}
    assert result["environment"]["cpu"] and result["environment"]["versions"]["numpy"] == np.__version__


def test_kr120_is_solved_always_and_nearest(result):
    assert result["kr120"]["solved"] == result["kr120"]["nearest"] == 1.0
    assert result["kr120"]["residual_m"] <= 1e-6 and result["kr120"]["residual_rad"] <= 1e-6


def test_same_seed_same_problems(bench):
    robot = bench.read_robot_files(*(ROOT / path for path in bench.ROBOTS["kr120"]))
    chain = bench.Chain(robot)
    first, second, other = (bench.problems(robot, chain, 5, seed) for seed in (1, 1, 2))
    assert all(np.array_equal(one.seed, two.seed) for one, two in zip(first, second))
    assert not np.array_equal(first[0].seed, other[0].seed)


def test_brute_force_finds_the_turn_nearest_to_the_seed(bench):
    robot = bench.read_robot_files(*(ROOT / path for path in bench.ROBOTS["kr120"]))
    chain = bench.Chain(robot)
    q = np.radians([10, -80, 100, 20, 60, -45])
    seed = np.radians([10, -80, 100, 20, 60, 320])
    search = bench.brute_force(chain, np.random.default_rng(0))
    assert search(bench.Problem(chain.forward(q), seed)) == pytest.approx(math.radians(5.0), abs=1e-6)


def test_what_is_not_the_nearest_is_counted_as_such(bench):
    tasks = [bench.Problem(None, None)] * 4
    assert bench.share_of_nearest([1.0, 2.0, 1.05, math.nan], tasks, lambda task: 1.0) == pytest.approx(1 / 3)
    assert math.isnan(bench.share_of_nearest([math.nan], tasks, lambda task: 1.0))

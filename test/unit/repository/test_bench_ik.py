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
    figures = {"kind", "poses", "solved", "median_us", "p99_us", "nearest", "residual_m", "residual_rad"}
    for robot in ("kr120", "ur_like", "track7", "panda_like"):
        assert set(result[robot]) == figures
        assert result[robot]["poses"] == 60
        assert 0.0 <= result[robot]["solved"] <= 1.0 and 0.0 <= result[robot]["nearest"] <= 1.0
        assert 0.0 < result[robot]["median_us"] <= result[robot]["p99_us"]
    others = {"tracik_speed"} if HAS_TRACIK else set()
    assert set(result) == {"kr120", "ur_like", "track7", "panda_like", "environment"} | others
    if HAS_TRACIK:
        assert set(result["tracik_speed"]) == {"solved", "median_us", "p99_us"}
    assert result["environment"]["cpu"] and result["environment"]["versions"]["numpy"] == np.__version__


def test_kr120_is_solved_always_and_nearest(result):
    assert result["kr120"]["solved"] == result["kr120"]["nearest"] == 1.0
    assert result["kr120"]["residual_m"] <= 1e-6 and result["kr120"]["residual_rad"] <= 1e-6


def test_arms_with_a_closed_form_are_solved_always(result):
    kinds = {"ur_like": "closed form", "track7": "OPW on a linear axis", "panda_like": "one redundant joint"}
    for robot, kind in kinds.items():
        assert result[robot]["kind"] == kind and result[robot]["solved"] == 1.0
    assert result["ur_like"]["nearest"] == 1.0

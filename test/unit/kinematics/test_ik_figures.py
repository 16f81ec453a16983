"""The benchmark's figures of inverse kinematics: problems, brute force, and what counts as nearest."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from ik_figures import Problem, brute_force, measure, problems, share_of_nearest
from inverse_cases import KR120, make_inverse

from construction_twin.kinematics.chain import Chain

CHAIN = Chain(KR120)


def test_same_seed_same_problems():
    first, second, other = (problems(CHAIN, 5, seed) for seed in (1, 1, 2))
    assert all(np.array_equal(one.seed, two.seed) for one, two in zip(first, second))
    assert not np.array_equal(first[0].seed, other[0].seed)


def test_brute_force_finds_the_turn_nearest_to_the_seed():
    q = np.radians([10, -80, 100, 20, 60, -45])
    seed = np.radians([10, -80, 100, 20, 60, 320])
    search = brute_force(CHAIN, np.random.default_rng(0), 150)
    assert search(Problem(CHAIN.forward(q), seed)) == pytest.approx(math.radians(5.0), abs=1e-6)


def test_what_is_not_the_nearest_is_counted_as_such():
    tasks = [Problem(CHAIN.forward(KR120.home), np.array(KR120.home))] * 4
    assert share_of_nearest([1.0, 2.0, 1.05, math.nan], tasks, lambda task: 1.0) == pytest.approx(1 / 3)
    assert math.isnan(share_of_nearest([math.nan], tasks, lambda task: 1.0))


def test_a_call_that_takes_too_long_has_not_solved_its_task():
    ticks = itertools.count()
    inverse, tasks = make_inverse(KR120), problems(CHAIN, 4, 3)
    assert measure(inverse, tasks, lambda: 0.0).solved == 1.0
    late = measure(inverse, tasks, lambda: float(next(ticks)), limit_s=0.5)
    assert late.solved == 0.0 and late.percentile_us(50) == 1e6


def test_a_pose_out_of_reach_counts_as_not_solved():
    far = CHAIN.forward(KR120.home)
    task = Problem(replace(far, position=far.position + 9.0), np.array(KR120.home))
    assert measure(make_inverse(KR120), [task], lambda: 0.0).solved == 0.0

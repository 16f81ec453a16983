"""Whole turns and ranges: the turn nearest to a seed, every choice of turns, and joints that have none."""

from __future__ import annotations

import math

import numpy as np
import pytest
from inverse_cases import KR120, TRACK

from construction_twin.kinematics.ranges import TURN, Ranges

RAIL, ARM = Ranges(TRACK), Ranges(KR120)
HOME = np.array(TRACK.home)


def test_a_prismatic_joint_has_no_turns():
    q = HOME + [0.1, 0, 0, 0, 0, 0, 0]
    assert RAIL.into_range(q + TURN, HOME, 0.0) == pytest.approx(q + [TURN, 0, 0, 0, 0, 0, 0])
    assert {each[0] for each in RAIL.turned(q.tolist(), 1e-6)} == {q[0]}


def test_the_turn_nearest_to_the_seed_is_taken_where_the_range_allows_it():
    seed = np.array(KR120.home)
    seed[3] = KR120.upper[3] - 0.1
    q = np.array(KR120.home)
    # half a radian further than the seed would be out of range: one turn back it is within
    q[3] = seed[3] + 0.5 - 2.0 * TURN
    assert ARM.into_range(q, seed, 0.0)[3] == pytest.approx(seed[3] + 0.5 - TURN)
    q[3] = seed[3] - 0.5 - 2.0 * TURN
    assert ARM.into_range(q, seed, 0.0)[3] == pytest.approx(seed[3] - 0.5)


def test_out_of_range_by_rounding_keeps_its_turn():
    seed = np.array(KR120.home)
    seed[3] = KR120.upper[3]
    q = seed.copy()
    q[3] += 5e-7
    assert ARM.into_range(q, seed, 1e-6)[3] == pytest.approx(seed[3], abs=1e-6)
    assert ARM.into_range(q, seed, 0.0)[3] == pytest.approx(seed[3] - TURN, abs=1e-6)


def test_every_choice_of_turns_is_given_once_and_is_within_the_ranges():
    q = np.array([0.1, -1.0, 1.0, 2.0, 0.5, -3.0])
    every = np.array(list(ARM.turned(q.tolist(), 1e-6)))
    wide = [joint for joint in range(6) if KR120.upper[joint] - KR120.lower[joint] >= TURN]
    expected = math.prod(
        sum(KR120.lower[joint] <= q[joint] + TURN * turn <= KR120.upper[joint] for turn in range(-3, 4))
        for joint in wide
    )
    assert len(every) == len(np.unique(every, axis=0)) == expected > 1
    assert ARM.excesses(every).max() <= 0.0
    kept = np.array(list(ARM.turned(q.tolist(), 1e-6, kept=wide)))
    np.testing.assert_allclose(kept, [q])


def test_each_joint_tells_how_far_it_is_out_of_range():
    q = np.array([KR120.home, KR120.home], dtype=float)
    q[1, 1], q[1, 4] = KR120.lower[1] - 0.3, KR120.upper[4] + 0.2
    excesses = ARM.excesses(q)
    assert excesses[0].max() < 0.0 and excesses[1, [1, 4]] == pytest.approx([0.3, 0.2])

"""Manipulability, distance to limits and to singularities."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from inverse_cases import KR120, TRACK, UR_LIKE, joints

from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.dexterity import (
    limit_distance,
    manipulability,
    scaled_jacobian,
    singularity_distance,
)

CHAIN = Chain(KR120)
STRETCHED = (0.3, -1.2, -math.atan2(0.041, 1.0), 0.4, 0.8, -0.2)


@pytest.mark.parametrize("q", [np.radians([0, -90, 90, 0, 0, 0]), STRETCHED], ids=["wrist", "elbow"])
def test_both_are_zero_at_a_singularity(q):
    assert singularity_distance(CHAIN, q) == pytest.approx(0.0, abs=1e-9)
    assert manipulability(CHAIN, q) == pytest.approx(0.0, abs=1e-9)


def test_both_grow_away_from_the_singular_wrist():
    poses = [np.radians([0, -90, 90, 0, a5, 0]) for a5 in (0, 1, 5, 20, 60)]
    for measure in (manipulability, singularity_distance):
        values = [measure(CHAIN, q) for q in poses]
        assert all(after > before for before, after in zip(values, values[1:]))


@given(joints(KR120))
def test_manipulability_is_the_jacobian_s_volume_and_blind_to_a1_and_a6(q):
    value = manipulability(CHAIN, q)
    assert value == pytest.approx(abs(np.linalg.det(scaled_jacobian(CHAIN, q))), rel=1e-6, abs=1e-12)
    turned = (0.0, *q[1:5], 0.0)
    assert manipulability(CHAIN, turned) == pytest.approx(value, rel=1e-6, abs=1e-12)


@given(joints(UR_LIKE))
def test_singularity_distance_is_the_worst_direction(q):
    chain = Chain(UR_LIKE)
    jacobian = scaled_jacobian(chain, q)
    slowest = singularity_distance(chain, q)
    for direction in np.random.default_rng(1).normal(size=(20, 6)):
        assert np.linalg.norm(jacobian.T @ direction) >= slowest * np.linalg.norm(direction) - 1e-12


def test_a_seventh_joint_only_helps():
    q = np.array(KR120.home)
    assert singularity_distance(Chain(TRACK), [0.0, *q]) >= singularity_distance(CHAIN, q)


def test_lengths_are_in_units_of_the_arm():
    jacobian, scaled = Chain(TRACK).jacobian(TRACK.home), scaled_jacobian(Chain(TRACK), TRACK.home)
    length = 0.5 * (0.350 + 1.150 + math.hypot(1.0, 0.041) + 0.215)
    np.testing.assert_allclose(scaled[:3, 1:] * length, jacobian[:3, 1:], atol=1e-12)
    np.testing.assert_array_equal(scaled[3:, 1:], jacobian[3:, 1:])
    np.testing.assert_allclose(scaled[:3, 0], [1.0, 0.0, 0.0], atol=1e-12)


def test_limit_distance_names_the_nearest_joint():
    q = list(KR120.home)
    assert limit_distance(KR120, 0.5 * (np.array(KR120.lower) + KR120.upper))[0] == pytest.approx(1.0)
    q[4] = KR120.upper[4]
    assert limit_distance(KR120, q) == (0.0, "joint_a5")
    q[4] = KR120.upper[4] - 0.1 * 0.5 * (KR120.upper[4] - KR120.lower[4])
    assert limit_distance(KR120, q) == (pytest.approx(0.1), "joint_a5")
    assert limit_distance(TRACK, (1.5, *KR120.home)) == (pytest.approx(-0.5), "track")


def test_limit_distance_of_another_number_of_joints_is_a_programming_error():
    with pytest.raises(ValueError, match="5 joint values for 6 joints"):
        limit_distance(KR120, KR120.home[:5])

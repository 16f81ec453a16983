"""Orientation conversions, both ways and at the gimbal lock."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from construction_twin.robot.frames import (
    abc_to_rotation,
    quaternion_to_rotation,
    rotation_to_abc,
    rotation_to_quaternion,
    rpy_to_quaternion,
    rpy_to_rotation,
)
from construction_twin.robot.motion_errors import KinematicsError

ANGLE = st.floats(-math.pi, math.pi)
GIMBAL = st.sampled_from([math.pi / 2, -math.pi / 2])
NEAR_GIMBAL = st.builds(lambda b, e: b + e, GIMBAL, st.sampled_from([0.0, 1e-15, -1e-13, 1e-11, -1e-9, 1e-7, -1e-5]))


def test_abc_turns_about_z_then_new_y_then_new_x():
    expected = Rotation.from_euler("ZYX", [0.3, -0.4, 1.2]).as_matrix()
    np.testing.assert_allclose(abc_to_rotation(0.3, -0.4, 1.2), expected, atol=1e-15)


@given(ANGLE, st.floats(-1.55, 1.55), ANGLE)
def test_abc_round_trip_gives_the_same_angles(a, b, c):
    back = rotation_to_abc(abc_to_rotation(a, b, c))
    difference = np.array(back) - (a, b, c)
    np.testing.assert_allclose(np.remainder(difference + math.pi, 2 * math.pi) - math.pi, 0.0, atol=1e-12)


@given(ANGLE, NEAR_GIMBAL, ANGLE)
def test_abc_round_trip_gives_the_same_rotation_at_and_near_gimbal_lock(a, b, c):
    rotation = abc_to_rotation(a, b, c)
    np.testing.assert_allclose(abc_to_rotation(*rotation_to_abc(rotation)), rotation, atol=2e-12)


@pytest.mark.parametrize("b", [math.pi / 2, -math.pi / 2])
def test_at_gimbal_lock_a_is_zero_and_c_carries_the_turn(b):
    a, found_b, c = rotation_to_abc(abc_to_rotation(0.5, b, 0.2))
    assert a == 0.0
    assert found_b == pytest.approx(b, abs=1e-12)
    assert c == pytest.approx(0.2 - math.copysign(0.5, b), abs=1e-12)


def test_quaternion_order_is_x_y_z_w():
    np.testing.assert_allclose(rotation_to_quaternion(abc_to_rotation(math.pi / 2, 0, 0)), [0, 0, 0.5**0.5, 0.5**0.5])


@pytest.mark.parametrize("values", [(0, 0, 0, 0), (0, 0, 0, 1.01), (0, 0, 0, math.nan), (0, 0, 1), (0, 0, 0, math.inf)])
def test_what_is_no_unit_quaternion_is_refused(values):
    with pytest.raises(KinematicsError, match="; expected 4 numbers of norm 1"):
        quaternion_to_rotation(values)


RPY = st.tuples(*[st.floats(-720.0, 720.0) | st.sampled_from([0.0, 90.0, -90.0, 180.0, 360.0])] * 3)


@given(RPY)
def test_roll_pitch_yaw_is_what_scipy_makes_of_it(rpy):
    expected = Rotation.from_euler("xyz", rpy, degrees=True)
    np.testing.assert_allclose(rpy_to_rotation(rpy), expected.as_matrix(), atol=1e-14)
    quaternion = rpy_to_quaternion(rpy)
    assert quaternion[3] >= 0.0
    assert abs(quaternion @ expected.as_quat()) == pytest.approx(1.0, abs=1e-14)


@given(
    st.tuples(*[st.floats(-1.0, 1.0) | st.sampled_from([0.0, 1e-9, -1e-9])] * 4).filter(
        lambda q: np.linalg.norm(q) > 1e-3
    )
)
def test_quaternions_are_those_of_scipy(values):
    rotation = Rotation.from_quat(values)
    np.testing.assert_allclose(quaternion_to_rotation(rotation.as_quat()), rotation.as_matrix(), atol=1e-14)
    quaternion = rotation_to_quaternion(rotation.as_matrix())
    assert np.linalg.norm(quaternion) == pytest.approx(1.0, abs=1e-15)
    # half a turn has two quaternions with w = 0, of which rounding chooses
    assert abs(quaternion @ rotation.as_quat()) == pytest.approx(1.0, abs=1e-14)
    assert quaternion[3] >= 0.0

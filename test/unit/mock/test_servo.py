"""Servo models: exact delay, exact discretisation, stall and release."""

from __future__ import annotations

import math

import numpy as np
import pytest

from construction_twin.core.units import CYCLE
from construction_twin.mock.servo import IdealServo, RealisticServo

VELOCITY, ACCELERATION = 2.0, 2.5


def _run(servo, setpoints):
    return np.array([servo.step((value,))[0] for value in setpoints])


def _assert_within_limits(positions, start):
    steps = np.diff(np.concatenate([[start, start], positions]))
    assert np.abs(steps).max() <= VELOCITY * CYCLE * (1 + 1e-9)
    assert np.abs(np.diff(steps)).max() <= ACCELERATION * CYCLE**2 * (1 + 1e-6)


@pytest.mark.parametrize("delay", [1, 2, 3, 7])
def test_ideal_servo_is_a_pure_delay(delay):
    servo = IdealServo(delay)
    servo.reset((0.5, -1.0))
    setpoints = [(0.5 + 0.01 * k, -1.0 - 0.02 * k) for k in range(30)]
    measured = [servo.step(setpoint) for setpoint in setpoints]
    # the position after step k is what packet k + 1 reports, so packet k + delay reports setpoint k
    assert measured[delay - 1 :] == setpoints[: 30 - delay + 1]
    assert all(q == (0.5, -1.0) for q in measured[: delay - 1])


def test_realistic_servo_trails_a_ramp_by_its_time_constant():
    servo = RealisticServo(resolution=0.0)
    servo.reset((0.0,))
    speed = 0.5
    times = np.arange(1, 501) * CYCLE
    measured = _run(servo, speed * times)
    # a setpoint stands for its whole cycle: it is half a cycle ahead of a continuous ramp on average
    assert speed * times[-1] - measured[-1] == pytest.approx(speed * (2 * 0.8 / 60.0 - CYCLE / 2), abs=1e-6)


def test_realistic_servo_reads_whole_encoder_steps():
    resolution = math.radians(3e-5)
    servo = RealisticServo()
    servo.reset((0.1,))
    steps = _run(servo, 0.1 + 0.01 * np.arange(100) * CYCLE) / resolution
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_a_released_joint_catches_up_with_a_moving_setpoint():
    servo = IdealServo(3)
    servo.reset((0.0,))
    servo.stall(0)
    ramp = 0.4 * CYCLE * np.arange(600)
    _run(servo, ramp[:100])
    servo.release(0, VELOCITY, ACCELERATION)
    measured = _run(servo, ramp[100:])
    _assert_within_limits(measured, 0.0)
    np.testing.assert_array_equal(measured[-100:], ramp[-102:-2])

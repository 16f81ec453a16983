"""Identification: what was built in is found again, from a recording as coarse as the wire, and what does not show is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.units import CYCLE, CYCLE_NS
from construction_twin.extensions.physics.identification import RecordedMotion, identify, response, servo_file
from construction_twin.servo.model import JointServo, read_servos

#: One step of the wire, 3 decimals of a degree [rad].
STEP = math.radians(1e-3)


def motion(cycles: int = 4000, speed: float = 1.0) -> np.ndarray:
    """Return a target that goes to and fro at changing speed, with stops between, from rest."""
    t = np.arange(cycles) * CYCLE
    rate = speed * np.sin(2 * np.pi * t / 3.1) * np.sin(2 * np.pi * t / 0.9) ** 2
    rate[(t % 4.0) > 3.2] = 0.0
    smooth = np.convolve(rate, np.hanning(25) / np.hanning(25).sum())[:cycles]
    smooth[:60] = 0.0
    return 0.3 + np.cumsum(smooth) * CYCLE


def drive(*servos: JointServo, targets=None) -> RecordedMotion:
    targets = motion() if targets is None else targets
    columns = [np.round(response(servo, targets, CYCLE) / STEP) * STEP for servo in servos]
    return RecordedMotion(
        np.stack([targets] * len(servos), axis=1), np.stack(columns, axis=1), np.ones(len(targets), bool)
    )


@pytest.mark.parametrize(
    "servo",
    [
        JointServo(60.0, 0.8),
        JointServo(60.0, 0.8, delay=1.4),
        JointServo(45.0, 1.1, velocity=0.012),
        JointServo(60.0, 0.8, backlash=0.002),
        JointServo(80.0, 0.7, delay=2.5, velocity=0.01, backlash=0.001),
    ],
    ids=["plain", "delay", "feed-forward", "backlash", "all"],
)
def test_what_was_built_in_is_found_again(servo):
    (found,) = identify(("a",), [drive(servo)], CYCLE_NS)
    assert found.residual_rms < 0.5 * STEP and found.residual_max < 3.0 * STEP
    # parameters may stand for each other; what the arm does may not differ
    assert found.servo.lag(CYCLE) == pytest.approx(servo.lag(CYCLE), abs=2e-4)
    assert found.servo.backlash == pytest.approx(servo.backlash, abs=1e-4)
    other = motion(3000, 2.0)
    assert response(found.servo, other, CYCLE) == pytest.approx(response(servo, other, CYCLE), abs=5e-4)
    assert 0.0 < found.lag_error < 2e-4


def test_what_does_not_show_is_not_taken_in():
    (found,) = identify(("a",), [drive(JointServo(60.0, 0.8))], CYCLE_NS)
    assert set(found.deviations) == {"omega", "zeta"}
    assert found.servo == JointServo(pytest.approx(60.0, rel=1e-3), pytest.approx(0.8, rel=1e-3))


def test_joints_that_do_not_move_are_refused_by_name():
    moving = drive(JointServo(60.0, 0.8), JointServo(60.0, 0.8), JointServo(60.0, 0.8))
    targets, measured = moving.targets.copy(), moving.measured.copy()
    for joint in (0, 2):
        targets[:, joint] = measured[:, joint] = 0.4
    with pytest.raises(ConstructionTwinError, match="a, c"):
        identify(("a", "b", "c"), [RecordedMotion(targets, measured, moving.counts)], CYCLE_NS)


def test_a_lag_that_cannot_be_told_is_refused():
    noisy = drive(JointServo(60.0, 0.8), targets=motion(1200, 0.3))
    noise = np.random.default_rng(3).normal(0.0, 0.02, noisy.measured.shape)
    with pytest.raises(ConstructionTwinError, match="lag"):
        identify(("a",), [RecordedMotion(noisy.targets, noisy.measured + noise, noisy.counts)], CYCLE_NS)


def test_the_file_gives_back_what_was_found(tmp_path):
    found = identify(("a", "b"), [drive(JointServo(60.0, 0.8), JointServo(50.0, 1.0, 1.5))], CYCLE_NS)
    path = tmp_path / "servos.yaml"
    path.write_text(servo_file(found, CYCLE_NS, "run.bag"))
    model = read_servos(path, ("b", "a"))
    assert model.names == ("b", "a") and model.cycle_ns == CYCLE_NS
    for joint in found:
        servo = model.servos[model.names.index(joint.name)]
        assert response(servo, motion(), CYCLE) == pytest.approx(response(joint.servo, motion(), CYCLE), abs=1e-7)


@pytest.mark.parametrize(
    "text",
    [
        "[",
        "2024-13-45",
        "cycle_ms: 4\njoints: {a: {omega: 60.0, zeta: 0.8}}",
        "cycle_ms: 4\njoints: {a: {omega: -1.0, zeta: 0.8}, b: {omega: 60.0, zeta: 0.8}}",
        "cycle_ms: 4\njoints: {a: {omega: .nan, zeta: 0.8}, b: {omega: 60.0, zeta: 0.8}}",
        "cycle_ms: 4.5\njoints: {a: {omega: 60.0, zeta: 0.8}, b: {omega: 60.0, zeta: 0.8}}",
        "cycle_ms: 4\njoints: {a: {omega: 60.0, zeta: 0.8, mass: 1}, b: {omega: 60.0, zeta: 0.8}}",
    ],
)
def test_a_file_of_another_arm_or_of_none_is_refused(tmp_path, text):
    path = tmp_path / "servos.yaml"
    path.write_text(text)
    with pytest.raises(ConfigurationError):
        read_servos(path, ("a", "b"))

"""What is learned of the servos on line: a lag, slowly and within bounds; and nothing else."""

from __future__ import annotations

import math

import pytest

from construction_twin.core.units import CYCLE_NS
from construction_twin.monitor.servo_watch import ENOUGH, LEAST, REACH, STEP, Refinement
from construction_twin.servo.model import JointServo, ServoModel

MODEL = ServoModel(("a", "b"), (JointServo(60.0, 0.8), JointServo(60.0, 0.8)), CYCLE_NS)


def work(refinement: Refinement, residual, samples: int = ENOUGH + 200) -> dict:
    """Move to and fro; `residual` makes of number and speed what is measured beside the expectation."""
    for number in range(samples):
        speed = math.sin(number / 200.0)
        refinement.add_sample((residual(number, speed), 0.0), (speed, 0.0))
    return refinement.apply() if refinement.due else {}


def test_a_lag_is_learned_step_by_step_and_no_further_than_its_reach():
    refinement = Refinement(MODEL)
    for turn in range(1, 12):
        left = 0.005 - refinement.added_lags[0]
        changes = work(refinement, lambda _, speed, left=left: -left * speed, 2 * ENOUGH)
        assert refinement.added_lags[0] == pytest.approx(min(turn * STEP, REACH), rel=1e-6)
        assert set(changes) <= {"a"} and all(abs(change) <= STEP + 1e-12 for change in changes.values())
    assert not changes
    assert refinement.model.servos[0].lag(0.004) == pytest.approx(MODEL.servos[0].lag(0.004) + REACH)
    assert refinement.model.servos[1] == MODEL.servos[1]


@pytest.mark.parametrize(
    "residual",
    [lambda n, v: 0.009, lambda n, v: 0.009 * n / ENOUGH, lambda n, v: 0.005 * math.cos(n / 37.0)],
    ids=["offset", "drift", "ripple"],
)
def test_what_does_not_grow_with_speed_is_not_learned(residual):
    refinement = Refinement(MODEL)
    for _ in range(20):
        work(refinement, residual, 4 * ENOUGH)
    assert abs(refinement.added_lags[0]) <= 2 * LEAST


def test_too_little_motion_and_too_small_a_change_do_nothing():
    refinement = Refinement(MODEL)
    assert not work(refinement, lambda _, speed: -0.001 * speed, ENOUGH // 2)
    refinement = Refinement(MODEL)
    assert not work(refinement, lambda _, speed: -0.9 * LEAST * speed)
    assert refinement.model is MODEL

"""The servos' model: what it does step by step, in one go, and beside the mock's own servo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.core.units import CYCLE, CYCLE_NS
from construction_twin.extensions.physics.identification import response
from construction_twin.mock.servo import RealisticServo
from construction_twin.servo.model import JointServo, ServoModel, ServoState

SERVOS = st.builds(
    JointServo,
    st.floats(5.0, 400.0),
    st.floats(0.2, 3.0),
    st.floats(0.0, 6.0),
    st.floats(-0.02, 0.04),
    st.floats(0.0, 3e-4),
    st.sampled_from((0.0, 0.002)),
)
#: A held target makes a quick servo's answer ripple within the cycle; its end is not the mean [s].
RIPPLE = 0.05 * CYCLE
TARGETS = st.lists(st.floats(-0.02, 0.02), min_size=4, max_size=60).map(lambda steps: 1.0 + np.cumsum(steps))


def stepped(servo: JointServo, targets) -> np.ndarray:
    state = ServoState(ServoModel(("joint",), (servo,), CYCLE_NS), targets[:1])
    return np.array([state.advance((target,))[0] for target in targets.tolist()])


@settings(max_examples=150, deadline=None)
@given(SERVOS, TARGETS)
def test_step_by_step_and_in_one_go_are_the_same(servo, targets):
    assert stepped(servo, targets) == pytest.approx(response(servo, targets, CYCLE), abs=1e-8)


@settings(max_examples=60, deadline=None)
@given(st.floats(10.0, 300.0), st.floats(0.2, 2.0), TARGETS)
def test_without_delay_it_is_the_mocks_realistic_servo(omega, zeta, targets):
    mock = RealisticServo(omega, zeta, 0.0)
    mock.reset(targets[:1].tolist())
    expected = [mock.step((target,))[0] for target in targets.tolist()][1:]
    # `reset` has already taken a cycle at rest, as the first target here
    assert stepped(JointServo(omega, zeta), targets)[1:] == pytest.approx(expected, abs=1e-12)


@settings(max_examples=60, deadline=None)
@given(SERVOS, st.floats(-2.0, 2.0))
def test_on_a_ramp_it_trails_by_its_lag(servo, speed):
    targets = speed * CYCLE * np.arange(10_000)
    servo = replace(servo, backlash=0.0)
    behind = targets[-1] - response(servo, targets, CYCLE)[-1]
    assert behind == pytest.approx(servo.lag(CYCLE) * speed, abs=abs(speed) * RIPPLE + 1e-6)


def test_another_model_at_rest_moves_nothing():
    model = ServoModel(("joint",), (JointServo(60.0, 0.8, 2.3),), CYCLE_NS)
    state = ServoState(model, (0.7,))
    for target in np.linspace(0.7, 0.8, 50):
        state.advance((target,))
    for _ in range(500):
        before = state.advance((0.8,))
    state.configure(model.slower((0.001,)))
    assert state.advance((0.8,)) == pytest.approx(before, abs=1e-12)

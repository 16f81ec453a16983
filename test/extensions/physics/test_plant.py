"""The arm alone: its torques are Pinocchio's, and a push moves it against its servos."""

from __future__ import annotations

import numpy as np
import pytest
from physics_samples import READY, bodies_of, drives

from construction_twin.core.errors import ConfigurationError
from construction_twin.extensions.physics.mass import payload_of
from construction_twin.extensions.physics.mock_servo import Plant, bare_model

PAYLOAD = (60.0, 0.0, 0.0, 0.2)
FAST = 60.0, 0.8


def bare(name="kr120", payload=()):
    return bare_model(bodies_of(name), drives(name), payload_of(payload, "payload"))


def plant(payload=PAYLOAD):
    return Plant(bare(payload=payload), *FAST)


def settled(arm: Plant, q=READY, cycles=50) -> np.ndarray:
    """Return where an arm stands that is told to stand at `q`; one that has not been anywhere begins there."""
    if not arm.q.any():
        arm.place(q)
    for _ in range(cycles):
        arm.cycle(np.array(q))
    return arm.q


def test_at_rest_it_holds_itself_and_its_payload_where_it_is_told():
    np.testing.assert_allclose(settled(plant()), READY, atol=1e-6)


@pytest.mark.parametrize("joint", range(6))
def test_a_push_moves_its_axis_in_its_sense_until_it_ends(joint):
    arm = plant()
    before = settled(arm)
    arm.push(joint, 100.0)
    change = settled(arm) - before
    assert 1e-6 < change[joint] < 1e-2 and abs(change).max() < 1e-2
    arm.push(joint, 0.0)
    np.testing.assert_allclose(settled(arm), before, atol=1e-6)


def test_a_joint_that_is_held_stays_there_and_the_others_go_on():
    arm = plant()
    settled(arm)
    goal = READY + 0.1
    goal[2] = READY[2]
    for k in range(500):
        arm.cycle(READY + (goal - READY) * min(1.0, k / 400))
        arm.hold(2, READY[2])
    assert arm.q[2] == READY[2]
    np.testing.assert_allclose(np.delete(arm.q, 2), np.delete(goal, 2), atol=1e-3)


@pytest.mark.parametrize(
    "numbers",
    [
        (0.0,), (-3.0,), (1.0, 2.0), (1.0, 0.0, 0.0, float("nan")), (float("inf"),), (float("nan"),),
        (9.9e-4,), (1.01e4,), (1.0, 0.0, -10.1, 0.0), (1.0, 7.1, 7.1, 0.0),
    ],
)  # fmt: skip
def test_what_is_no_payload_is_refused(numbers):
    with pytest.raises(ConfigurationError, match="KG,X,Y,Z"):
        payload_of(numbers, "payload")


def test_no_payload_is_none_and_a_mass_alone_hangs_at_the_flange():
    assert payload_of((), "payload") is None
    assert payload_of((1e-3, 0.0, -10.0, 0.0), "payload").mass == 1e-3
    assert payload_of((1e4,), "payload").mass == 1e4
    assert payload_of((5.0,), "payload").centre.tolist() == [0.0, 0.0, 0.0]

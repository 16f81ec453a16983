"""The whole chain with a model of the arm's servos at the gate: what is found, how soon, and what is no fault."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from chain_samples import ROBOT, make_plan, play_to_the_end
from servo_chain import (
    NOMINAL,
    ForeignPlant,
    LadenServo,
    Work,
    fault_in_motion,
    identified,
    model_of,
    poses,
    servo_chain,
    servo_of,
    slip,
    sweep,
)

from construction_twin.mock.faults import Fault
from construction_twin.monitor.states import SyncState

JOINTS = range(len(ROBOT.joint_names))


def axis(joint: int) -> str:
    return ROBOT.axes[joint].name


@pytest.mark.parametrize("joint", JOINTS, ids=axis)
def test_a_joint_that_stalls_at_full_speed_is_found_within_three_poses(joint):
    samples, reason = fault_in_motion(NOMINAL, joint, Fault("stall", axis(joint)))
    assert samples <= 3 and reason.startswith(f"A{joint + 1} ") and "servo" in reason


@pytest.mark.parametrize("joint", JOINTS, ids=axis)
def test_a_slip_of_three_quarters_of_a_degree_is_found_at_any_speed(joint):
    share, angle = ((0.3, 0.75), (1.0, -0.75))[joint % 2]
    samples, reason = fault_in_motion(NOMINAL, joint, slip(joint, angle), share)
    assert samples == 2 and reason.startswith(f"A{joint + 1} ")


FAULTS = [
    Fault("drift", "A2", (0.02,)),
    Fault("backlash", "A2", (0.045,)),
    Fault("slow", "A2", (0.4,)),
    "heavy payload",
]


@pytest.mark.parametrize("fault", FAULTS, ids=str)
def test_what_is_wrong_with_a_joint_is_found_and_not_learned(fault):
    servo = LadenServo()
    chain = servo_chain(arm=servo)
    work = Work(chain, 5)
    work.run(8.0)
    assert not work.holds
    # such a payload makes the servos much softer
    servo.carry(0.4) if fault == "heavy payload" else chain.faults.inject(fault)
    work.run(60.0)
    assert work.holds
    assert max(map(abs, chain.gate.servo_watch.refinement.added_lags)) <= 0.002


def test_a_payload_within_the_rating_closes_nothing_and_is_refined():
    servo = LadenServo()
    chain = servo_chain(arm=servo)
    work = Work(chain, 8)
    servo.carry(0.03)
    work.run(10.0)
    before = work.largest
    changes = []
    work.run(38.0, lambda number: changes.append(chain.gate.servo_watch.refinement.added_lags))
    assert not work.holds
    later = np.array(chain.gate.servo_watch.refinement.added_lags)
    # 3 % of 60 rad/s are 0.8 ms
    assert later == pytest.approx(np.full(6, 2 * 0.8 / 60.0 * (1 / 0.97 - 1)), abs=2.5e-4)
    work.forget()
    work.run(5.0)
    assert (work.largest < 0.6 * before).all()
    assert (np.abs(np.diff(np.array(changes), axis=0)) <= 0.0005 + 1e-12).all()


def test_the_arm_with_mass_is_followed_with_known_payloads():
    for payload in ([], [120.0, 0.0, 0.0, 0.2]):
        chain = servo_chain(servo="physics", payload=payload)
        work = Work(chain, 3)
        work.run(5.0)
        assert not work.holds and work.largest.max() < 2e-4


def test_a_collision_that_the_drives_cannot_hold_against_is_found():
    chain = servo_chain(servo="physics")
    plan, fastest, _ = sweep(chain, 2)
    chain.play(plan)
    chain.run_for(fastest)
    chain.faults.inject(Fault("collision", "A3", (12000.0,)))
    assert chain.run_until(lambda: chain.gate.state is SyncState.HOLDING, 0.1)
    assert "A3 " in chain.transitions[-1].reason


def test_an_arm_of_another_class_keeps_to_the_threshold_by_what_was_identified():
    chain = servo_chain(arm=servo_of(ForeignPlant(60.0, 0.05)))
    for goal in itertools.islice(poses(4), 3):
        play_to_the_end(chain, make_plan(chain, goal))
    model = model_of(identified(chain))
    plant = ForeignPlant(120.0, 0.05)
    work = Work(servo_chain(model, arm=servo_of(plant)), 9)
    work.run(8.0, lambda number: setattr(plant, "laden", number % 2 == 0))
    assert not work.holds and 1e-5 < work.largest.max() < 0.01

"""The arm alone: its torques are Pinocchio's, a push is a torque on one axis, a lost load is missed at once."""

from __future__ import annotations

import numpy as np
import pinocchio
import pytest
from construction_twin.monitor.torque_watch import TorqueSettings, TorqueWatch
from physics_samples import READY, bodies_of, drives, dynamics_of, model_of, robot_of
from scene_samples import random_poses

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.units import CYCLE_NS
from construction_twin.physics.mass import payload_of
from construction_twin.physics.plant import InverseDynamics, Plant, bare_model
from construction_twin.scene.objects import Scene, SceneObject

PAYLOAD = (60.0, 0.0, 0.0, 0.2)
FAST = 60.0, 0.8


def bare(name="kr120", payload=()):
    return bare_model(bodies_of(name), drives(name), payload_of(payload, "payload"))


def plant(payload=PAYLOAD):
    return Plant(bare(payload=payload), bare(), *FAST)


def settled(arm: Plant, q=READY, cycles=50) -> np.ndarray:
    """Return the torques with which an arm stands at `q`; one that has not been anywhere begins there."""
    if not arm.q.any():
        arm.place(q)
    for _ in range(cycles):
        arm.cycle(np.array(q))
    return arm.torque


def test_an_arm_alone_has_masses_and_nothing_that_could_touch():
    """A folded arm, and what it carries, would find itself in its way; and shapes that nobody needs take time to be made."""
    tile = SceneObject("tile", "box", (0.5, 0.5, 0.5), (0.0, 0.0, 0.0), link="tool0")
    physics = bare_model(bodies_of("kr120"), drives(), None, Scene((tile,)), {"tile": 60.0})
    assert physics.model.ngeom == 0 and physics.owners == ()
    assert physics.model.body("tile").mass[0] == pytest.approx(60.0)
    assert model_of().model.ngeom > 0


@pytest.mark.parametrize("name", ["kr120", "kr120_track", "ur_like", "ur_like_gripper"])
def test_torques_of_a_motion_are_those_of_pinocchio(name):
    (model, order), of_arm = dynamics_of(name), drives(name)
    data, dynamics = model.createData(), InverseDynamics(bare(name))
    generator = np.random.default_rng(26)
    worst = 0.0
    for q in random_poses(robot_of(name), 200):
        speed, growth = generator.uniform(-1.0, 1.0, (2, len(order)))
        # what follows a joint of the chain follows its rates, too
        zero = bodies_of(name).rows(np.zeros((1, len(order))))[0]
        rates = [bodies_of(name).rows(each[None])[0] - zero for each in (speed, growth)]
        torque = pinocchio.rnea(model, data, bodies_of(name).rows(q[None])[0], *rates)
        own = torque[order].copy()
        for at, leader, factor, _ in bodies_of(name).followers:
            place = list(order).index(leader) if leader in order else None
            if place is not None:
                own[place] += factor * torque[at]
        own += np.array(of_arm.armature) * growth + np.array(of_arm.damping) * speed
        own += np.array(of_arm.friction) * np.clip(speed / 1e-3, -1.0, 1.0)
        found = dynamics.torques(q, speed, growth)
        worst = max(worst, float(np.abs(found - own).max() / max(np.abs(own).max(), 1.0)))
    assert worst < 1e-6


def test_at_rest_the_axes_give_what_gravity_asks_of_arm_and_payload():
    dynamics = InverseDynamics(bare(payload=PAYLOAD))
    np.testing.assert_allclose(settled(plant()), dynamics.torques(READY, np.zeros(6), np.zeros(6)), atol=1e-3)


def test_a_lost_load_is_missed_at_once_and_the_arm_stays_where_it_is():
    arm = plant()
    loaded = settled(arm)
    before = arm.q.copy()
    arm.carry(False)
    empty = settled(arm, cycles=50)
    np.testing.assert_allclose(empty, settled(plant(())), atol=1e-3)
    assert abs(loaded - empty).max() > 300.0
    np.testing.assert_allclose(arm.q, before, atol=1e-6)
    arm.carry(True)
    np.testing.assert_allclose(settled(arm), loaded, atol=1e-3)


@pytest.mark.parametrize("joint", range(6))
def test_a_push_is_resisted_by_its_own_axis_and_by_no_other(joint):
    arm = plant()
    before = settled(arm).copy()
    arm.push(joint, 100.0)
    change = settled(arm) - before
    assert change[joint] == pytest.approx(-100.0, abs=0.5)
    assert abs(np.delete(change, joint)).max() < 1.0
    arm.push(joint, 0.0)
    np.testing.assert_allclose(settled(arm), before, atol=0.01)


def largest_difference(arm: Plant, watch: TorqueWatch, way, first: int) -> float:
    """Move along a way of cosines from READY; return the most that torques differ from what is expected, of the axes' limits."""
    worst = 0.0
    for k in range(200):
        q = READY + (1.0 - np.cos(np.pi * k / 100)) / 2.0 * np.array(way)
        stamp = (first + k) * CYCLE_NS
        watch.on_command(stamp, tuple(q))
        arm.cycle(q)
        expected = watch.expected(stamp)
        worst = max(worst, float((abs(arm.torque - np.array(expected)) / np.array(drives().torque)).max()))
    return worst


def test_what_a_plan_picks_up_and_releases_is_expected_of_the_scene_s_model():
    """An arm that takes up 60 kg on its way: with the model of the scene of the moment torques agree, with another they do not."""
    tile = SceneObject("tile/a", "box", (0.6, 0.6, 0.05), (0.0, 0.0, 0.2), link=robot_of("kr120").tip_link)
    holding = bare_model(bodies_of("kr120"), drives(), None, Scene((tile,)), {"tile": 60.0})
    models = {"empty": bare(), "holding": holding}
    # the arm that has it, and has not
    arm = Plant(holding, models["empty"], *FAST)
    watch = TorqueWatch(TorqueSettings((np.inf,) * 6, 1, *FAST), InverseDynamics(models["empty"]).torques)
    arm.carry(False)
    arm.place(READY)
    way, first = (0.3, 0.2, -0.2, 0.1, 0.2, 0.1), 1000
    for carries in (False, True, False):
        arm.carry(carries)
        believed, other = ("holding", "empty") if carries else ("empty", "holding")
        for name, holds in ((believed, True), (other, False)):
            settled(arm)
            watch.restart()
            watch.believe(InverseDynamics(models[name]).torques)
            difference = largest_difference(arm, watch, way, first)
            assert (difference < 0.01) is holds and (difference > 0.1) is not holds, (carries, name, difference)
            first += 1000


def test_a_push_on_a_track_is_a_force_along_it():
    arm = Plant(bare("kr120_track"), bare("kr120_track"), *FAST)
    q = np.array((1.0, *READY))
    settled(arm, q)
    before = arm.torque.copy()
    arm.push(0, 500.0)
    change = settled(arm, q) - before
    assert change[0] == pytest.approx(-500.0, abs=2.0) and abs(change[1:]).max() < 3.0


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


def test_the_same_cycles_give_the_same_bytes():
    one, other = plant(), plant()
    assert settled(one, READY + 0.05).tobytes() == settled(other, READY + 0.05).tobytes()


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

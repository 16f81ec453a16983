"""The twin with mass, cycle by cycle: where it begins, what it does in another scene, and that it repeats itself."""

from __future__ import annotations

import struct

import numpy as np
from chain_samples import REACH, ROBOT
from physics_samples import SHIPPED, carrying, model_in

from construction_twin.extensions.physics.model import PhysicsModel
from construction_twin.extensions.physics.nodes.simulated_twin import LiveTwin
from construction_twin.scene.objects import SceneObject

HOME = ROBOT.home
#: Path from home towards REACH and back to rest, one command per cycle.
PATH = [
    tuple(np.array(HOME) + (1.0 - np.cos(at)) / 8.0 * (np.array(REACH) - HOME)) for at in np.arange(0.0, np.pi, 0.01)
]


def twin_in(model: PhysicsModel) -> LiveTwin:
    twin = LiveTwin()
    twin.set_model(model)
    return twin


def bytes_of_a_run() -> bytes:
    """The shipped scene, then a load that is taken up on the way."""
    twin, told = twin_in(model_in()), []
    for number, commanded in enumerate(PATH):
        if number == 100:
            twin.set_model(model_in(carrying(0.3)))
        told += [*twin.cycle(commanded), *twin.effort]
    return struct.pack(f"{len(told)}d", *told)


def test_the_same_commands_give_the_same_bytes():
    assert bytes_of_a_run() == bytes_of_a_run()


def test_before_the_first_model_it_is_where_it_is_told_to_be_and_says_so():
    twin = LiveTwin()
    assert twin.cycle(HOME) == HOME and twin.effort == () == twin.contacts
    assert twin.fault == "nothing is simulated before the scene is known: the twin is at the commanded pose"
    twin.set_model(model_in())
    assert twin.fault == ""


def test_another_scene_takes_pose_speed_and_servo_over():
    plain, changed = twin_in(model_in()), twin_in(model_in())
    for number, commanded in enumerate(PATH):
        if number == 150:
            # it differs by what the arm never comes near; kinematics are computed anew
            changed.set_model(model_in(SHIPPED.add(SceneObject("far", "box", (0.1,) * 3, (5.0, 5.0, 5.0)))))
        assert np.abs(np.array(plain.cycle(commanded)) - changed.cycle(commanded)).max() < 1e-7


def test_what_the_scene_says_is_carried_weighs_on_the_axes():
    laden = model_in(carrying(0.4))
    empty, loaded = twin_in(model_in()), twin_in(laden)
    for _ in range(50):
        empty.cycle(HOME), loaded.cycle(HOME)
    assert abs(loaded.effort[2] - empty.effort[2]) > 500.0
    assert f"mass of cube is an estimate from its volume: {64.0:.1f} kg" in laden.remarks


def test_after_a_restart_it_begins_anew_at_rest():
    twin = twin_in(model_in())
    for commanded in PATH[:200]:
        twin.cycle(commanded)
    twin.restart()
    assert twin.effort == ()
    assert np.abs(np.array(twin.cycle(REACH)) - REACH).max() < 1e-7


def test_a_contact_that_the_planner_would_refuse_is_named_and_holds_the_arm_up():
    wall = SceneObject("wall", "box", (0.2, 4.0, 4.0), (2.0, 0.0, 2.0))
    twin = twin_in(model_in(SHIPPED.add(wall)))
    reached = np.array(HOME)
    for share in np.linspace(0.0, 1.0, 500):
        goal = np.array(HOME) + share * np.radians([0.0, 40.0, -40.0, 0.0, 0.0, 0.0])
        reached = np.array(twin.cycle(tuple(goal)))
    assert any("wall" in pair for pair in twin.contacts), twin.contacts
    assert np.abs(reached - goal).max() > 0.01


def test_a_state_that_has_become_useless_is_counted_and_begun_anew_where_it_is_commanded_to_be(monkeypatch, tmp_path):
    # where MuJoCo writes its own log
    monkeypatch.chdir(tmp_path)
    twin = twin_in(model_in())
    twin.cycle(HOME)
    # the gate lets no such command pass: it stands for whatever else may make numbers useless
    twin.cycle((float("nan"),) * 6)
    assert twin.diverged == 1 and twin.fault == (
        "the simulation was begun anew at the commanded pose, because its numbers had become useless: 1 times so far"
    )
    assert np.abs(np.array(twin.cycle(HOME)) - HOME).max() < 1e-7

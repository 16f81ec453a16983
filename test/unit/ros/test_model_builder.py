"""The process that builds models beside the node: what it answers, and what it says of a scene that cannot be built."""

from __future__ import annotations

import numpy as np
import pytest
from chain_samples import ROBOT
from live_twin_samples import DRIVES, FLOOR, SELF_COLLISION, carrying, model_in

from construction_twin.physics.drive import read_drives
from construction_twin.physics.live_twin import LiveTwin
from construction_twin.physics.mass import payload_of
from construction_twin.physics.plant import InverseDynamics, bare_model
from construction_twin.ros.shared.model_builder import ModelBuilder
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import SceneObject
from construction_twin.work.worker import WorkerError


@pytest.fixture
def builder():
    builder = ModelBuilder(ROBOT, DRIVES)
    yield builder
    builder.close()


def test_its_models_are_those_of_this_process(builder):
    for scene in (FLOOR, carrying(0.3)):
        here, there = LiveTwin(), LiveTwin()
        here.take_model(model_in(scene)), there.take_model(builder.build(scene, {}, SELF_COLLISION))
        for share in np.linspace(0.0, 0.1, 50):
            commanded = tuple(np.array(ROBOT.home) + share)
            assert here.cycle(commanded) == there.cycle(commanded)
        assert here.remarks == there.remarks and here.effort == there.effort


def test_a_scene_that_cannot_be_built_is_a_sentence_and_the_next_one_is_built(builder):
    with pytest.raises(WorkerError) as refusal:
        builder.build(
            FLOOR.add(SceneObject("hanging", "box", (0.1,) * 3, (1.0, 1.0, 1.0), touch=("nothing_there",))),
            {},
            SELF_COLLISION,
        )
    assert refusal.value.kind == "SceneError" and "nothing_there" in str(refusal.value)
    assert builder.build(FLOOR, {}, SELF_COLLISION).robot.name == ROBOT.name


def test_the_arm_alone_carries_what_it_does_in_a_scene_and_nothing_stands_around_it(builder):
    cube = SceneObject("cube/a", "box", (0.3,) * 3, (0.0, 0.0, 0.2), link=ROBOT.tip_link, touch=("post",))
    scene = FLOOR.add(SceneObject("post", "box", (0.1,) * 3, (2.0, 0.0, 0.5))).add(cube)
    model = builder.build_carrying(scene, {"cube": 50.0})
    names = {model.model.body(number).name for number in range(model.model.nbody)}
    assert "cube/a" in names and not names & {"post", FLOOR.objects[0].name}
    assert model.payload is not None and model.payload.mass == pytest.approx(50.0)
    still = ROBOT.home, (0.0,) * 6, (0.0,) * 6
    loaded = InverseDynamics(model).torques(*still)
    bare = bare_model(RobotBodies(ROBOT), read_drives(DRIVES, ROBOT), payload_of((50.0, 0.0, 0.0, 0.2), "payload"))
    empty = bare_model(RobotBodies(ROBOT), read_drives(DRIVES, ROBOT))
    # at rest a point mass weighs as the cube does
    np.testing.assert_allclose(loaded, InverseDynamics(bare).torques(*still), atol=1e-6)
    assert abs(loaded - InverseDynamics(empty).torques(*still)).max() > 300.0


def test_without_a_file_of_drives_the_torques_are_the_urdf_s():
    builder = ModelBuilder(ROBOT, "")
    try:
        drives = builder.build(FLOOR, {}, SELF_COLLISION).drives
    finally:
        builder.close()
    assert drives.source == "URDF effort" and not any(drives.armature)

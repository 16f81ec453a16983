"""The process that builds models beside the node: what it answers, and what it says of a scene that cannot be built."""

from __future__ import annotations

import numpy as np
import pytest
from chain_samples import ROBOT
from physics_samples import DRIVES, ROOT, SHIPPED, carrying, model_in

from construction_twin.core.worker import Worker, WorkerError
from construction_twin.extensions.physics.nodes.simulated_twin import LiveTwin
from construction_twin.extensions.physics.process import PROGRAM
from construction_twin.scene.objects import SceneObject


@pytest.fixture
def build():
    worker = Worker(PROGRAM)
    arm = {"robot": ROBOT, "self_collision": str(ROOT / "config/kr120_self_collision.yaml"), "drives": str(DRIVES)}
    yield lambda scene, **other: worker.ask("build", arm=arm | other, scene=scene, masses={})
    worker.close()


def test_its_models_are_those_of_this_process(build):
    for scene in (SHIPPED, carrying(0.3)):
        here, there = LiveTwin(), LiveTwin()
        own, other = model_in(scene), build(scene)
        here.set_model(own), there.set_model(other)
        for share in np.linspace(0.0, 0.1, 50):
            commanded = tuple(np.array(ROBOT.home) + share)
            assert here.cycle(commanded) == there.cycle(commanded)
        assert own.remarks == other.remarks and here.effort == there.effort


def test_a_scene_that_cannot_be_built_is_a_sentence_and_the_next_one_is_built(build):
    with pytest.raises(WorkerError) as refusal:
        build(SHIPPED.add(SceneObject("hanging", "box", (0.1,) * 3, (1.0, 1.0, 1.0), touch=("nothing_there",))))
    assert refusal.value.kind == "SceneError" and "nothing_there" in str(refusal.value)
    assert build(SHIPPED).robot.name == ROBOT.name


def test_without_a_file_of_drives_the_torques_are_the_urdf_s(build):
    drives = build(SHIPPED, drives="").drives
    assert drives.source == "URDF effort" and not any(drives.armature)

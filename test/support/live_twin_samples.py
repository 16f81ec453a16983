"""The shipped arm with mass, in the shipped scene, and with something in its hand."""

from __future__ import annotations

import functools

from chain_samples import ROBOT, ROOT

from construction_twin.extensions.physics.drive import read_drives
from construction_twin.extensions.physics.model import PhysicsModel, build_model
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_yaml import read_scene
from construction_twin.scene.self_collision import read_self_collision

SELF_COLLISION = str(ROOT / "config" / "kr120_self_collision.yaml")
DRIVES = str(ROOT / "config" / "kr120_drives.yaml")
FLOOR = read_scene(ROOT / "config" / "scene.yaml")


def carrying(size: float) -> Scene:
    """Return the scene with a cube of that size [m] at the flange, of 1000 kg/m^3."""
    cube = SceneObject("cube", "box", (size,) * 3, (0.0, 0.0, size / 2.0 + 0.01), link=ROBOT.tip_link)
    return FLOOR.add(cube)


@functools.cache
def model_in(scene: Scene = FLOOR) -> PhysicsModel:
    """Return the arm in a scene."""
    drives, pairs = read_drives(DRIVES, ROBOT), read_self_collision(SELF_COLLISION, ROBOT)
    return build_model(RobotBodies(ROBOT), scene, pairs, drives)

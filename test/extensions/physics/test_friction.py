"""Friction between loose bodies: a brick on a ramp slides as in closed form, and stays where friction holds it."""

import math
from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from physics_samples import READY, model_of

from construction_twin.extensions.physics.mass import FRICTION, GRAVITY
from construction_twin.extensions.physics.model import Load, PhysicsModel
from construction_twin.scene.objects import Scene, SceneObject

#: Where the objects lie, out of the arm's reach [m].
PLACE = np.array((0.0, 6.0, 3.0))
#: A brick, and how far up the ramp from `PLACE` it begins [m].
BRICK, UP = (0.24, 0.115, 0.07), 1.5


def as_it_is(_physics: PhysicsModel) -> None:
    """Change nothing."""


def with_less_friction(physics: PhysicsModel) -> None:
    physics.model.geom_friction[:, 0] -= 0.01


def slid(angle: float, change: Callable[[PhysicsModel], None], steps: int = 800) -> np.ndarray:
    """Return how far a brick has slid down a ramp after each step [m]."""
    c, s = math.cos(angle), math.sin(angle)
    rotation = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
    turn = (0.0, math.sin(angle / 2.0), 0.0, math.cos(angle / 2.0))
    begin = PLACE + rotation @ (-UP, 0.0, BRICK[2] / 2.0)
    ramp = SceneObject("ramp", "box", (4.0, 1.0, 0.2), tuple(PLACE + rotation @ (0.0, 0.0, -0.1)), turn)
    brick = SceneObject("brick", "box", BRICK, tuple(begin), turn)
    physics = model_of(scene=Scene((ramp, brick)), load=Load({"brick": 3.5}, {"brick": "brick"}))
    change(physics)
    data, at = physics.at_rest(READY), physics.loose["brick"]
    positions = np.empty((steps, 3))
    for row in positions:
        mujoco.mj_step(physics.model, data)
        row[:] = data.qpos[at : at + 3]
    return (positions - begin) @ rotation[:, 0]


@pytest.mark.parametrize(("change", "same"), [(as_it_is, True), (with_less_friction, False)])
def test_a_brick_slides_down_a_ramp_as_in_closed_form(change, same):
    """Measured: 0.13 % of the way in 0.8 s; with a friction of 0.39 instead of 0.40 5 to 15 %."""
    angle = math.radians(25.0)
    way = slid(angle, change)
    closed = 0.5 * GRAVITY * (math.sin(angle) - FRICTION * math.cos(angle)) * (0.001 * np.arange(1, len(way) + 1)) ** 2
    assert closed[-1] > 0.18
    # the first steps press the brick into the ramp
    assert bool(np.abs(way - closed)[200:].max() < 0.005 * closed[-1]) is same

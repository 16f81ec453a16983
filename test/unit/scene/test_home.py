"""scene.home: a home pose is free, round, and the same every time; where there is none, the two that touch are named."""

from __future__ import annotations

import numpy as np
import pytest
from scene_samples import FLOOR, kr120, kr120_pairs, ur_like, ur_like_pairs

from construction_twin.core.errors import ConfigurationError
from construction_twin.kinematics.chain import Chain
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.home import find_home
from construction_twin.scene.objects import Scene, SceneObject


@pytest.mark.parametrize(
    "robot, pairs", [(kr120(), kr120_pairs()), (ur_like(), ur_like_pairs())], ids=lambda arm: getattr(arm, "name", "")
)
def test_a_home_is_free_round_and_the_same_every_time(robot, pairs):
    world = CollisionWorld(robot, Scene((FLOOR,), padding=0.02), pairs)
    home, again = (find_home(world, np.random.default_rng(0)) for _ in range(2))
    assert home == again
    assert world.is_free(home.q) and home.clearance == pytest.approx(world.clearance(home.q).distance)
    degrees = np.degrees(home.q)
    assert np.round(degrees / 45) * 45 == pytest.approx(degrees)
    tip = Chain(robot).forward(home.q)
    assert tip.position[0] > 0 and tip.position[2] > 0


def test_what_stands_in_the_way_is_avoided():
    free = find_home(CollisionWorld(kr120(), Scene(), kr120_pairs()), np.random.default_rng(0))
    tip = Chain(kr120()).forward(free.q).position
    block = SceneObject("block", "box", (0.5, 0.5, 0.5), tuple(tip), fixed=True)
    world = CollisionWorld(kr120(), Scene((block,), padding=0.02), kr120_pairs())
    moved = find_home(world, np.random.default_rng(0))
    assert moved.q != free.q and world.is_free(moved.q)


def test_where_every_pose_is_in_contact_the_two_are_named():
    hall = SceneObject("hall", "sphere", (5.0,), fixed=True)
    world = CollisionWorld(kr120(), Scene((hall,)), kr120_pairs())
    with pytest.raises(
        ConfigurationError, match="all in contact, most often link_1 with hall.*look at the collision shapes"
    ):
        find_home(world, np.random.default_rng(0))

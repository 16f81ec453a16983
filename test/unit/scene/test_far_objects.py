"""scene.collision_world with a whole building in it: what the arm cannot reach is left out, what it can reach is not."""

from __future__ import annotations

import numpy as np
import pytest
from scene_samples import FLOOR, kr120, kr120_pairs, random_poses, track7, track7_pairs

from construction_twin.scene.collision_world import MANY_BODIES, CollisionWorld
from construction_twin.scene.objects import Scene, SceneObject


def building(far: int, near: int) -> Scene:
    rng = np.random.default_rng(1)
    places = [(*rng.uniform((20.0, -10.0), (60.0, 10.0)), 1.2) for _ in range(far)]
    angles = rng.uniform(0.0, 2.0 * np.pi, near)
    places += [(2.0 * np.cos(angle), 2.0 * np.sin(angle), 1.2) for angle in angles]
    return Scene(
        (FLOOR, *(SceneObject(f"e{number}/0", "box", (0.1, 0.1, 2.4), place) for number, place in enumerate(places))),
        0.02,
    )


@pytest.mark.parametrize(
    ("robot", "pairs"), [(kr120, kr120_pairs), (track7, track7_pairs)], ids=["KR 120", "on its track"]
)
def test_a_far_building_changes_no_answer(robot, pairs):
    all_of_it = building(MANY_BODIES + 20, 12)
    near = Scene((FLOOR, *all_of_it.objects[-12:]), all_of_it.padding)
    one, other = CollisionWorld(robot(), all_of_it, pairs()), CollisionWorld(robot(), near, pairs())
    poses = random_poses(robot(), 150)
    assert [one.is_free(q) for q in poses] == [other.is_free(q) for q in poses]
    assert [one.contacts(q) for q in poses[:40]] == [other.contacts(q) for q in poses[:40]]
    assert 0 < sum(one.is_free(q) for q in poses) < len(poses)
    # left out, not only far
    assert len(one.distances(poses[0])) == len(other.distances(poses[0]))
    assert one.clearance(poses[0]).distance == pytest.approx(other.clearance(poses[0]).distance, abs=1e-6)


def test_a_carried_object_reaches_further():
    scene = building(MANY_BODIES + 20, 0).add(SceneObject("pole", "cylinder", (0.05, 60.0)))
    carried = scene.attach("pole", "tool0", FLOOR.pose, ("link_6",))
    world = CollisionWorld(kr120(), carried, kr120_pairs())
    checked = {name for pair in world.distances(kr120().home) for name in pair.between}
    # half of its length, and the arm
    near = {item.name for item in scene.objects if np.hypot(*item.position[:2]) < 30.0}
    assert len(near) > 20 and near - {"pole"} <= checked


def test_a_far_object_can_still_be_asked_for():
    scene = building(MANY_BODIES + 20, 0)
    world = CollisionWorld(kr120(), scene, kr120_pairs())
    assert world.distance(kr120().home, "link_6", "e0/0") > 10.0

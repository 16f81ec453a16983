"""Motions among many objects: those that are far from all of it are left out, and no answer changes."""

import numpy as np
import pinocchio
import pytest
from scene_samples import FLOOR, kr120, kr120_pairs, random_poses, track7, track7_pairs

from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.collision_world import MANY_BODIES, CollisionWorld, NearBodies
from construction_twin.scene.objects import Scene, SceneObject

ARMS = pytest.mark.parametrize(("robot", "pairs"), [(kr120, kr120_pairs), (track7, track7_pairs)], ids=["arm", "track"])


def many(padding=0.02):
    """Boxes, some of them turned, all around the arm and within its reach."""
    rng = np.random.default_rng(4)
    objects = [FLOOR]
    for number in range(MANY_BODIES + 40):
        angle, far, height = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(1.5, 3.2), rng.uniform(0.2, 2.5)
        turned = rng.normal(size=4)
        place = (far * np.cos(angle), far * np.sin(angle), height)
        size = tuple(rng.uniform(0.05, 0.3, 3))
        orientation = tuple(turned / np.linalg.norm(turned))
        objects.append(SceneObject(f"e{number}/0", "box", size, place, orientation, padding=0.01 * (number % 3)))
    return Scene(tuple(objects), padding)


def motions(robot, count, rows=90):
    """Short straight motions, so that some touch nothing."""
    starts, ways = random_poses(robot, count), random_poses(robot, count)[::-1]
    fractions = np.linspace(0.0, 0.08, rows)[:, None]
    return [start + fractions * (way - start) for start, way in zip(starts, ways)]


@ARMS
def test_a_motion_is_free_when_each_of_its_poses_is(robot, pairs):
    world = CollisionWorld(robot(), many(), pairs())
    touched = []
    for qs in motions(robot(), 60):
        single = [row for row, q in enumerate(qs) if not world.is_free(q)]
        touched.append(world.all_free(qs))
        assert touched[-1] == (single[0] if single else None)
        if single:
            found = world.contact(qs[single[0]])
            assert found is not None and found in world.contacts(qs[single[0]])
    # of all three kinds: free, in contact from the beginning, coming into contact
    assert None in touched and 0 in touched and any(row for row in touched)


@ARMS
def test_the_smallest_clearance_of_a_motion_is_that_of_its_closest_pose(robot, pairs):
    world = CollisionWorld(robot(), many(), pairs())
    free = [qs for qs in motions(robot(), 60) if world.all_free(qs) is None]
    assert len(free) > 3
    for qs in free[:6]:
        found, place = world.clearance_of(qs)
        row = int(place)
        at = qs[row] + (place - row) * (qs[min(row + 1, len(qs) - 1)] - qs[row])
        assert found.distance <= min(world.clearance(q).distance for q in qs) + 2e-6
        assert found.distance == pytest.approx(world.clearance(at).distance, abs=2e-6)


def test_the_clearance_is_right_where_nothing_is_near():
    far = Scene(
        tuple(
            SceneObject(f"e{n}/0", "box", (0.1, 0.1, 0.1), (0.02 * n - 1.5, 0.0, 4.2)) for n in range(MANY_BODIES + 5)
        ),
        0.0,
    )
    # no pair of links is checked: what is closest is one of the boxes, 0.5 m away and more
    world = CollisionWorld(kr120(), far, kr120_pairs())
    qs = kr120().home + np.linspace(0.0, 0.2, 70)[:, None] * np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    found, row = world.clearance_of(qs)
    assert found.distance == pytest.approx(min(world.clearance(q).distance for q in qs), abs=2e-6)
    assert 0 <= row < len(qs)


def test_what_is_left_out_is_further_than_the_gap():
    robot, gap, scene = kr120(), 0.15, many(0.0)
    placed = RobotBodies(robot)
    bodies = (*placed.bodies, *placed.place_all(scene))
    qs = motions(robot, 3, rows=40)[1]
    near = NearBodies(placed, bodies).near(qs, gap)
    left = [body.owner for index, body in enumerate(bodies) if index not in near and body.item is not None]
    links = sorted({body.owner for body in bodies if body.joint})
    assert 10 < len(left) < MANY_BODIES + 40
    world = CollisionWorld(robot, scene, kr120_pairs())
    for q in qs[::6]:
        assert min(world.distance(q, link, name) for link in links for name in left[::9]) > gap


def test_a_motion_that_is_free_or_touches_prepares_only_what_is_near(monkeypatch):
    pairs = []

    class Counted(pinocchio.CollisionPair):
        def __init__(self, *bodies):
            super().__init__(*bodies)
            pairs.append(bodies)

    world = CollisionWorld(kr120(), many(), kr120_pairs())
    everything = len(CollisionWorld(kr120(), many(), kr120_pairs()).distances(kr120().home))
    monkeypatch.setattr(pinocchio, "CollisionPair", Counted)
    found = []
    for qs in motions(kr120(), 12):
        pairs.clear()
        found.append(world.first_contact(qs))
        assert len(pairs) < everything / 2
        row = world.all_free(qs)
        assert row is None or found[-1][0] <= row
    assert None in found and any(found)

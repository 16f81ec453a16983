"""Links that a mimic joint moves with the chain: posed by forward kinematics, and checked where they are."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scene_samples import ROOT

from construction_twin.kinematics.chain import Pose, to_kdl, to_pose
from construction_twin.robot.description import Following, RobotModel, load_robot
from construction_twin.robot.new_robot import new_description
from construction_twin.robot.urdf import chain_joints, parse_urdf
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.neighbour import Neighbour
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.self_collision import SelfCollision, geometry_hash, sample_self_collision

NONE = SelfCollision({}, "")
URDF = (ROOT / "test/data/balanced_like.urdf").read_text()


def balanced(urdf: str = URDF) -> RobotModel:
    return load_robot(urdf, new_description(urdf, "balanced", "base_link", "tool0", 1.0))


@cache
def pairs() -> SelfCollision:
    return sample_self_collision(balanced(), samples=500)


def expected(link: str, q: np.ndarray) -> Pose:
    """Return a link's pose by KDL, with each joint where the URDF's own numbers put it."""
    robot, model = balanced(), parse_urdf(URDF)
    values = dict(zip(robot.joint_names, q))
    values |= {"balance_cylinder": -0.3 * values["shoulder"], "balance_piston": -1.3 * values["shoulder"] + 0.05}
    frame = None
    for joint in chain_joints(model, "base_link", link):
        step = to_kdl([joint]).getSegment(0).pose(values.get(joint.name, 0.0))
        frame = step if frame is None else frame * step
    return to_pose(frame)


def poses(count: int, seed: int = 0) -> np.ndarray:
    robot = balanced()
    return np.random.default_rng(seed).uniform(robot.lower, robot.upper, (count, 6))


def test_the_law_of_each_follower_is_known():
    followers = {joint.name: joint.following for joint in balanced().other_joints}
    assert followers == {
        "balance_cylinder": Following("shoulder", -0.3, 0.0),
        "balance_piston": Following("shoulder", -1.3, 0.05),
    }


@pytest.mark.parametrize("link", ["cylinder", "piston", "upper_arm", "tool0"])
def test_every_link_is_where_forward_kinematics_puts_it(link):
    bodies = RobotBodies(balanced())
    for q in poses(50):
        found, right = bodies.link_pose(q, link), expected(link, q)
        assert found.position == pytest.approx(right.position, abs=1e-9)
        assert found.rotation == pytest.approx(right.rotation, abs=1e-9)


def test_what_a_piston_hits_is_found_where_the_piston_is_and_nowhere_else():
    robot = balanced()
    leaning = np.array([0.0, 1.2, 0.0, 0.0, 0.5, 0.0])
    at = expected("piston", leaning)
    # at the near end of the piston
    end = at.position + at.rotation @ (0.03, 0.0, -0.0144)
    world = CollisionWorld(robot, Scene((SceneObject("pin", "sphere", (0.01,), tuple(end)),)), pairs())
    assert ("piston", "pin") in [contact.between for contact in world.contacts(leaning)]
    assert not world.is_free(leaning) and world.contact(leaning) is not None
    back = leaning * (1, -0.8, 1, 1, 1, 1)
    assert ("piston", "pin") not in [contact.between for contact in world.contacts(back)]


def test_the_clearance_of_a_motion_is_that_of_its_rows():
    """The bounds that leave most rows unmeasured must hold for links that follow, too."""
    robot = balanced()
    start, goal = np.array([0.0, -1.0, 0.2, 0.0, 0.5, 0.0]), np.array([0.1, 1.3, -0.4, 0.5, 0.2, 1.0])
    rows = start + np.linspace(0.0, 1.0, 400)[:, None] * (goal - start)
    for seed in range(20):
        x, y, z = np.random.default_rng(seed).uniform((-1.0, -0.3, 0.4), (-0.3, 0.5, 1.4))
        scene = Scene((SceneObject("pin", "sphere", (0.05,), (float(x), float(y), float(z))),))
        world = CollisionWorld(robot, scene, pairs())
        found, _ = world.clearance_of(rows)
        assert found.distance == pytest.approx(min(world.clearance(q).distance for q in rows), abs=2e-6)


def test_another_arm_sees_the_piston_where_it_is():
    neighbour = Neighbour("other", balanced(), Pose(np.zeros(3), np.eye(3)))
    for q in poses(10, 1):
        (found,) = {item for item in neighbour.space_between(q, q) if item.owner == "other/piston"}
        at = expected("piston", q)
        middle = at.position + at.rotation @ (-0.25, 0.0, -0.05)
        assert found.placement.translation == pytest.approx(middle, abs=1e-9)


def test_a_self_collision_file_is_void_when_a_factor_or_an_offset_changes():
    hashes = {
        geometry_hash(RobotBodies(balanced(text)))
        for text in (URDF, URDF.replace('multiplier="-1.3"', 'multiplier="-1.2"'), URDF.replace('offset="0.05"', ""))
    }
    assert len(hashes) == 3


def test_the_levers_of_the_search_hold_for_links_that_follow():
    """A step of the shoulder moves what follows it as well; the search divides its edges by these levers."""
    robot = balanced()
    world = CollisionWorld(robot, Scene(()), NONE)
    rng = np.random.default_rng(1)
    for q in poses(200, seed=1):
        step = rng.uniform(-0.1, 0.1, 6)
        after = np.clip(q + step, robot.lower, robot.upper)
        bound = np.abs(after - q) @ world.levers
        for link in ("cylinder", "piston"):
            moved = expected(link, after).position - expected(link, q).position
            assert np.linalg.norm(moved) <= bound + 1e-9, link

"""scene.world: contacts and distances of a robot among objects, against an independent computation where there is one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_samples import FLOOR, clutter, kr120, kr120_pairs, random_poses, track7, track7_pairs, ur_like, ur_like_pairs

from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.robot.motion_errors import SceneError
from construction_twin.scene import collision_world as world_module
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene, SceneObject, relative
from construction_twin.scene.self_collision import SelfCollision

HOME = np.array(kr120().home)


def world(*objects: SceneObject, padding: float = 0.0) -> CollisionWorld:
    return CollisionWorld(kr120(), Scene(objects, padding), kr120_pairs())


def every_pair_touches(checked: CollisionWorld, q) -> bool:
    """The same pairs, all measured one by one: no broad phase, no margins, no end at the first."""
    gaps = np.array([pair.distance - pair.margin for pair in checked.distances(q)])
    # undecidable within the solver's tolerance
    assert np.abs(gaps).min() > 1e-9
    return bool((gaps <= 0.0).any())


@pytest.mark.parametrize("padding", [0.0, 0.02, 0.3])
@pytest.mark.parametrize("many", [128, 0])
def test_the_fast_answer_is_the_answer(padding, many, monkeypatch):
    monkeypatch.setattr(world_module, "MANY_BODIES", many)
    scene = replace(clutter(), padding=padding).add(SceneObject("tool", "box", (0.1, 0.1, 0.4), padding=0.07))
    scene = scene.attach("tool", "tool0", Pose(np.array([0.0, 0.0, 0.2]), np.eye(3)), ("link_3", "link_4", "link_5"))
    scene = scene.add(replace(scene.get("object1"), padding=0.15), replace_existing=True)
    checked = CollisionWorld(kr120(), scene, kr120_pairs())
    answers = set()
    for q in random_poses(kr120(), 400):
        free = checked.is_free(q)
        assert free != every_pair_touches(checked, q)
        assert (checked.contact(q) is None) == free
        answers.add(free)
    assert answers == {True, False}


def test_home_is_free_and_a_wall_in_the_arm_is_named():
    tool = Chain(kr120()).forward(HOME).position
    wall = SceneObject("wall", "box", (0.02, 1.0, 1.0), tuple(tool + [-0.2, 0.0, 0.0]))
    assert world(FLOOR).is_free(HOME) and world(FLOOR).contact(HOME) is None
    assert not world(FLOOR, wall).is_free(HOME)
    link, other = world(FLOOR, wall).contact(HOME).between
    assert other == "wall" and link in {"link_4", "link_5", "link_6", "link_3"}


def test_joint_values_may_be_of_any_kind():
    for q in (HOME, list(HOME), tuple(HOME), HOME.astype(np.float32)):
        assert world(FLOOR).is_free(q)
    with pytest.raises(ValueError):
        world(FLOOR).is_free(HOME[:5])


def test_padding_is_the_distance_that_counts_as_contact():
    # a ball under the flange: the flange's face is a disc at the tool's height, looking down
    tool = Chain(kr120()).forward(HOME).position
    for gap, own, scene_padding, free in [
        (0.05, 0.0, 0.0, True),
        (0.05, 0.03, 0.019, True),
        (0.05, 0.03, 0.021, False),
        (0.05, 0.0, 0.051, False),
        (-0.01, 0.0, 0.0, False),
    ]:
        ball = SceneObject("ball", "sphere", (0.1,), tuple(tool - [0.0, 0.0, 0.1 + gap]), padding=own)
        checked = world(ball, padding=scene_padding)
        assert checked.is_free(HOME) is free, (gap, own, scene_padding)
        if gap > 0:
            clearance = checked.clearance(HOME)
            assert clearance.distance == pytest.approx(gap, abs=1e-6)
            assert clearance.between == ("link_6", "ball")
            assert clearance.point == pytest.approx(tool, abs=1e-3)


def test_padding_does_not_count_between_the_arm_s_own_links():
    q = HOME
    own = CollisionWorld(kr120(), Scene(), kr120_pairs()).clearance(q).distance
    assert CollisionWorld(kr120(), Scene((), padding=own + 0.1), kr120_pairs()).is_free(q)


def test_without_pairs_there_is_nothing_to_touch():
    links = {f"link_{number}" for number in range(7)}
    ignored = {frozenset((a, b)): "never" for a in links for b in links if a < b}
    checked = CollisionWorld(kr120(), Scene(), SelfCollision(ignored, ""))
    assert checked.is_free(HOME) and checked.clearance(HOME).distance == np.inf
    assert checked.clearance(HOME).between == ()
    assert checked.clearance_of(HOME[None])[0].distance == np.inf


def test_the_pedestal_stands_on_the_floor_and_in_a_hole():
    assert world(FLOOR, SceneObject("grout", "box", (1.0, 1.0, 0.1), (0.0, 0.0, 0.02)), padding=0.05).is_free(HOME)


def test_the_arm_can_touch_itself():
    checked = world()
    # the forearm folded in: the wrist comes to the shoulder
    poses = np.radians(np.random.default_rng(0).uniform((0, -90, 150, 0, 50, 0), (0, -70, 155, 40, 90, 0), (400, 6)))
    touching = [q for q in poses if not checked.is_free(q)]
    assert touching
    for q in touching[:20]:
        assert all(name.startswith("link_") for name in checked.contact(q).between)
        assert checked.clearance(q).distance <= 1e-6


def test_a_carried_tool_moves_with_its_link_and_is_checked():
    spindle = SceneObject("spindle", "cylinder", (0.06, 0.3), (0.0, 0.0, 0.15), link="tool0")
    post = SceneObject("post", "box", (0.1, 0.1, 0.1), tuple(Chain(kr120()).forward(HOME).position - [0, 0, 0.28]))
    assert world(post).is_free(HOME)
    assert world(spindle).is_free(HOME)
    assert world(spindle, post).contact(HOME).between == ("spindle", "post")
    away = HOME + [0.5, 0, 0, 0, 0, 0]
    assert world(spindle, post).is_free(away)


def test_a_carried_tool_may_touch_only_what_moves_with_it_and_what_is_named():
    # a bracket that reaches back to the wrist
    bracket = SceneObject("bracket", "box", (0.4, 0.05, 0.4), (0.1, 0.0, -0.1), link="tool0")
    (first, second) = world(bracket).contact(HOME).between
    assert first == "bracket" and second in {"link_3", "link_4", "link_5"}
    assert world(replace(bracket, touch=("link_3", "link_4", "link_5"))).is_free(HOME)


def test_a_tool_on_the_flange_and_one_on_the_arm_meet():
    tool = SceneObject("tool", "box", (0.1, 0.1, 0.3), (0.0, 0.0, 0.15), link="tool0")
    rack = SceneObject(
        "rack",
        "box",
        (0.5, 0.5, 0.5),
        (0.4, 0.0, -0.041),
        link="link_3",
        touch=("link_2", "link_4", "link_5", "link_6"),
    )
    far = replace(rack, size=(0.1, 0.1, 0.1), position=(-0.8, 0.0, 0.0))
    folded = np.radians([0.0, -90.0, 90.0, 0.0, 125.0, 0.0])
    assert world(tool, far).is_free(folded)
    big = replace(rack, size=(1.2, 0.5, 0.5))
    assert set(world(tool, big).contact(folded).between) == {"tool", "rack"}


def test_links_that_may_touch_a_standing_object_are_not_checked_against_it():
    post = SceneObject("post", "box", (0.1, 0.1, 0.1), tuple(Chain(kr120()).forward(HOME).position - [0, 0, 0.04]))
    assert world(post).contact(HOME).between == ("link_6", "post")
    assert world(replace(post, touch=("link_6",))).is_free(HOME)


@pytest.mark.parametrize(
    "item",
    [
        SceneObject("tool", "sphere", (0.1,), link="gripper"),
        SceneObject("tool", "sphere", (0.1,), link="tool0", touch=("link_9",)),
        SceneObject("link_3", "sphere", (0.1,)),
    ],
)
def test_objects_that_do_not_fit_the_robot_are_refused(item):
    with pytest.raises(SceneError) as caught:
        world(item)
    assert caught.value.value in {"gripper", "link_9", "link_3"}


def test_all_free_names_the_first_row_in_contact():
    checked = CollisionWorld(kr120(), clutter(), kr120_pairs())
    poses = random_poses(kr120(), 200)
    free = [checked.is_free(q) for q in poses]
    assert checked.all_free(poses) == free.index(False)
    assert checked.all_free(poses[np.array(free)]) is None
    assert checked.all_free(np.empty((0, 6))) is None


@pytest.mark.parametrize("robot, pairs", [(kr120, kr120_pairs), (ur_like, ur_like_pairs), (track7, track7_pairs)])
@settings(max_examples=3, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_smallest_distance_of_many_rows_is_that_of_all_rows_and_of_what_lies_between_them(robot, pairs, seed):
    checked = CollisionWorld(robot(), clutter(seed % 7), pairs())
    corners = random_poses(robot(), 3, seed)
    rows = np.concatenate([np.linspace(corners[0], corners[1], 90), np.linspace(corners[1], corners[2], 41)])
    clearance, place = checked.clearance_of(rows)
    row = int(place)
    at = rows[row] + (place - row) * (rows[min(row + 1, len(rows) - 1)] - rows[row])
    # between the rows it may be smaller, and is so by no more than finer rows show
    fine = np.concatenate([np.linspace(rows[n], rows[n + 1], 8, endpoint=False) for n in range(len(rows) - 1)])
    every = min(checked.clearance(q).distance for q in (*fine, rows[-1]))
    # where bodies are in each other, the depth is known less well
    tolerance = 2e-6 if every > 0 else 1e-4
    assert clearance.distance <= every + 1e-4 + tolerance
    assert clearance.distance == pytest.approx(checked.clearance(at).distance, abs=tolerance)


def test_an_answer_depends_on_the_pose_alone_not_on_those_before():
    checked = CollisionWorld(kr120(), clutter(), kr120_pairs())
    poses = random_poses(kr120(), 100)
    forward = [(checked.is_free(q), checked.clearance(q)) for q in poses]
    backward = [(checked.is_free(q), checked.clearance(q)) for q in poses[::-1]][::-1]
    assert forward == backward


def test_one_row_and_rows_at_rest_have_a_clearance_too():
    checked = CollisionWorld(kr120(), clutter(), kr120_pairs())
    alone, row = checked.clearance_of(HOME[None])
    assert row == 0 and alone.distance == pytest.approx(checked.clearance(HOME).distance, abs=1e-9)
    assert checked.clearance_of(np.tile(HOME, (300, 1)))[0].distance == pytest.approx(alone.distance, abs=1e-9)


def test_a_distance_that_no_joint_changes_is_none_of_a_pose_or_a_motion():
    rows = np.linspace(HOME, HOME + np.array([1.2, 0.3, -0.2, 0.0, 0.4, 0.0]), 40)
    checked = world(FLOOR)
    # link_1 turns above the floor about an upright axis
    assert checked.clearance(HOME).between == checked.clearance_of(rows)[0].between == ("link_1", "floor")
    for found, q in ((checked.clearance(HOME, changing=True), HOME), checked.clearance_of(rows, changing=True)):
        at = q if isinstance(q, np.ndarray) else rows[int(q)]
        assert found.between != ("link_1", "floor")
        others = [pair.distance for pair in checked.distances(at) if pair.between != ("link_1", "floor")]
        # others may be steady, too: none that moves is closer
        assert found.distance in [pytest.approx(each, abs=1e-4) for each in others]
    # what comes near to it does so because it turns
    post = SceneObject("post", "box", (0.1, 0.1, 2.0), (0.75, 0.0, 1.0))
    assert world(FLOOR, post).clearance(HOME, changing=True).between[1] == "post"
    # and nothing of it is left out of what may touch
    shallow = replace(FLOOR, position=tuple(np.array(FLOOR.position) + [0.0, 0.0, 0.32]))
    assert world(shallow).contact(HOME).between == ("link_1", "floor")


@pytest.mark.parametrize("robot, pairs", [(kr120, kr120_pairs), (track7, track7_pairs)])
def test_of_the_pairs_whose_distance_changes_the_smallest_is_found(robot, pairs):
    checked = CollisionWorld(robot(), Scene((FLOOR,)), pairs())
    poses = random_poses(robot(), 60)
    table = np.array([[pair.distance for pair in checked.distances(q)] for q in poses])
    names = [pair.between for pair in checked.distances(poses[0])]
    steady = np.ptp(table, axis=0) < 1e-3
    assert steady.any() and not steady.all()
    for q, row in zip(poses, table):
        found = checked.clearance(q, changing=True)
        assert found.distance == pytest.approx(row[~steady].min(), abs=2e-6)
        assert found.between in [name for name, out in zip(names, steady) if not out]
    assert checked.clearance_of(poses[:2], changing=True)[0].distance <= table[:2][:, ~steady].min() + 2e-6


def test_every_contact_is_listed_once():
    tool = Chain(kr120()).forward(HOME).position
    wall = SceneObject("wall", "box", (0.1, 1.0, 1.0), tuple(tool))
    checked = world(FLOOR, wall)
    pairs = [contact.between for contact in checked.contacts(HOME)]
    assert checked.contact(HOME).between in pairs and len(set(pairs)) == len(pairs) > 1
    assert {other for _, other in pairs} == {"wall"}
    assert world(FLOOR).contacts(HOME) == []


def test_link_poses_are_the_chain_s():
    checked, chain = world(SceneObject("tool", "sphere", (0.1,), (0.0, 0.0, 0.2), link="tool0")), Chain(kr120())
    for q in random_poses(kr120(), 20):
        expected = chain.forward(q)
        for pose in (
            checked.link_pose(q, "tool0"),
            relative(Pose(np.zeros(3), np.eye(3)), checked.link_pose(q, "tool0")),
        ):
            assert np.allclose(pose.position, expected.position, atol=1e-12)
            assert np.allclose(pose.rotation, expected.rotation, atol=1e-12)
        placed = checked.object_pose(q, "tool")
        assert np.allclose(placed.position, expected.position + expected.rotation @ [0, 0, 0.2], atol=1e-12)
    with pytest.raises(SceneError, match="link"):
        checked.link_pose(HOME, "gripper")
    with pytest.raises(SceneError):
        checked.object_pose(HOME, "wall")


def test_an_arm_on_a_track_moves_along_and_is_checked_there():
    home = np.array(track7().home)
    tool = Chain(track7()).forward(home).position
    post = SceneObject("post", "box", (0.1, 0.1, 0.1), tuple(tool - [0, 0, 0.04]))
    checked = CollisionWorld(track7(), Scene((FLOOR, post)), track7_pairs())
    assert checked.contact(home).between == ("link_6", "post")
    assert checked.is_free(home + [0.5, 0, 0, 0, 0, 0, 0])
    assert CollisionWorld(track7(), Scene((FLOOR,), 0.02), track7_pairs()).is_free(home)
    for q in random_poses(track7(), 20):
        expected, pose = Chain(track7()).forward(q), checked.link_pose(q, track7().tip_link)
        assert np.allclose(pose.position, expected.position, atol=1e-12)


def test_the_order_of_the_joints_is_the_robot_s():
    """Pinocchio sorts branches by name; the robot's order is that of its chain."""
    poses = random_poses(kr120(), 30)
    order = [3, 0, 5, 1, 4, 2]
    turned = CollisionWorld(kr120(), clutter(), kr120_pairs())
    names = tuple(kr120().joint_names[index] for index in order)
    turned_robot = replace(kr120(), joint_names=names)
    other = CollisionWorld(turned_robot, clutter(), kr120_pairs())
    for q in poses:
        assert other.is_free(q[order]) == turned.is_free(q)
        assert other.clearance(q[order]).distance == pytest.approx(turned.clearance(q).distance, abs=1e-5)
    rows = np.linspace(poses[0], poses[1], 50)
    assert other.clearance_of(rows[:, order])[0].distance == pytest.approx(
        turned.clearance_of(rows)[0].distance, abs=1e-5
    )


def test_a_base_link_within_the_tree_is_the_scene_s_frame():
    """Objects stand in base_link wherever the URDF's root is."""
    urdf = kr120().urdf.replace('<link name="base_link"/>', '<link name="hall"/><link name="base_link"/>' + HALL)
    moved = CollisionWorld(replace(kr120(), urdf=urdf), clutter(), kr120_pairs())
    here = CollisionWorld(kr120(), clutter(), kr120_pairs())
    for q in random_poses(kr120(), 30):
        assert moved.is_free(q) == here.is_free(q)
        one, other = moved.clearance(q), here.clearance(q)
        assert one.distance == pytest.approx(other.distance, abs=1e-5)
        assert np.allclose(moved.link_pose(q, "tool0").position, here.link_pose(q, "tool0").position, atol=1e-12)


HALL = (
    '<joint name="hall-base" type="fixed"><parent link="hall"/><child link="base_link"/>'
    '<origin xyz="1 2 3" rpy="0.1 0.2 0.3"/></joint>'
)

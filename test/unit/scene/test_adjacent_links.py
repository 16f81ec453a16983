"""Only what a joint holds is adjacent: what is fixed further out can come back, and is checked."""

from __future__ import annotations

import pytest
from scene_samples import ROOT, kr120, track7, ur_like

from construction_twin.robot.description import RobotModel, load_robot
from construction_twin.robot.new_robot import new_description
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.collision_world import CollisionWorld, Contact
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import adjacent_links, sample_self_collision

_BOX = '<collision><origin xyz="{xyz}"/><geometry><box size="{size}"/></geometry></collision>'


def two_joints(second: str = _BOX.format(xyz="0.1 0 0", size="0.2 0.1 0.1")) -> RobotModel:
    """Return an arm in a plane, whose second link carries a bracket that reaches back over the first."""
    first = _BOX.format(xyz="0.5 0 0", size="0.9 0.1 0.1")
    bracket = _BOX.format(xyz="-0.6 0 0", size="0.1 0.1 0.1")
    limit = '<limit lower="-2" upper="2" velocity="1" effort="1"/>'
    urdf = f"""<robot name="flat"><link name="base"/><link name="one">{first}</link><link name="two">{second}</link>
        <link name="plate"/><link name="bracket">{bracket}</link>
        <joint name="j1" type="revolute"><parent link="base"/><child link="one"/><axis xyz="0 0 1"/>{limit}</joint>
        <joint name="j2" type="revolute"><parent link="one"/><child link="two"/><origin xyz="1 0 0"/>
            <axis xyz="0 0 1"/>{limit}</joint>
        <joint name="f1" type="fixed"><parent link="two"/><child link="plate"/></joint>
        <joint name="f2" type="fixed"><parent link="plate"/><child link="bracket"/></joint></robot>"""
    keys = {"home_deg": 0.0, "acceleration_deg_s2": 1.0, "jerk_deg_s3": 1.0, "sign": 1, "offset_deg": 0.0}
    joints = {"j1": keys | {"rsi": "A1"}, "j2": keys | {"rsi": "A2"}}
    return load_robot(urdf, {"name": "flat", "base_link": "base", "tip_link": "plate", "joints": joints})


def names(robot: RobotModel) -> set[tuple[str, ...]]:
    return {tuple(sorted(pair)) for pair in adjacent_links(RobotBodies(robot))}


def test_what_is_fixed_behind_a_link_is_not_held_by_its_joint():
    assert names(two_joints()) == {("one", "two")}


def test_a_link_without_a_shape_is_held_by_the_next_that_has_one():
    assert names(two_joints(second="")) == {("bracket", "one")}


def test_a_bracket_that_comes_back_is_a_contact():
    robot = two_joints()
    pairs = sample_self_collision(robot, samples=300)
    assert pairs.ignored == {frozenset(("one", "two")): "adjacent"}
    world = CollisionWorld(robot, Scene(), pairs)
    assert world.contacts((0.0, 0.0)) == [Contact(("one", "bracket"))]
    assert world.contacts((0.0, 1.5)) == []


@pytest.mark.parametrize(
    "robot, expected",
    [
        (kr120, {(f"link_{n}", f"link_{n + 1}") for n in range(6)} | {("link_3", "link_5"), ("link_4", "link_6")}),
        (
            track7,
            {(f"link_{n}", f"link_{n + 1}") for n in range(6)}
            | {("link_3", "link_5"), ("link_4", "link_6"), ("track_carriage", "track_rail")},
        ),
        (
            ur_like,
            {
                ("pedestal", "shoulder"), ("shoulder", "upper_arm"), ("forearm", "upper_arm"), ("forearm", "wrist_a"),
                ("wrist_a", "wrist_b"), ("wrist_b", "wrist_c"),
            },
        ),
    ],
    ids=["kr120", "track7", "ur_like"],
)  # fmt: skip
def test_of_known_arms(robot, expected):
    assert names(robot()) == expected


def balanced(piston_on: str = "lower_arm") -> RobotModel:
    """Return an arm whose shoulder a cylinder on the column and a piston follow."""
    urdf = (ROOT / "test/data/balanced_like.urdf").read_text()
    head, joint, tail = urdf.partition('<joint name="balance_piston"')
    urdf = head + joint + tail.replace('<parent link="lower_arm"/>', f'<parent link="{piston_on}"/>', 1)
    return load_robot(urdf, new_description(urdf, "balanced", "base_link", "tool0", 1.0))


def test_a_joint_and_those_that_follow_it_hold_what_is_on_them_together():
    """The cylinder and the arm, the column and the piston: the shoulder alone moves them against each other."""
    linkage = {("column", "cylinder"), ("column", "lower_arm"), ("column", "piston"), ("cylinder", "lower_arm")}
    linkage |= {("cylinder", "piston"), ("lower_arm", "piston")}
    found = names(balanced())
    assert linkage <= found
    assert {pair for pair in found - linkage if {"cylinder", "piston"} & set(pair)} == set()


def test_what_another_joint_moves_too_is_not_held_by_the_linkage():
    # a piston on the upper arm comes near the column with shoulder and elbow
    found = names(balanced(piston_on="upper_arm"))
    assert {pair for pair in found if "piston" in pair} == {("piston", "upper_arm")}
    assert ("cylinder", "lower_arm") in found

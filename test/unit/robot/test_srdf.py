"""The SRDF by the rules of srdfdom and MoveIt: whatever it names is in the URDF, and every pair of ours is in it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from urdf_parser_py.urdf import URDF

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.robot.planning_groups import end_effectors, planning_groups
from construction_twin.robot.srdf import REASONS, srdf
from construction_twin.robot.urdf import chain_joints, parse_urdf
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.collision_world import checked_pairs
from construction_twin.scene.self_collision import SelfCollision, read_self_collision
from construction_twin.scene.srdf_command import main as srdf_main

ROOT = Path(__file__).resolve().parents[3]
ROBOTS = {
    "kr120": ("urdf/kr120r2500.urdf.xacro", "config/kr120"),
    "kr120_track": ("urdf/kr120_track.urdf.xacro", "config/kr120_track"),
    "ur_like": ("test/data/ur_like.urdf", "test/data/ur_like"),
    "ur_like_gripper": ("test/data/ur_like_gripper.urdf.xacro", "test/data/ur_like_gripper"),
}


@dataclass(frozen=True)
class Described:
    """A robot, its pairs and its SRDF."""

    files: tuple[str, str, str]
    robot: RobotModel
    pairs: SelfCollision
    urdf: URDF
    root: ElementTree.Element

    def all(self, tag: str) -> list[dict]:
        return [element.attrib for element in self.root.findall(tag)]

    @property
    def disabled(self) -> dict[frozenset[str], str]:
        rows = self.all("disable_collisions")
        pairs = {frozenset((row["link1"], row["link2"])): row["reason"] for row in rows}
        assert len(pairs) == len(rows)
        return pairs


@pytest.fixture(scope="module", params=list(ROBOTS))
def described(request) -> Described:
    urdf, name = ROBOTS[request.param]
    files = (str(ROOT / urdf), str(ROOT / f"{name}.yaml"), str(ROOT / f"{name}_self_collision.yaml"))
    robot = read_robot_files(*files[:2])
    pairs = read_self_collision(files[2], robot)
    text = srdf(robot, pairs.ignored)
    return Described(files, robot, pairs, parse_urdf(robot.urdf), ElementTree.fromstring(text))


def test_it_is_the_urdf_s_robot(described):
    """MoveIt refuses the SRDF of another one."""
    assert described.root.tag == "robot" and described.root.get("name") == described.urdf.name


def test_every_link_and_joint_that_it_names_is_in_the_urdf(described):
    links, joints = set(described.urdf.link_map), set(described.urdf.joint_map)
    named = {
        value
        for element in described.root.iter()
        for key, value in element.attrib.items()
        if key in ("link", "link1", "link2", "base_link", "tip_link", "parent_link", "child_link")
        or (element.tag, key) == ("link", "name")
    }
    assert named and named <= links
    moved = [element.get("name") for tag in ("joint", "passive_joint") for element in described.root.iter(tag)]
    assert moved and set(moved) <= joints


def test_groups_are_chains_of_the_urdf_and_home_is_the_robot_yaml_s(described):
    groups = {group.get("name"): group.find("chain") for group in described.root.findall("group")}
    home = dict(zip(described.robot.joint_names, described.robot.home))
    states = {state.get("group"): state for state in described.root.findall("group_state")}
    for group in planning_groups(described.robot):
        chain = groups[group.name]
        assert chain is not None
        joints = chain_joints(described.urdf, chain.get("base_link"), chain.get("tip_link"))
        assert tuple(joint.name for joint in joints if joint.joint_type != "fixed") == group.joints
        assert states[group.name].get("name") == "home"
        values = {joint.get("name"): float(joint.get("value")) for joint in states[group.name]}
        assert values == pytest.approx({name: home[name] for name in group.joints}, abs=1e-11)
    assert len(states) == len(planning_groups(described.robot))


def test_the_virtual_joint_holds_the_root_of_the_tree(described):
    (joint,) = described.all("virtual_joint")
    assert joint["child_link"] == described.urdf.get_root()
    assert (joint["type"], joint["parent_frame"]) == ("fixed", "world")


def test_an_end_effector_hangs_on_its_parent_group_and_shares_no_link_with_it(described):
    groups = {group.get("name"): group for group in described.root.findall("group")}
    for effector in described.all("end_effector"):
        parent = groups[effector["parent_group"]].find("chain")
        assert parent is not None
        chain = chain_joints(described.urdf, parent.get("base_link"), parent.get("tip_link"))
        arm = {parent.get("base_link"), *(joint.child for joint in chain)}
        tool = {link.get("name") for link in groups[effector["group"]].findall("link")}
        assert effector["parent_link"] in arm and tool and not tool & arm


def test_every_pair_of_ours_is_in_it_with_moveit_s_reason(described):
    disabled = described.disabled
    assert described.pairs.ignored
    for pair, reason in described.pairs.ignored.items():
        assert disabled[pair] == REASONS[reason]
    assert set(disabled.values()) <= {"Adjacent", "Always", "Never", "User", "Default"}


def test_moveit_checks_the_pairs_of_links_that_we_check(described):
    """Its allowed collision matrix, built as MoveIt builds it: defaults, then enabled pairs, then disabled ones."""
    defaults = {row["link"] for row in described.all("disable_default_collisions")}
    enabled = {frozenset((row["link1"], row["link2"])) for row in described.all("enable_collisions")}
    disabled = described.disabled
    assert not enabled & set(disabled)
    links = [link.name for link in described.urdf.links if link.collisions]
    theirs = {
        pair
        for pair in map(frozenset, combinations(links, 2))
        if pair not in disabled and (pair in enabled or not pair & defaults)
    }
    bodies = RobotBodies(described.robot).bodies
    ours = {
        frozenset((bodies[one].owner, bodies[other].owner))
        for one, other, _ in checked_pairs(bodies, 0.0, described.pairs)
    }
    assert theirs == ours


def test_links_that_nothing_moves_may_stand_on_objects(described):
    bodies = RobotBodies(described.robot).bodies
    still = {body.owner for body in bodies if body.joint == 0}
    assert {row["link"] for row in described.all("disable_default_collisions")} == still


def test_the_command_writes_what_the_library_makes(described, tmp_path, capsys):
    made = srdf(described.robot, described.pairs.ignored)
    srdf_main(list(described.files))
    assert capsys.readouterr().out == made
    srdf_main([*described.files, str(tmp_path / "robot.srdf")])
    assert (tmp_path / "robot.srdf").read_text() == made


def robot_of(name: str) -> RobotModel:
    urdf, files = ROBOTS[name]
    return read_robot_files(ROOT / urdf, ROOT / f"{files}.yaml")


def test_the_arm_on_its_track_has_a_group_with_and_one_without_the_rail():
    arm, both = planning_groups(robot_of("kr120_track"))
    assert (arm.name, arm.base_link, arm.joints[0]) == ("manipulator", "base_link", "joint_a1")
    assert (both.name, both.base_link, both.joints[:2]) == ("manipulator_track", "track_base", ("track", "joint_a1"))
    (alone,) = planning_groups(robot_of("kr120"))
    assert (alone.name, alone.base_link, alone.tip_link) == ("manipulator", "base_link", "tool0")


def test_a_gripper_is_an_end_effector_whose_fingers_nobody_plans_for():
    robot = robot_of("ur_like_gripper")
    (gripper,) = end_effectors(robot)
    assert (gripper.parent_link, gripper.links) == ("tool0", ("palm", "finger_left", "finger_right", "camera"))
    root = ElementTree.fromstring(srdf(robot, {}))
    # the right finger is a mimic joint: MoveIt moves it with the left one
    assert [joint.get("name") for joint in root.findall("passive_joint")] == ["slide_left", "hinge"]


def test_frames_without_a_shape_are_no_end_effector():
    assert end_effectors(robot_of("kr120")) == () == end_effectors(robot_of("ur_like"))


@pytest.mark.parametrize(
    "ignored, found",
    [
        ({frozenset(("link_1", "link_9")): "never"}, "link_9"),
        ({frozenset(("link_1", "link_2")): "often"}, "often"),
    ],
)
def test_pairs_of_another_robot_are_refused(ignored, found):
    with pytest.raises(ConfigurationError) as refused:
        srdf(replace(robot_of("kr120")), ignored)
    assert found in str(refused.value)


@pytest.mark.parametrize("number, file", list(enumerate(("no.urdf", "no.yaml", "no_pairs.yaml"))))
def test_a_file_that_is_not_there_is_one_sentence(number, file, described):
    files = list(described.files)
    files[number] = f"/no/{file}"
    with pytest.raises(SystemExit) as ended:
        srdf_main(files)
    assert str(ended.value).startswith("srdf: ") and file in str(ended.value)


def test_the_pairs_are_read_as_a_whole(tmp_path):
    urdf, name = ROBOTS["kr120"]
    description = yaml.safe_load((ROOT / f"{name}_self_collision.yaml").read_text()) | {
        "ignored": [["link_0", "link_1"]]
    }
    file = tmp_path / "pairs.yaml"
    file.write_text(yaml.safe_dump(description))
    with pytest.raises(SystemExit) as ended:
        srdf_main([str(ROOT / urdf), str(ROOT / f"{name}.yaml"), str(file)])
    assert f"{file} ignored/0" in str(ended.value)

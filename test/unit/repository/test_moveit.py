"""The folder moveit/: its limits and pairs of links are ours. MoveIt is not installed here."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree

import launch_files
import pytest
import yaml

from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.robot.urdf import parse_urdf
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.pair_checks import checked_pairs
from construction_twin.scene.self_collision import read_self_collision

ROOT = Path(__file__).resolve().parents[3]
MOVEIT = ROOT / "moveit"
XACROS = {"kr120": "urdf/kr120r2500.urdf.xacro", "kr120_track": "urdf/kr120_track.urdf.xacro"}
OURS = tuple(XACROS)
#: MoveIt's word for each reason of a self_collision file.
REASONS = {"adjacent": "Adjacent", "always": "Always", "never": "Never"}

#: Keys of a joint that MoveIt or Pilz reads, of a controller's entry, of a solver, of Cartesian limits.
LIMIT_KEYS = {
    "has_position_limits", "min_position", "max_position", "has_velocity_limits", "max_velocity", "has_acceleration_limits",
    "max_acceleration",
}  # fmt: skip


def robot_of(name: str) -> RobotModel:
    return read_robot_files(ROOT / XACROS[name], ROOT / f"config/{name}.yaml")


def srdf_of(name: str) -> ElementTree.Element:
    return ElementTree.parse(MOVEIT / "config" / name / "robot.srdf").getroot()


def pairs_of(root: ElementTree.Element, tag: str) -> dict[frozenset[str], str]:
    rows = [row.attrib for row in root.findall(tag)]
    pairs = {frozenset((row["link1"], row["link2"])): row.get("reason", "") for row in rows}
    assert len(pairs) == len(rows)
    return pairs


@pytest.mark.parametrize("name", OURS)
def test_joint_limits_are_the_robot_s(name):
    robot = robot_of(name)
    limits = yaml.safe_load((MOVEIT / "config" / name / "joint_limits.yaml").read_text())
    assert set(limits) == {"default_velocity_scaling_factor", "default_acceleration_scaling_factor", "joint_limits"}
    joints = limits["joint_limits"]
    assert list(joints) == list(robot.joint_names)
    for index, entry in enumerate(joints.values()):
        assert set(entry) == LIMIT_KEYS
        assert (entry["min_position"], entry["max_position"]) == (robot.lower[index], robot.upper[index])
        assert (entry["max_velocity"], entry["max_acceleration"]) == (robot.velocity[index], robot.acceleration[index])


@pytest.mark.parametrize("name", OURS)
def test_disabled_pairs_are_those_of_the_self_collision_file(name):
    """Besides them only pairs of links that nothing moves against each other, which our check leaves out by itself."""
    robot = robot_of(name)
    ignored = read_self_collision(ROOT / f"config/{name}_self_collision.yaml", robot).ignored
    disabled = pairs_of(srdf_of(name), "disable_collisions")
    assert {pair: disabled.get(pair) for pair in ignored} == {pair: REASONS[ignored[pair]] for pair in ignored}
    joint = {body.owner: body.joint for body in RobotBodies(robot).bodies}
    assert all(len({joint[link] for link in pair}) == 1 for pair in set(disabled) - set(ignored))


@pytest.mark.parametrize("name", OURS)
def test_moveit_checks_the_pairs_of_links_that_we_check(name):
    """Its allowed collision matrix, built as MoveIt builds it: defaults, then enabled pairs, then disabled ones."""
    robot, root = robot_of(name), srdf_of(name)
    bodies = RobotBodies(robot).bodies
    defaults = {row.get("link") for row in root.findall("disable_default_collisions")}
    # they may stand on objects
    assert defaults == {body.owner for body in bodies if body.joint == 0}
    enabled, disabled = set(pairs_of(root, "enable_collisions")), set(pairs_of(root, "disable_collisions"))
    assert not enabled & disabled
    links = [link.name for link in parse_urdf(robot.urdf).links if link.collisions]
    theirs = {
        pair
        for pair in map(frozenset, combinations(links, 2))
        if pair not in disabled and (pair in enabled or not pair & defaults)
    }
    pairs = read_self_collision(ROOT / f"config/{name}_self_collision.yaml", robot)
    ours = {frozenset((bodies[one].owner, bodies[other].owner)) for one, other, _ in checked_pairs(bodies, 0.0, pairs)}
    assert theirs == ours


def test_the_srdf_is_the_one_of_bringup():
    for name, words in (("kr120", []), ("kr120_track", ["track:=true"])):
        loaded = launch_files.parameters("bringup", *words)["/kr120/robot_description_semantic"]
        assert loaded == (MOVEIT / "config" / name / "robot.srdf").read_text()

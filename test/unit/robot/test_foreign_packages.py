"""An arm of a package that lies elsewhere: `$(find ...)`, arguments and package:// meshes, by library and launch files."""

from __future__ import annotations

import os
from xml.etree import ElementTree

import numpy as np
import pytest
from foreign_packages import BOXES, JOINTS, lay_out, robot_yaml

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.share import share_file
from construction_twin.kinematics.chain import Chain
from construction_twin.robot.description import read_robot_files
from construction_twin.robot.packages import Packages
from construction_twin.robot.urdf import expand_xacro, xacro_arguments
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.collision_world import CollisionWorld, Contact
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.self_collision import SelfCollision


@pytest.fixture
def xacro(tmp_path, monkeypatch):
    """The arm's xacro; its workspace is in ROS_PACKAGE_PATH ahead of what was there."""
    path = lay_out(tmp_path)
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"{tmp_path / 'src'}{os.pathsep}{os.environ['ROS_PACKAGE_PATH']}")
    return path


def movable(urdf: str) -> list[str]:
    robot = ElementTree.fromstring(urdf)
    return [joint.get("name") for joint in robot.iter("joint") if joint.get("type") == "revolute"]


def refused(*arguments) -> ConfigurationError:
    with pytest.raises(ConfigurationError) as caught:
        expand_xacro(*arguments)
    return caught.value


def test_macros_of_other_packages_are_found_by_rospack(xacro):
    urdf = expand_xacro(xacro)
    assert movable(urdf) == list(JOINTS)
    robot = ElementTree.fromstring(urdf)
    assert {color.get("rgba") for color in robot.iter("color")} == {"1 0.36 0.13 1"}
    assert float(robot.find("joint/limit").get("upper")) == pytest.approx(np.radians(185))


def test_a_package_has_the_name_of_its_manifest_whatever_its_folder_is_called(xacro, tmp_path):
    folder = tmp_path / "src" / "kuka_experimental" / "kuka_resources"
    folder.rename(folder.with_name("resources-melodic-devel"))
    assert movable(expand_xacro(xacro)) == list(JOINTS)


def test_a_package_that_is_not_there_is_named_with_the_file_that_asks_and_where_it_was_sought(xacro, tmp_path):
    folder = tmp_path / "src" / "kuka_experimental" / "kuka_resources"
    folder.rename(tmp_path / "elsewhere")
    error = refused(xacro)
    assert error.where == f"{xacro.with_name('kr210l150_macro.xacro')} $(find kuka_resources)"
    assert error.value == "no ROS package 'kuka_resources'"
    assert str(tmp_path / "src") in error.expected and "source the workspace that holds it" in error.expected


def test_this_package_is_found_without_ros_too(monkeypatch):
    monkeypatch.setenv("ROS_PACKAGE_PATH", "")
    uri = "package://construction_twin/urdf/kr120r2500.urdf.xacro"
    assert Packages().file(uri, "x") == share_file("urdf/kr120r2500.urdf.xacro")
    with pytest.raises(ConfigurationError, match="no ROS package 'nowhere'"):
        Packages().folder("nowhere", "x")


def test_arguments_reach_the_xacro(xacro, tmp_path):
    urdf = expand_xacro(xacro, xacro_arguments("prefix:=left_ reach=1.5"))
    assert movable(urdf) == [f"left_{name}" for name in JOINTS]
    short = read_robot_files(xacro, robot_yaml(tmp_path))
    long = read_robot_files(xacro, robot_yaml(tmp_path, "left_"), "prefix=left_ reach=1.5")
    assert long.tip_link == "left_tool0"
    assert Chain(long).reach - Chain(short).reach == pytest.approx(0.4, abs=1e-3)


def test_an_argument_that_the_xacro_does_not_have_is_refused_with_those_it_has(xacro):
    error = refused(xacro, {"prefx": "left_"})
    assert (error.where, error.value) == (f"{xacro} argument", "prefx")
    assert "['prefix', 'reach']" in error.expected


@pytest.mark.parametrize(
    "text, arguments",
    [
        ("", {}),
        ("a=1  b:=2", {"a": "1", "b": "2"}),
        ("tool='my tool' file=/a=b.yaml", {"tool": "my tool", "file": "/a=b.yaml"}),
        ("prefix=", {"prefix": ""}),
    ],
)
def test_arguments_are_words_quoted_as_in_a_shell(text, arguments):
    assert xacro_arguments(text) == arguments


def test_meshes_of_nested_packages_are_collision_shapes(xacro, tmp_path):
    robot = read_robot_files(xacro, robot_yaml(tmp_path))
    assert [body.link for body in RobotBodies(robot).bodies] == list(BOXES)
    wall = SceneObject("wall", "box", (0.1, 2.0, 2.0), (2.0, 0.0, 1.0))
    world = CollisionWorld(robot, Scene((wall,)), SelfCollision({}, ""))
    assert Contact(("link_3", "wall")) in world.contacts((0.0, -0.1, 0.1, 0.0, 0.0, 0.0))
    assert Contact(("link_3", "wall")) not in world.contacts(robot.home)
    # rviz finds the pictures' meshes itself, wherever it runs
    assert "package://kuka_kr210_support/meshes" in robot.urdf


@pytest.mark.parametrize(
    "uri, expected",
    [
        ("package://kuka_kr210_support/none.stl", "a file; there is no {src}/kuka_experimental/kuka_kr210_support/none.stl"),
        ("package://kuka_other/link_1.stl", "one below a folder of ROS_PACKAGE_PATH ("),
        ("meshes/link_1.stl", "package://<package>/<path>, file:///<path> or an absolute path"),
        ("http://somewhere/link_1.stl", "package://<package>/<path>, file:///<path> or an absolute path"),
    ],
)  # fmt: skip
def test_a_mesh_that_is_not_there_names_its_link(xacro, tmp_path, uri, expected):
    macro = xacro.with_name("kr210l150_macro.xacro")
    text = macro.read_text().replace(
        '<collision><geometry><mesh filename="package://kuka_kr210_support/meshes/kr210l150/collision/link_1.stl"',
        f'<collision><geometry><mesh filename="{uri}"',
    )
    assert text != macro.read_text()
    macro.write_text(text)
    robot = read_robot_files(xacro, robot_yaml(tmp_path))
    with pytest.raises(ConfigurationError) as caught:
        RobotBodies(robot)
    assert caught.value.where.startswith("URDF link link_1 collision mesh")
    assert caught.value.expected.startswith(expected.format(src=tmp_path / "src"))

"""An arm of a package that lies elsewhere: `$(find ...)`, arguments and package:// meshes, by library and launch files."""

from __future__ import annotations

import os
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.share import share_file
from construction_twin.kinematics.chain import Chain
from construction_twin.robot.description import read_robot_files
from construction_twin.robot.packages import Packages
from construction_twin.robot.urdf import expand_xacro, xacro_arguments
from construction_twin.ros.nodes.scene import lasting_contacts
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.collision_world import CollisionWorld, Contact
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.self_collision import SelfCollision

JOINTS = tuple(f"joint_a{number}" for number in range(1, 7))
#: Of each joint: origin in its parent [m], axis, lower and upper [deg], speed [deg/s].
_JOINTS = {
    "joint_a1": ("0 0 0.675", "0 0 -1", -185, 185, 123),
    "joint_a2": ("0.35 0 0", "0 1 0", -140, -5, 115),
    "joint_a3": ("1.25 0 0", "0 1 0", -120, 155, 112),
    "joint_a4": ("1.1 0 -0.041", "-1 0 0", -350, 350, 179),
    "joint_a5": ("0 0 0", "0 1 0", -122.5, 122.5, 172),
    "joint_a6": ("0 0 0", "-1 0 0", -350, 350, 219),
}
#: Lower and upper corner of each link's box [m].
BOXES = {
    "base_link": ((-0.5, -0.4, 0.0), (0.4, 0.4, 0.3)),
    "link_1": ((-0.3, -0.3, -0.3), (0.5, 0.3, 0.2)),
    "link_2": ((-0.1, -0.35, -0.15), (1.3, -0.15, 0.15)),
    "link_3": ((-0.2, -0.1, -0.2), (0.6, 0.15, 0.15)),
    "link_4": ((-0.4, -0.12, -0.12), (-0.1, 0.12, 0.12)),
    "link_5": ((-0.08, -0.1, -0.1), (0.15, 0.1, 0.1)),
    "link_6": ((0.16, -0.08, -0.08), (0.23, 0.08, 0.08)),
}
_XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'


def lay_out(folder: Path) -> Path:
    """Write the workspace's ``src`` below a folder; return the xacro to start from."""
    repository = folder / "src" / "kuka_experimental"
    _package(repository / "kuka_experimental", "kuka_experimental", "<export><metapackage/></export>")
    resources = _package(repository / "kuka_resources", "kuka_resources")
    support = _package(repository / "kuka_kr210_support", "kuka_kr210_support")
    (resources / "urdf").mkdir()
    (resources / "urdf" / "common_constants.xacro").write_text(
        f'<robot {_XACRO}><xacro:property name="degree" value="${{pi/180}}"/></robot>'
    )
    (resources / "urdf" / "common_materials.xacro").write_text(
        f'<robot {_XACRO}><xacro:include filename="$(find kuka_resources)/urdf/common_constants.xacro"/>'
        '<xacro:macro name="material_kuka_orange"><material name=""><color rgba="1 0.36 0.13 1"/></material></xacro:macro>'
        "</robot>"
    )
    (support / "urdf").mkdir()
    (support / "urdf" / "kr210l150_macro.xacro").write_text(_macro())
    meshes = support / "meshes" / "kr210l150" / "collision"
    meshes.mkdir(parents=True)
    for link, (low, high) in BOXES.items():
        (meshes / f"{link}.stl").write_text(box_stl(low, high))
    top = support / "urdf" / "kr210l150.xacro"
    top.write_text(
        f'<robot name="kuka_kr210l150" {_XACRO}>'
        '<xacro:arg name="prefix" default=""/><xacro:arg name="reach" default="1.1"/>'
        '<xacro:include filename="$(find kuka_kr210_support)/urdf/kr210l150_macro.xacro"/>'
        '<xacro:kuka_kr210l150 prefix="$(arg prefix)" reach="$(arg reach)"/>'
        "</robot>"
    )
    return top


def robot_yaml(folder: Path, prefix: str = "") -> Path:
    """Write the robot YAML of the arm; return it."""
    home = (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)
    joints = {
        prefix + name: {
            "home_deg": angle, "acceleration_deg_s2": 200.0, "jerk_deg_s3": 2000.0,
            "rsi": f"A{name[-1]}", "sign": 1, "offset_deg": 0.0,
        }
        for name, angle in zip(JOINTS, home)
    }  # fmt: skip
    path = folder / f"{prefix}kr210.yaml"
    names = {"base_link": f"{prefix}base_link", "tip_link": f"{prefix}tool0"}
    path.write_text(yaml.safe_dump({"name": "kr210", **names, "joints": joints}))
    return path


def box_stl(low: tuple[float, ...], high: tuple[float, ...]) -> str:
    """Return a box as an STL file, its twelve triangles turned outwards."""
    (a, b, c), (d, e, f) = low, high
    corners = [(a, b, c), (d, b, c), (d, e, c), (a, e, c), (a, b, f), (d, b, f), (d, e, f), (a, e, f)]
    quads = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    lines = ["solid box"]
    for first, second, third, fourth in quads:
        for triangle in ((first, second, third), (first, third, fourth)):
            vertices = (f"vertex {x} {y} {z}" for x, y, z in (corners[index] for index in triangle))
            lines += ["facet normal 0 0 0", "outer loop", *vertices, "endloop", "endfacet"]
    return "\n".join([*lines, "endsolid box", ""])


def _package(folder: Path, name: str, rest: str = "") -> Path:
    folder.mkdir(parents=True)
    (folder / "package.xml").write_text(
        f'<?xml version="1.0"?><package format="2"><name>{name}</name><version>0.1.0</version>'
        f"<description>For a test</description><maintainer email='a@b.c'>A</maintainer><license>BSD</license>{rest}</package>"
    )
    return folder


def _macro() -> str:
    lines = [
        f"<robot {_XACRO}>",
        '<xacro:include filename="$(find kuka_resources)/urdf/common_materials.xacro"/>',
        '<xacro:macro name="kuka_kr210l150" params="prefix reach">',
    ]
    for link in BOXES:
        mesh = f'<geometry><mesh filename="package://kuka_kr210_support/meshes/kr210l150/collision/{link}.stl"/></geometry>'
        colour = "<xacro:material_kuka_orange/>"
        lines.append(
            f'<link name="${{prefix}}{link}"><visual>{mesh}{colour}</visual><collision>{mesh}</collision></link>'
        )
    parent = "base_link"
    for number, (name, (xyz, axis, lower, upper, speed)) in enumerate(_JOINTS.items(), 1):
        xyz = xyz.replace("1.1 ", "${reach} ")
        lines.append(
            f'<joint name="${{prefix}}{name}" type="revolute"><parent link="${{prefix}}{parent}"/>'
            f'<child link="${{prefix}}link_{number}"/><origin xyz="{xyz}" rpy="0 0 0"/><axis xyz="{axis}"/>'
            f'<limit lower="${{{lower}*degree}}" upper="${{{upper}*degree}}" velocity="${{{speed}*degree}}" effort="0"/></joint>'
        )
        parent = f"link_{number}"
    lines.append(
        '<link name="${prefix}tool0"/><joint name="${prefix}joint_a6-tool0" type="fixed">'
        '<parent link="${prefix}link_6"/><child link="${prefix}tool0"/><origin xyz="0.23 0 0" rpy="0 ${pi/2} 0"/></joint>'
    )
    return "\n".join([*lines, "</xacro:macro>", "</robot>"])


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
        ("meshes/link_1.stl", "a file; there is no {src}/kuka_experimental/kuka_kr210_support/urdf/meshes/link_1.stl"),
        ("http://somewhere/link_1.stl", "package://<package>/<path>, file:///<path> or a path relative to the URDF"),
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


def test_a_base_of_meshes_that_stands_in_the_floor_is_measured_too(xacro, tmp_path):
    ground = SceneObject("floor", "box", (20.0, 20.0, 1.0), (0.0, 0.0, -0.48), fixed=True)
    robot = read_robot_files(xacro, robot_yaml(tmp_path))
    (contact,) = lasting_contacts(CollisionWorld(robot, Scene((ground,)), SelfCollision({}, "")))
    assert (contact.link, contact.moves) == ("base_link", False)
    assert contact.distance == pytest.approx(-0.02, abs=1e-6)

"""Another maker's arm in a workspace of its own, laid out as ROS-Industrial's repositories are: several packages in one repository.

::

    src/kuka_experimental/kuka_experimental/          metapackage
    src/kuka_experimental/kuka_resources/             colours and constants, included by $(find kuka_resources)
    src/kuka_experimental/kuka_kr210_support/         the arm: urdf/*.xacro, meshes/kr210l150/collision/*.stl by package://

Figures are round numbers near those of the arm; meshes are boxes.
"""

from __future__ import annotations

from pathlib import Path

import yaml

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

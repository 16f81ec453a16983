"""The proposal of hulls encloses its meshes, says what it adds, and is a URDF that can be taken as it is."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scene_samples import ROOT, kr120, random_poses

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.robot.urdf import read_text
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.mesh_file import binary_stl, parse_mesh
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import SelfCollision
from construction_twin.scene.self_collision_command import main, propose_hulls

#: Joint: parent, child, origin [m], axis, range [rad], speed [rad/s].
_TURN = 2 * math.pi
JOINTS = (
    ("pan", "base_link", "shoulder", (0.0, 0.0, 0.13), "0 0 1", _TURN, 2.1),
    ("lift", "shoulder", "upper_arm", (0.0, 0.22, 0.0), "0 1 0", _TURN, 2.1),
    ("elbow", "upper_arm", "forearm", (0.61, -0.17, 0.0), "0 1 0", math.pi, 3.1),
    ("wrist_1", "forearm", "wrist_a", (0.57, 0.0, 0.0), "0 1 0", _TURN, 3.1),
    ("wrist_2", "wrist_a", "wrist_b", (0.0, 0.12, 0.0), "0 0 1", _TURN, 3.1),
    ("wrist_3", "wrist_b", "wrist_c", (0.0, 0.0, 0.12), "0 1 0", _TURN, 3.1),
)
#: Link: outline of its mesh as (from, to, radius) of round tubes [m].
TUBES = {
    "base_link": (((0.0, 0.0, 0.0), (0.0, 0.0, 0.05), 0.095),),
    "shoulder": (((0.0, 0.0, -0.07), (0.0, 0.0, 0.07), 0.08), ((0.0, 0.0, 0.0), (0.0, 0.13, 0.0), 0.075)),
    "upper_arm": (
        ((0.0, -0.08, 0.0), (0.0, 0.08, 0.0), 0.075),
        ((0.0, 0.0, 0.0), (0.61, 0.0, 0.0), 0.055),
        ((0.61, -0.08, 0.0), (0.61, 0.06, 0.0), 0.065),
    ),
    "forearm": (
        ((0.0, -0.06, 0.0), (0.0, 0.06, 0.0), 0.06),
        ((0.0, 0.0, 0.0), (0.57, 0.0, 0.0), 0.045),
        ((0.57, -0.05, 0.0), (0.57, 0.05, 0.0), 0.05),
    ),
    "wrist_a": (((0.0, 0.0, 0.0), (0.0, 0.12, 0.0), 0.045), ((0.0, 0.12, -0.05), (0.0, 0.12, 0.05), 0.045)),
    "wrist_b": (((0.0, 0.0, 0.0), (0.0, 0.0, 0.12), 0.045), ((0.0, -0.05, 0.12), (0.0, 0.05, 0.12), 0.045)),
    "wrist_c": (((0.0, 0.05, 0.0), (0.0, 0.09, 0.0), 0.04),),
}  # fmt: skip


def tube(start, end, radius: float, sides: int, rings: int) -> np.ndarray:
    """Return the triangles of a closed round tube, counterclockwise seen from outside, shape (t, 3, 3) [m]."""
    start, end = np.array(start), np.array(end)
    along = (end - start) / np.linalg.norm(end - start)
    across = np.cross(along, (1.0, 0.0, 0.0) if abs(along[0]) < 0.9 else (0.0, 1.0, 0.0))
    across /= np.linalg.norm(across)
    angles = np.linspace(0.0, 2 * np.pi, sides, endpoint=False)
    circle = radius * (np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * np.cross(along, across))
    levels = [start + (end - start) * part + circle for part in np.linspace(0.0, 1.0, rings + 1)]
    triangles = []
    for low, high in zip(levels, levels[1:]):
        for one in range(sides):
            two = (one + 1) % sides
            triangles += [(low[one], low[two], high[two]), (low[one], high[two], high[one])]
    for one in range(sides):
        two = (one + 1) % sides
        triangles += [(start, levels[0][two], levels[0][one]), (end, levels[-1][one], levels[-1][two])]
    return np.array(triangles)


def write_binary_stl(path: Path, triangles: np.ndarray) -> str:
    """Write triangles, shape (t, 3, 3) [m], as a binary STL file; return its path."""
    rows = np.zeros(len(triangles), np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]))
    rows["corners"] = triangles
    path.write_bytes(bytes(80) + len(rows).to_bytes(4, "little") + rows.tobytes())
    return str(path)


def write_mesh_arm(folder: Path, sides: int = 24, rings: int = 6) -> Path:
    """Write the arm's meshes and its URDF into a folder; return the URDF's path. A tube has 2 * sides * (rings + 1) triangles."""
    links = []
    for link, tubes in TUBES.items():
        triangles = np.concatenate([tube(*each, sides, rings) for each in tubes])
        path = write_binary_stl(folder / f"{link}.stl", triangles)
        shape = f'<geometry><mesh filename="file://{path}"/></geometry>'
        links.append(f'  <link name="{link}"><visual>{shape}</visual><collision>{shape}</collision></link>')
    joints = [
        f'  <joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{" ".join(map(str, origin))}"/><axis xyz="{axis}"/>'
        f'<limit lower="{-end}" upper="{end}" velocity="{speed}" effort="100"/></joint>'
        for name, parent, child, origin, axis, end, speed in JOINTS
    ]
    flange = (
        '  <link name="tool0"/>\n  <joint name="flange" type="fixed"><parent link="wrist_c"/><child link="tool0"/>'
        '<origin xyz="0 0.09 0" rpy="-1.5707963267948966 0 0"/></joint>'
    )
    path = folder / "mesh_arm.urdf"
    path.write_text("\n".join(['<robot name="mesh_arm">', *links, *joints, flange, "</robot>", ""]))
    return path


def arm(folder) -> RobotModel:
    return read_robot_files(write_mesh_arm(folder), write_robot_yaml(folder))


def write_robot_yaml(folder):
    text = read_text(ROOT / "test/data/ur_like.yaml").replace("name: ur_like", "name: mesh_arm")
    path = folder / "mesh_arm.yaml"
    path.write_text(text)
    return path


def test_hulls_are_proposed_for_meshes_that_are_not_convex_only(tmp_path):
    said, *lines = propose_hulls(arm(tmp_path), tmp_path / "hulls")
    # base and flange are one convex tube each
    links = {link for link, tubes in TUBES.items() if len(tubes) > 1}
    assert {line.split()[0] for line in lines} == links and f"in place of {len(links)} meshes" in said
    (upper_arm,) = (line for line in lines if "upper_arm" in line)
    # the three tubes of the upper arm, without what they share, and the hull around them
    assert upper_arm.startswith(f"  upper_arm 0: {3 * 2 * 24 * 7} -> ")
    words = upper_arm.split()
    more, volume = float(words[-8]), float(words[-4])
    assert 8.5 < volume < 10.5 and 4 < more < 8
    assert propose_hulls(kr120(), tmp_path / "none") == [] and not (tmp_path / "none").exists()


def test_the_proposal_is_a_urdf_whose_links_enclose_the_meshes(tmp_path):
    robot = arm(tmp_path)
    propose_hulls(robot, tmp_path / "hulls")
    proposed = replace(robot, urdf=read_text(tmp_path / "hulls" / "robot.urdf"))
    assert propose_hulls(proposed, tmp_path / "again") == []
    before, after = (CollisionWorld(each, Scene(), SelfCollision({}, "")) for each in (robot, proposed))
    freed = 0
    for q in random_poses(robot, 150):
        was, now = ({frozenset(contact.between) for contact in world.contacts(q)} for world in (before, after))
        assert was <= now
        freed += was < now
    assert freed
    # only the collision shapes are others
    assert proposed.urdf.count("<visual>") == robot.urdf.count("<visual>")
    # a file looks outwards
    contents = (tmp_path / "hulls" / "forearm_0.stl").read_bytes()
    vertices, triangles = parse_mesh("hull", "hull.stl", contents, (1.0, 1.0, 1.0))
    first, second, third = (vertices[triangles[:, corner]] for corner in range(3))
    assert np.einsum("ij,ij->", first, np.cross(second, third)) / 6.0 > 1e-3


def test_what_a_hull_adds_to_an_open_mesh_is_unknown(tmp_path):
    robot = arm(tmp_path)
    whole = (tmp_path / "forearm.stl").read_bytes()
    # the last triangles are missing
    count = int.from_bytes(whole[80:84], "little") - 9
    (tmp_path / "forearm.stl").write_bytes(whole[:80] + count.to_bytes(4, "little") + whole[84:-450])
    (line,) = (line for line in propose_hulls(robot, tmp_path / "hulls") if "forearm" in line)
    assert line.endswith("? l more, the mesh is not closed")


def test_a_mesh_without_a_volume_is_refused_by_name(tmp_path):
    robot = arm(tmp_path)
    flat = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0], [0, 1, 0]]], dtype=float)
    (tmp_path / "forearm.stl").write_bytes(binary_stl(flat))
    with pytest.raises(ConfigurationError, match="URDF link forearm collision mesh"):
        propose_hulls(robot, tmp_path / "hulls")


def test_a_mesh_arm_with_its_proposal_of_hulls_beside_the_file(tmp_path, capsys):
    urdf, robot_yaml, output = write_mesh_arm(tmp_path), write_robot_yaml(tmp_path), tmp_path / "my_self_collision.yaml"
    main([str(urdf), str(robot_yaml), str(output), "--samples", "2000"])
    said = capsys.readouterr()
    assert said.out.startswith(f"{output}: 6 pairs left out, geometry ")
    proposal = tmp_path / "my_hulls" / "robot.urdf"
    assert f"{proposal}: a proposal, convex hulls in place of 5 meshes" in said.out
    assert all(f"\n  {link} " in said.out for link in ("shoulder", "upper_arm", "forearm", "wrist_a", "wrist_b"))
    assert said.err == "sampling 2000 poses\n"
    # it is a URDF that every command takes; what was found for the meshes does not hold for it
    assert read_robot_files(proposal, robot_yaml).joint_names == read_robot_files(urdf, robot_yaml).joint_names
    main([str(proposal), str(robot_yaml), "-", "--samples", "300"])
    assert "geometry: " + output.read_text().split("geometry: ")[1][:64] not in capsys.readouterr().out

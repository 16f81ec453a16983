"""The proposal of hulls encloses its meshes, says what it adds, and is a URDF that can be taken as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mesh_arm import TUBES, write_mesh_arm
from scene_samples import ROOT, kr120, random_poses

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.robot.urdf import read_text
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.mesh_file import binary_stl, parse_mesh
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import SelfCollision
from construction_twin.scene.self_collision_command import propose_hulls


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

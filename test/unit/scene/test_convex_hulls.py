"""scene.convex_hulls: the proposal encloses its meshes, says what it adds, and is a URDF that can be taken as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mesh_arm import TUBES, write_mesh_arm
from scene_samples import ROOT, kr120, random_poses

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.robot.urdf import read_text
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.mesh_file import binary_stl, parse_mesh
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import SelfCollision
from construction_twin.scene.self_collision_command import (
    hull_lines,
    mesh_hulls,
    write_proposal,
)


def arm(folder) -> RobotModel:
    return read_robot_files(write_mesh_arm(folder), write_robot_yaml(folder))


def write_robot_yaml(folder):
    text = read_text(ROOT / "test/data/ur_like.yaml").replace("name: ur_like", "name: mesh_arm")
    path = folder / "mesh_arm.yaml"
    path.write_text(text)
    return path


def test_hulls_are_proposed_for_meshes_that_are_not_convex_only(tmp_path):
    hulls = {hull.link: hull for hull in mesh_hulls(RobotBodies(arm(tmp_path)))}
    # base and flange are one convex tube each
    assert set(hulls) == {link for link, tubes in TUBES.items() if len(tubes) > 1}
    assert mesh_hulls(RobotBodies(kr120())) == []
    upper_arm = hulls["upper_arm"]
    assert upper_arm.triangles == 3 * 2 * 24 * 7 and len(upper_arm.faces) < 200
    # the three tubes of the upper arm, without what they share, and the hull around them
    assert 0.0085 < upper_arm.volume < 0.0105 and 0.004 < upper_arm.hull_volume - upper_arm.volume < 0.008


def test_the_proposal_is_a_urdf_whose_links_enclose_the_meshes(tmp_path):
    robot = arm(tmp_path)
    hulls = mesh_hulls(RobotBodies(robot))
    path = write_proposal(robot.urdf, hulls, tmp_path / "hulls")
    proposed = replace(robot, urdf=read_text(path))
    assert mesh_hulls(RobotBodies(proposed)) == []
    before, after = (CollisionWorld(each, Scene(), SelfCollision({}, "")) for each in (robot, proposed))
    freed = 0
    for q in random_poses(robot, 150):
        was, now = ({frozenset(contact.between) for contact in world.contacts(q)} for world in (before, after))
        assert was <= now
        freed += was < now
    assert freed
    # only the collision shapes are others
    assert proposed.urdf.count("<visual>") == robot.urdf.count("<visual>")
    assert f"{tmp_path}/forearm.stl" in proposed.urdf


def test_the_hull_s_file_looks_outwards(tmp_path):
    (hull, *_) = mesh_hulls(RobotBodies(arm(tmp_path)))
    contents = binary_stl(hull.vertices[hull.faces])
    vertices, triangles = parse_mesh("hull", "hull.stl", contents, (1.0, 1.0, 1.0))
    volume = (
        np.einsum("ij,ij->", vertices[triangles[:, 0]], np.cross(*vertices[triangles[:, 1:]].transpose(1, 0, 2))) / 6.0
    )
    assert volume == pytest.approx(hull.hull_volume, rel=1e-6)


def test_the_table_says_what_each_hull_adds_where_the_mesh_is_closed(tmp_path):
    hulls = mesh_hulls(RobotBodies(arm(tmp_path)))
    (tmp_path / "open").mkdir()
    robot = arm(tmp_path / "open")
    whole = (tmp_path / "open" / "forearm.stl").read_bytes()
    # the last triangles are missing
    count = int.from_bytes(whole[80:84], "little") - 9
    (tmp_path / "open" / "forearm.stl").write_bytes(whole[:80] + count.to_bytes(4, "little") + whole[84:-450])
    head, *rows = hull_lines([*hulls, *(hull for hull in mesh_hulls(RobotBodies(robot)) if hull.link == "forearm")])
    assert head.split() == ["link", "triangles", "mesh", "hull", "added"]
    for hull, row in zip(hulls, rows):
        assert row.startswith(hull.link) and f"{(hull.hull_volume - hull.volume) * 1e3:.2f} l (" in row
    assert rows[-1].endswith("unknown: the mesh is not closed")


def test_a_mesh_without_a_volume_is_refused_by_name(tmp_path):
    robot = arm(tmp_path)
    flat = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0], [0, 1, 0]]], dtype=float)
    (tmp_path / "forearm.stl").write_bytes(binary_stl(flat))
    with pytest.raises(ConfigurationError, match="URDF link forearm collision mesh"):
        mesh_hulls(RobotBodies(robot))

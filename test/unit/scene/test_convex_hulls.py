"""scene.convex_hulls: the proposal encloses its meshes, says what it adds, and is a URDF that can be taken as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mesh_arm import TUBES, tube, write_mesh_arm
from scene_samples import ROOT, box_triangles, kr120, random_poses
from scipy.spatial import ConvexHull

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.robot.urdf import read_text
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.convex_hulls import (
    closed_volume,
    estimated_volume,
    hull_lines,
    mesh_hulls,
    write_proposal,
)
from construction_twin.scene.mesh_file import binary_stl, parse_mesh
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import SelfCollision


def merged(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    vertices, triangles = np.unique(np.round(corners.reshape(-1, 3), 9), axis=0, return_inverse=True)
    return vertices, triangles.reshape(-1, 3)


def arm(folder) -> RobotModel:
    return read_robot_files(write_mesh_arm(folder), write_robot_yaml(folder))


def write_robot_yaml(folder):
    text = read_text(ROOT / "test/data/ur_like.yaml").replace("name: ur_like", "name: mesh_arm")
    path = folder / "mesh_arm.yaml"
    path.write_text(text)
    return path


def outwards(size, centre=(0.0, 0.0, 0.0)) -> np.ndarray:
    """Return a box whose triangles all look outwards."""
    triangles = box_triangles(size, centre)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    inwards = np.einsum("ij,ij->i", normals, triangles.mean(axis=1) - np.array(centre)) < 0
    triangles[inwards] = triangles[inwards][:, ::-1]
    return triangles


def test_the_volume_of_one_closed_surface_is_exact():
    assert closed_volume(*merged(outwards((1.0, 0.5, 0.2), (3.0, 0.0, 1.0)))) == pytest.approx(0.1, rel=1e-9)


def test_surfaces_that_overlap_count_once_and_holes_change_little():
    overlapping = np.concatenate([outwards((1.0, 1.0, 1.0)), outwards((1.0, 1.0, 1.0), (0.5, 0.0, 0.0))])
    vertices, triangles = merged(overlapping)
    assert closed_volume(vertices, triangles) is None
    assert estimated_volume(vertices, triangles, ConvexHull(vertices)) == pytest.approx(1.5, rel=0.02)
    vertices, triangles = merged(tube((0, 0, 0), (0, 0, 1.0), 0.2, 32, 8)[5:])
    assert closed_volume(vertices, triangles) is None
    assert estimated_volume(vertices, triangles, ConvexHull(vertices)) == pytest.approx(np.pi * 0.04, rel=0.05)


def test_hulls_are_proposed_for_meshes_that_are_not_convex_only(tmp_path):
    hulls = {hull.link: hull for hull in mesh_hulls(RobotBodies(arm(tmp_path)))}
    # base and flange are one convex tube each
    assert set(hulls) == {link for link, tubes in TUBES.items() if len(tubes) > 1}
    assert mesh_hulls(RobotBodies(kr120())) == []
    upper_arm = hulls["upper_arm"]
    assert upper_arm.triangles == 3 * 2 * 24 * 7 and len(upper_arm.faces) < 200
    # the three tubes of the upper arm, without what they share, and the hull around them
    assert upper_arm.estimated and 0.0085 < upper_arm.volume < 0.0105 and 0.004 < upper_arm.added < 0.008


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
    assert closed_volume(*merged(vertices[triangles])) == pytest.approx(hull.hull_volume, rel=1e-6)


def test_the_table_says_what_each_hull_adds(tmp_path):
    hulls = mesh_hulls(RobotBodies(arm(tmp_path)))
    head, *rows, note = hull_lines(hulls)
    assert head.split() == ["link", "triangles", "mesh", "hull", "added"]
    for hull, row in zip(hulls, rows):
        assert row.startswith(hull.link) and f"~{hull.added * 1e3:.2f} l" in row
    assert note == "~ the mesh is not one closed surface: its volume is an estimate"


def test_a_mesh_without_a_volume_is_refused_by_name(tmp_path):
    robot = arm(tmp_path)
    flat = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0], [0, 1, 0]]], dtype=float)
    (tmp_path / "forearm.stl").write_bytes(binary_stl(flat))
    with pytest.raises(ConfigurationError, match="URDF link forearm collision mesh"):
        mesh_hulls(RobotBodies(robot))

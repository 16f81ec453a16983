"""scene.world with meshes: what touches, what is a surface and what is solid."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scene_samples import box_triangles, bracket_triangles, kr120, kr120_pairs, random_poses, write_obj, write_stl
from scipy.spatial import ConvexHull

from construction_twin.kinematics.chain import Chain
from construction_twin.robot.description import RobotModel, load_robot
from construction_twin.robot.motion_errors import SceneError
from construction_twin.scene.collision_bodies import is_convex, mesh_triangles, scene_geometry
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.self_collision import SelfCollision

HOME = np.array(kr120().home)
TOOL = Chain(kr120()).forward(HOME).position


def world(*objects: SceneObject, padding: float = 0.0) -> CollisionWorld:
    return CollisionWorld(kr120(), Scene(objects, padding), kr120_pairs())


@pytest.mark.parametrize("write, name", [(write_stl, "box.stl"), (write_obj, "box.obj")])
def test_a_box_from_a_file_is_a_box(write, name, tmp_path):
    path = write(tmp_path / name, box_triangles((0.5, 0.25, 2.0)))
    position, quaternion = (1.6, 0.4, 1.0), (0.1, 0.2, 0.3, np.sqrt(0.86))
    mesh = world(SceneObject("wall", "mesh", (2.0, 2.0, 0.5), position, quaternion, mesh=path))
    box = world(SceneObject("wall", "box", (1.0, 0.5, 1.0), position, quaternion))
    answers = set()
    for q in random_poses(kr120(), 200):
        answers.add(box.is_free(q))
        assert mesh.is_free(q) == box.is_free(q)
        expected = box.clearance(q).distance
        if expected > 0:
            assert mesh.clearance(q).distance == pytest.approx(expected, abs=2e-6)
    assert answers == {True, False}


def test_a_closed_convex_mesh_is_solid(tmp_path):
    path = write_stl(tmp_path / "hall.stl", box_triangles((8.0, 8.0, 8.0)))
    assert not world(SceneObject("hall", "mesh", mesh=path)).is_free(HOME)


def test_any_other_mesh_is_a_surface_that_is_not_seen_from_inside(tmp_path):
    open_box = write_stl(tmp_path / "hall.stl", box_triangles((8.0, 8.0, 8.0))[1:])
    hall = world(SceneObject("hall", "mesh", mesh=open_box))
    assert hall.is_free(HOME)
    assert 0 < hall.clearance(HOME).distance < 4.0


def test_a_bracket_s_arms_touch_and_the_space_between_does_not(tmp_path):
    path = write_obj(tmp_path / "bracket.obj", bracket_triangles())
    # the flange looks down at the corner of the L: free above the short arm, in contact 0.3 m lower
    offset = np.array([0.0, 0.0, -0.15])
    free = SceneObject("bracket", "mesh", position=tuple(TOOL + offset), mesh=path)
    assert world(free).is_free(HOME)
    assert world(free).clearance(HOME).distance == pytest.approx(0.05, abs=1e-6)
    assert world(free, padding=0.049).is_free(HOME)
    assert world(free, padding=0.051).contact(HOME).between == ("link_6", "bracket")
    touching = SceneObject("bracket", "mesh", position=tuple(TOOL + [0.0, 0.0, -0.05]), mesh=path)
    assert world(touching).contact(HOME).between[1] == "bracket"


@pytest.mark.parametrize("gap, padding, free", [(0.03, 0.0, True), (0.03, 0.04, False), (-0.02, 0.0, False)])
def test_a_surface_meets_the_forearm_s_capsule(gap, padding, free, tmp_path):
    """At home the forearm's axis lies level, 0.041 m below the elbow; its capsule has a radius of 0.14 m."""
    path = write_stl(tmp_path / "tray.stl", box_triangles((0.1, 0.1, 0.1))[1:])
    tray = SceneObject("tray", "mesh", position=(0.82, 0.0, 0.675 + 1.15 - 0.041 + 0.14 + gap + 0.05), mesh=path)
    checked = world(tray, padding=padding)
    assert checked.is_free(HOME) is free
    if gap > 0:
        clearance = checked.clearance(HOME)
        assert clearance.between == ("link_3", "tray") and clearance.distance == pytest.approx(gap, abs=1e-6)
    else:
        assert checked.contact(HOME).between == ("link_3", "tray")


def test_two_meshes_meet(tmp_path):
    """A carried surface against a standing one: with a gap, with padding, and crossing."""
    path = write_stl(tmp_path / "bracket.stl", bracket_triangles())
    # tool0 looks down at home: the carried bracket hangs 0.3 m below the flange
    carried = SceneObject("part", "mesh", (0.3, 0.3, 0.3), (0.0, 0.0, 0.35), mesh=path, link="tool0")
    for gap, padding, free in [(0.1, 0.0, True), (0.1, 0.09, True), (0.1, 0.11, False), (-0.05, 0.0, False)]:
        lowest = min(corner[2] for corner in hanging(bracket_triangles() * 0.3 + [0.0, 0.0, 0.35]))
        shelf_top = TOOL[2] + lowest - gap
        shelf = SceneObject("shelf", "mesh", position=(TOOL[0], TOOL[1], shelf_top - 0.1), mesh=path)
        # only the shelf's long arm lies below the part; its upright one is 0.4 m away in x
        checked = world(carried, shelf, padding=padding)
        assert checked.is_free(HOME) is free, (gap, padding, checked.contact(HOME))
        if gap > 0:
            # of each two of their pieces
            found = [pair.distance for pair in checked.distances(HOME) if pair.between == ("part", "shelf")]
            assert min(found) == pytest.approx(gap, abs=1e-6)


def hanging(triangles: np.ndarray) -> np.ndarray:
    """Return corners given in tool0 as seen from the tool's position in the base, at home."""
    return triangles.reshape(-1, 3) @ Chain(kr120()).forward(HOME).rotation.T


def test_convex_means_closed_and_bulging():
    def mesh_of(triangles):
        vertices, index = np.unique(np.round(triangles.reshape(-1, 3), 9), axis=0, return_inverse=True)
        return vertices, index.reshape(-1, 3)

    box = box_triangles((1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    assert is_convex(*mesh_of(box))
    assert is_convex(*mesh_of(box[:, ::-1]))
    assert not is_convex(*mesh_of(box[:-1]))
    assert not is_convex(*mesh_of(bracket_triangles()))
    dented = box.copy().reshape(-1, 3)
    dented[(dented == box.reshape(-1, 3).max(axis=0)).all(axis=1)] -= 1.2
    assert not is_convex(*mesh_of(dented.reshape(-1, 3, 3)))


def test_equal_vertices_of_an_stl_are_one(tmp_path):
    item = SceneObject("part", "mesh", mesh=write_stl(tmp_path / "part.stl", bracket_triangles()))
    vertices, triangles = mesh_triangles(scene_geometry(item))
    assert vertices.shape == (14, 3) and triangles.shape == (24, 3)


def test_a_file_that_changed_or_holds_no_mesh_is_refused(tmp_path):
    path = tmp_path / "part.stl"
    write_stl(path, box_triangles((1, 1, 1)))
    item = SceneObject("part", "mesh", mesh=str(path))
    write_stl(path, box_triangles((1, 1, 2)))
    with pytest.raises(SceneError, match="changed"):
        world(item)
    path.unlink()
    with pytest.raises(SceneError, match="part"):
        world(item)
    path.write_text("no mesh\n")
    with pytest.raises(SceneError, match="part.stl"):
        world(SceneObject("part", "mesh", mesh=str(path)))


def flying_box(reach: float = 0.2) -> RobotModel:
    """Return a box that three prismatic and three revolute joints take anywhere near the base."""
    names = ["x", "y", "z", "roll", "pitch", "yaw"]
    links = "".join(f'<link name="{name}_link"/>' for name in ("base", *names[:-1]))
    joints = "".join(
        f'<joint name="{name}" type="{"prismatic" if index < 3 else "revolute"}">'
        f'<parent link="{parent}_link"/><child link="{name}_link"/>'
        f'<axis xyz="{" ".join("1" if axis == index % 3 else "0" for axis in range(3))}"/>'
        f'<limit lower="{-reach if index < 3 else -3.1}" upper="{reach if index < 3 else 3.1}" velocity="1" effort="1"/></joint>'
        for index, (parent, name) in enumerate(zip(["base", *names], names))
    )
    box = '<link name="yaw_link"><collision><geometry><box size="0.2 0.2 0.4"/></geometry></collision></link>'
    settings = {"sign": 1, "rsi": "A1"}
    linear = {"home_mm": 0.0, "acceleration_mm_s2": 1.0, "jerk_mm_s3": 1.0, "offset_mm": 0.0}
    revolute = {"home_deg": 0.0, "acceleration_deg_s2": 1.0, "jerk_deg_s3": 1.0, "offset_deg": 0.0}
    described = {
        name: settings | {"rsi": f"A{index + 1}"} | (linear if index < 3 else revolute)
        for index, name in enumerate(names)
    }
    description = {"name": "flying_box", "base_link": "base_link", "tip_link": "yaw_link", "joints": described}
    return load_robot(f'<robot name="flying_box">{links}{joints}{box}</robot>', description)


def test_no_deep_contact_with_a_convex_mesh_is_missed(tmp_path):
    """Coal's answer without contact points: two of these poses free, 11 cm inside of each other."""
    points = np.random.default_rng(1).normal(size=(150, 3))
    points *= 0.1 / np.linalg.norm(points, axis=1, keepdims=True)
    hull = ConvexHull(points)
    path = write_stl(tmp_path / "ball.stl", points[hull.simplices])
    robot = flying_box()
    ball = SceneObject("ball", "mesh", (1.0, 1.0, 1.0), mesh=path, fixed=True)
    world = CollisionWorld(robot, Scene((ball,)), SelfCollision({}, ""))
    free = [q for q in random_poses(robot, 20000, seed=3) if world.is_free(q)]
    assert 100 < len(free) < 10000
    assert min(world.clearance(q).distance for q in free) > -1e-5


def test_what_divides_meshes_is_loaded_with_the_first_of_them():
    code = (
        "import sys, construction_twin.scene.collision_world; sys.exit(bool({'manifold3d', 'scipy'} & {*sys.modules}))"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60.0)

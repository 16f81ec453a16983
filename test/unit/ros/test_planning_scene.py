"""The scene as moveit_msgs/PlanningScene: the official messages on the wire, and what MoveIt makes of a sequence of them."""

from __future__ import annotations

import io
import sys

import coal
import genpy
import numpy as np
import pinocchio
import pytest
import rospy
from moveit_messages import PART_MD5, PLANNING_SCENE_MD5, MoveitScene, md5_sums, message_types, modules
from neighbour_cell import AWAY, BESIDE, STEP, TOWARDS, other
from planning_cell import ROBOT
from scene_samples import box_triangles, kr120, kr120_pairs, write_stl

from construction_twin.kinematics.chain import Pose
from construction_twin.ros.messages.planning_scene import MoveitTypes
from construction_twin.ros.shared import ports
from construction_twin.ros.shared.planning_scene import PLANNING_SCENE, OtherArmPublisher, PlanningScenePublisher
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.neighbour import Neighbour, Obstacle
from construction_twin.scene.neighbour_objects import neighbour_objects
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.planner_scene import planner_scene

TYPES = MoveitTypes(*modules())
TABLE = SceneObject("table", "box", (1.0, 2.0, 0.1), (1.5, 0.0, 0.5))
PART = SceneObject("part", "cylinder", (0.05, 0.4), (1.5, 0.0, 0.75), padding=0.01)
STAMP = genpy.Time(12, 34)
IN_HAND = Pose(np.array([0.0, 0.0, 0.2]), np.eye(3))


class Wire:
    """A publisher whose messages went through their serialised form."""

    def __init__(self):
        self.messages: list = []

    def publish(self, message) -> None:
        buffer = io.BytesIO()
        message.serialize(buffer)
        self.messages.append(message_types()["moveit_msgs/PlanningScene"]().deserialize(buffer.getvalue()))


def told(*scenes: Scene) -> list:
    wire = Wire()
    publisher = PlanningScenePublisher(TYPES, kr120(), kr120_pairs(), wire)
    for scene in scenes:
        publisher.publish(scene, STAMP)
    return wire.messages


def taken(messages) -> MoveitScene:
    scene = MoveitScene()
    for message in messages:
        scene.take(message)
    return scene


def test_the_types_are_the_official_ones():
    sums = md5_sums()
    assert sums["moveit_msgs/PlanningScene"] == PLANNING_SCENE_MD5
    assert {name: sums[name] for name in PART_MD5} == PART_MD5


def opened(monkeypatch) -> tuple[object, list[str]]:
    """Return the topic that MoveIt reads, None without it, and what the node warned of."""
    warned: list[str] = []
    monkeypatch.setattr(rospy, "logwarn", lambda *words: warned.append(words[0] % words[1:]))
    monkeypatch.setattr(ports, "Publisher", lambda _topic, kind, *_, **__: kind.__name__)
    return PLANNING_SCENE.open(ROBOT), warned


def test_without_moveit_s_messages_nothing_is_published_and_nothing_is_wrong(monkeypatch):
    monkeypatch.setitem(sys.modules, "moveit_msgs", None)
    assert opened(monkeypatch) == (None, [])


def test_objects_have_their_shape_pose_and_frame(tmp_path):
    file = write_stl(tmp_path / "block.stl", box_triangles((0.3, 0.2, 0.1)))
    block = SceneObject("block", "mesh", position=(0.0, 2.0, 1.0), mesh=file)
    ball = SceneObject("ball", "sphere", (0.2,), (0.0, -2.0, 1.0))
    (message,) = told(Scene((TABLE, PART, ball, block), padding=0.02))
    table, part, sphere, mesh = message.world.collision_objects
    assert (table.id, table.header.frame_id, table.header.stamp) == ("table", "base_link", STAMP)
    kind = TYPES.shapes.SolidPrimitive
    assert table.primitives[0].type == kind.BOX and table.primitives[0].dimensions == pytest.approx((1.04, 2.04, 0.14))
    assert part.primitives[0].type == kind.CYLINDER
    assert part.primitives[0].dimensions[kind.CYLINDER_HEIGHT] == pytest.approx(0.46)
    assert part.primitives[0].dimensions[kind.CYLINDER_RADIUS] == pytest.approx(0.08)
    assert sphere.primitives[0].type == kind.SPHERE and sphere.primitives[0].dimensions == pytest.approx((0.22,))
    assert len(mesh.meshes[0].triangles) == 12 and len(mesh.meshes[0].vertices) == 8
    for item in (table, part, sphere):
        place = item.primitive_poses[0]
        assert place.orientation.w == 1.0 and item.pose.orientation.w == 1.0
        assert (item.pose.position.x, item.pose.position.y, item.pose.position.z) == (0.0, 0.0, 0.0)
    assert (mesh.mesh_poses[0].position.y, table.primitive_poses[0].position.z) == (2.0, 0.5)


def test_a_carried_object_hangs_on_its_link_with_what_it_may_touch():
    carried = Scene((TABLE, PART)).attach("part", "tool0", IN_HAND, ("link_5", "table"))
    (message,) = told(carried)
    (item,) = message.robot_state.attached_collision_objects
    assert (item.link_name, item.object.id, item.object.header.frame_id) == ("tool0", "part", "tool0")
    assert item.object.primitive_poses[0].position.z == pytest.approx(0.2)
    assert set(item.touch_links) == {"link_5", "link_6", "flange", "tool0"}
    assert [thing.id for thing in message.world.collision_objects] == ["table"]
    matrix = message.allowed_collision_matrix
    row = matrix.entry_values[matrix.entry_names.index("part")].enabled
    assert row[matrix.entry_names.index("table")] and not row[matrix.entry_names.index("link_2")]


def test_the_matrix_is_the_one_that_we_check_by():
    scene = Scene((TABLE, PART), padding=0.02)
    (message,) = told(scene)
    matrix = message.allowed_collision_matrix
    expected = planner_scene(RobotBodies(kr120()), scene, kr120_pairs())
    assert tuple(matrix.entry_names) == expected.names
    assert [list(map(bool, row.enabled)) for row in matrix.entry_values] == expected.allowed.tolist()
    assert (matrix.default_entry_names, list(map(bool, matrix.default_entry_values))) == (["link_0"], [True])


def test_moveit_follows_an_object_that_is_lifted_put_down_and_removed():
    standing = Scene((TABLE, PART))
    carried = standing.attach("part", "tool0", IN_HAND)
    put_down = carried.detach("part", PART.pose)
    scenes = (standing, carried, put_down, carried, carried.remove("part"), standing)
    for count, scene in enumerate(scenes, 1):
        seen = taken(told(*scenes[:count]))
        assert set(seen.attached) == {item.name for item in scene.objects if item.link}
        assert set(seen.world) == {item.name for item in scene.objects if not item.link}
        assert seen.printed == []


def test_objects_that_only_the_planner_knows_stay():
    seen = MoveitScene(world={"theirs": object()})
    for message in told(Scene((TABLE,)), Scene()):
        seen.take(message)
    assert set(seen.world) == {"theirs"}


# -- the other arm


def beside(*steps) -> list:
    """Return what is published when the other arm is seen so, one check after the other; None: it moves."""
    wire = Wire()
    publisher = OtherArmPublisher(TYPES, kr120(), wire, 0.1)
    for obstacles in steps:
        if obstacles is None:
            publisher.moves()
        else:
            publisher.stands(obstacles, 0.02, STAMP)
    return wire.messages


HERE, THERE = other().between(AWAY, AWAY), Neighbour("other", ROBOT, BESIDE, STEP).between(TOWARDS, TOWARDS)


def test_the_other_arm_is_told_of_where_it_rests_and_only_then():
    assert beside(HERE) == beside(HERE, THERE) == beside(HERE, None, HERE) == []
    assert len(beside(HERE, HERE, HERE, None, HERE, HERE)) == 1
    first, second = beside(HERE, HERE, None, THERE, THERE)
    assert first.is_diff and not first.robot_model_name and not first.allowed_collision_matrix.entry_names
    names = [thing.id for thing in first.world.collision_objects]
    assert names == [thing.id for thing in second.world.collision_objects] and len(set(names)) == len(names)
    assert {"other/link_0", "other/link_3"} <= set(names)
    assert {thing.header.frame_id for thing in first.world.collision_objects} == {"base_link"}
    seen = taken([*told(Scene((TABLE,))), first, second])
    assert "table" in seen.world and seen.printed == [] and seen.matrix is not None


def inside(item, point: np.ndarray) -> bool:
    """Return whether a point in the root lies in an object."""
    local = item.pose.rotation.T @ (point - item.pose.position)
    if item.shape == "box":
        return bool(np.all(np.abs(local) <= np.array(item.dimensions) / 2 + 1e-9))
    if item.shape == "sphere":
        return bool(np.linalg.norm(local) <= item.dimensions[0] + 1e-9)
    if item.shape == "cylinder":
        radius, length = item.dimensions
        return bool(np.hypot(*local[:2]) <= radius + 1e-9 and abs(local[2]) <= length / 2 + 1e-9)
    corners = item.vertices[item.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return bool(np.all(np.einsum("ij,ij->i", normals, local - corners[:, 0]) <= 1e-9))


@pytest.mark.parametrize(
    "geometry",
    [coal.Box(0.4, 0.2, 0.6), coal.Sphere(0.2), coal.Cylinder(0.1, 0.5), coal.Capsule(0.1, 0.5), None],
    ids=["box", "sphere", "cylinder", "capsule", "convex"],
)
def test_every_point_within_the_distance_to_keep_is_in_one_of_the_parts(geometry):
    rng = np.random.default_rng(7)
    if geometry is None:
        cloud = coal.BVHModelOBBRSS()
        cloud.beginModel(0, 40)
        cloud.addVertices(rng.normal(size=(40, 3)) * (0.3, 0.2, 0.1))
        cloud.endModel()
        cloud.buildConvexHull(True, "Qt")
        geometry = cloud.convex
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    place = pinocchio.SE3(rotation * np.sign(np.linalg.det(rotation)), np.array([0.3, -0.2, 1.0]))
    margin = 0.12
    parts = neighbour_objects([Obstacle("other/x", place, geometry, 0.01)], "base_link", margin - 0.01)
    assert [part.name for part in parts] == ["other/x", "other/x 2", "other/x 3"][: len(parts)]
    point_shape, near, far = coal.Sphere(1e-6), 0, 0
    for offset in rng.uniform(-0.6, 0.6, (3000, 3)):
        point = place.translation + offset
        result = coal.DistanceResult()
        at = coal.Transform3s(np.eye(3), point)
        distance = coal.distance(
            geometry,
            coal.Transform3s(place.rotation, place.translation),
            point_shape,
            at,
            coal.DistanceRequest(),
            result,
        )
        held = any(inside(part, point) for part in parts)
        near += distance <= margin - 1e-5
        far += not held
        assert held or distance > margin - 1e-5, (offset, distance)
    # both kinds were tried
    assert near > 50 and far > 50


@pytest.fixture
def install(monkeypatch, tmp_path):
    """Return what installs moveit_msgs, whose messages import those of another package, as genpy's do."""
    names = [name for package in ("moveit_msgs", "shape_msgs") for name in (package, f"{package}.msg")]
    # noted now, so that what the test imports is forgotten after it
    for name in names:
        monkeypatch.setitem(sys.modules, name, None)
        del sys.modules[name]

    def made(needs: str) -> None:
        for package, text in (("moveit_msgs", f"import {needs}.msg\nclass PlanningScene: pass\n"), ("shape_msgs", "")):
            (tmp_path / package / "msg").mkdir(parents=True)
            (tmp_path / package / "__init__.py").touch()
            (tmp_path / package / "msg" / "__init__.py").write_text(text)
        monkeypatch.syspath_prepend(tmp_path)

    return made


@pytest.mark.parametrize("package", ["object_recognition_msgs", "octomap_msgs", "shape_msgs"])
def test_a_package_that_moveit_s_messages_need_is_missed_in_one_warning(package, monkeypatch, install):
    install(package)
    monkeypatch.setitem(sys.modules, package, None)
    assert opened(monkeypatch) == (
        None,
        [f"planning_scene is not published: moveit_msgs needs {package}, which is not installed"],
    )

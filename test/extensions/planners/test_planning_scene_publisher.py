"""The scene as moveit_msgs/PlanningScene: the official messages on the wire, and what MoveIt makes of a sequence of them."""

from __future__ import annotations

import io
import sys

import genpy
import numpy as np
import pytest
import rospy
from moveit_messages import PART_MD5, PLANNING_SCENE_MD5, MoveitScene, md5_sums, message_types, modules
from planning_cell import ROBOT
from scene_samples import box_triangles, kr120, kr120_pairs, write_stl

from construction_twin.extensions.planners.nodes.planning_scene import MoveitTypes, PlanningScenePublisher
from construction_twin.extensions.planners.planner_scene import planner_scene
from construction_twin.kinematics.chain import Pose
from construction_twin.ros.nodes.scene import PLANNING_SCENE
from construction_twin.ros.shared import ports
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene, SceneObject

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

"""The scene as moveit_msgs/PlanningScene: the official messages on the wire, and what MoveIt makes of a sequence of them."""

from __future__ import annotations

import io
import re
import sys
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import ModuleType

import genpy
import numpy as np
import pytest
import rospkg
from genpy.dynamic import generate_dynamic
from planning_cell import ROBOT
from scene_samples import box_triangles, kr120, kr120_pairs, track7, track7_pairs, write_stl

from construction_twin.extensions.planners.nodes.planning_scene import MoveitTypes, PlanningScenePublisher
from construction_twin.kinematics.chain import Pose
from construction_twin.ros.nodes.scene import PLANNING_SCENE
from construction_twin.scene.objects import Scene, SceneObject

#: Of moveit_msgs 1.0 and 1.1, the versions of Noetic.
PLANNING_SCENE_MD5 = "acfc50bcfd6c7b978066bfa7c786002c"
#: Of parts that other packages of Noetic define.
PART_MD5 = {
    "shape_msgs/SolidPrimitive": "d8f8cbc74c5ff283fca29569ccefb45d",
    "shape_msgs/Mesh": "1ffdae9486cd3316a121c578b47a85cc",
    "octomap_msgs/Octomap": "9a45536b45c5e409cd49f04bb2d9999f",
    "object_recognition_msgs/ObjectType": "ac757ec5be1998b0167e7efcda79e3cf",
}
_DEFINITIONS = {
    "moveit_msgs/PlanningScene": """
        string name
        RobotState robot_state
        string robot_model_name
        geometry_msgs/TransformStamped[] fixed_frame_transforms
        AllowedCollisionMatrix allowed_collision_matrix
        LinkPadding[] link_padding
        LinkScale[] link_scale
        ObjectColor[] object_colors
        PlanningSceneWorld world
        bool is_diff""",
    "moveit_msgs/RobotState": """
        sensor_msgs/JointState joint_state
        sensor_msgs/MultiDOFJointState multi_dof_joint_state
        AttachedCollisionObject[] attached_collision_objects
        bool is_diff""",
    "moveit_msgs/AttachedCollisionObject": """
        string link_name
        CollisionObject object
        string[] touch_links
        trajectory_msgs/JointTrajectory detach_posture
        float64 weight""",
    "moveit_msgs/CollisionObject": """
        std_msgs/Header header
        geometry_msgs/Pose pose
        string id
        object_recognition_msgs/ObjectType type
        shape_msgs/SolidPrimitive[] primitives
        geometry_msgs/Pose[] primitive_poses
        shape_msgs/Mesh[] meshes
        geometry_msgs/Pose[] mesh_poses
        shape_msgs/Plane[] planes
        geometry_msgs/Pose[] plane_poses
        string[] subframe_names
        geometry_msgs/Pose[] subframe_poses
        byte ADD=0
        byte REMOVE=1
        byte APPEND=2
        byte MOVE=3
        byte operation""",
    "moveit_msgs/AllowedCollisionMatrix": """
        string[] entry_names
        AllowedCollisionEntry[] entry_values
        string[] default_entry_names
        bool[] default_entry_values""",
    "moveit_msgs/AllowedCollisionEntry": "bool[] enabled",
    "moveit_msgs/LinkPadding": "string link_name\nfloat64 padding",
    "moveit_msgs/LinkScale": "string link_name\nfloat64 scale",
    "moveit_msgs/ObjectColor": "string id\nstd_msgs/ColorRGBA color",
    "moveit_msgs/PlanningSceneWorld": "CollisionObject[] collision_objects\noctomap_msgs/OctomapWithPose octomap",
    "object_recognition_msgs/ObjectType": "string key\nstring db",
    "octomap_msgs/OctomapWithPose": "std_msgs/Header header\ngeometry_msgs/Pose origin\noctomap_msgs/Octomap octomap",
    "octomap_msgs/Octomap": "std_msgs/Header header\nbool binary\nstring id\nfloat64 resolution\nint8[] data",
    "shape_msgs/SolidPrimitive": """
        uint8 BOX=1
        uint8 SPHERE=2
        uint8 CYLINDER=3
        uint8 CONE=4
        uint8 type
        float64[] dimensions
        uint8 BOX_X=0
        uint8 BOX_Y=1
        uint8 BOX_Z=2
        uint8 SPHERE_RADIUS=0
        uint8 CYLINDER_HEIGHT=0
        uint8 CYLINDER_RADIUS=1
        uint8 CONE_HEIGHT=0
        uint8 CONE_RADIUS=1""",
    "shape_msgs/Mesh": "MeshTriangle[] triangles\ngeometry_msgs/Point[] vertices",
    "shape_msgs/MeshTriangle": "uint32[3] vertex_indices",
    "shape_msgs/Plane": "float64[4] coef",
}
_BUILT_IN = re.compile(r"(u?int\d+|float\d+|bool|byte|char|string|time|duration)$")


@cache
def message_types() -> dict[str, type]:
    """Return the classes by their full names; the parts that Debian has are its own definitions."""
    texts: dict[str, str] = {}
    _collect("moveit_msgs/PlanningScene", texts)
    core, *parts = texts.items()
    whole = core[1] + "".join(f"\n{'=' * 80}\nMSG: {name}\n{text}\n" for name, text in parts)
    return generate_dynamic(core[0], whole)


def md5_sums() -> dict[str, str]:
    """Return the md5 sum of each type, by its full name."""
    return {name: kind._md5sum for name, kind in message_types().items()}


def modules() -> tuple[ModuleType, ModuleType]:
    """Return stand-ins for ``moveit_msgs.msg`` and ``shape_msgs.msg``."""
    made = []
    for package in ("moveit_msgs", "shape_msgs"):
        module = ModuleType(f"{package}.msg")
        for name, kind in message_types().items():
            if name.startswith(f"{package}/"):
                setattr(module, name.split("/")[1], kind)
        made.append(module)
    return made[0], made[1]


def _collect(name: str, texts: dict[str, str]) -> None:
    package = name.split("/")[0]
    text = _definition(name)
    texts[name] = text
    for line in text.splitlines():
        words = line.split("#")[0].split()
        if not words or "=" in line:
            continue
        kind = words[0].split("[")[0]
        if _BUILT_IN.match(kind):
            continue
        full = "std_msgs/Header" if kind == "Header" else kind if "/" in kind else f"{package}/{kind}"
        if full not in texts:
            _collect(full, texts)


def _definition(name: str) -> str:
    if name in _DEFINITIONS:
        return "\n".join(line.strip() for line in _DEFINITIONS[name].strip().splitlines())
    package, kind = name.split("/")
    return (Path(rospkg.RosPack().get_path(package)) / "msg" / f"{kind}.msg").read_text()


@dataclass
class MoveitScene:
    """What move_group makes of the messages: attached objects are taken first, then those of the world (planning_scene.cpp)."""

    world: dict[str, object] = field(default_factory=dict)
    attached: dict[str, object] = field(default_factory=dict)
    matrix: object = None
    #: What move_group printed: `RobotState::getAttachedBody` an error, `processCollisionObjectRemove` a warning.
    printed: list[str] = field(default_factory=list)

    def take(self, message) -> None:
        """Take a difference."""
        assert message.is_diff and message.robot_state.is_diff
        for item in message.robot_state.attached_collision_objects:
            thing = item.object
            if thing.operation == thing.REMOVE:
                assert thing.id, "an empty name would detach everything"
                if thing.id not in self.attached:
                    self.printed.append(f"Attached body '{thing.id}' not found")
                else:
                    self.world.setdefault(thing.id, self.attached.pop(thing.id).object)
                continue
            assert thing.operation == thing.ADD and (thing.primitives or thing.meshes) and item.link_name
            self.world.pop(thing.id, None)
            self.attached[thing.id] = item
        if message.allowed_collision_matrix.entry_names:
            self.matrix = message.allowed_collision_matrix
        for thing in message.world.collision_objects:
            if thing.operation == thing.REMOVE:
                assert thing.id, "an empty name would remove everything"
                if self.world.pop(thing.id, None) is None:
                    self.printed.append(f"Tried to remove world object '{thing.id}', but it does not exist")
                continue
            assert thing.operation == thing.ADD and (thing.primitives or thing.meshes)
            self.world[thing.id] = thing


TYPES = MoveitTypes(*modules())
TABLE = SceneObject("table", "box", (1.0, 2.0, 0.1), (1.5, 0.0, 0.5))
PART = SceneObject("part", "cylinder", (0.05, 0.4), (1.5, 0.0, 0.75), padding=0.01)
PIPE = SceneObject("pipe", "cylinder", (0.1, 3.0), (-1.5, 0.0, 1.5))
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


def published_messages(*scenes: Scene) -> list:
    wire = Wire()
    publisher = PlanningScenePublisher(TYPES, kr120(), kr120_pairs(), wire)
    for scene in scenes:
        publisher.publish(scene, STAMP)
    return wire.messages


def scene_after(messages) -> MoveitScene:
    scene = MoveitScene()
    for message in messages:
        scene.take(message)
    return scene


def test_the_types_are_the_official_ones():
    sums = md5_sums()
    assert sums["moveit_msgs/PlanningScene"] == PLANNING_SCENE_MD5
    assert {name: sums[name] for name in PART_MD5} == PART_MD5


def test_without_moveit_s_messages_nothing_is_published_and_nothing_is_wrong(monkeypatch):
    monkeypatch.setitem(sys.modules, "moveit_msgs", None)
    assert PLANNING_SCENE.open(ROBOT) is None


def test_objects_have_their_shape_pose_and_frame(tmp_path):
    file = write_stl(tmp_path / "block.stl", box_triangles((0.3, 0.2, 0.1)))
    block = SceneObject("block", "mesh", position=(0.0, 2.0, 1.0), mesh=file)
    ball = SceneObject("ball", "sphere", (0.2,), (0.0, -2.0, 1.0))
    (message,) = published_messages(Scene((TABLE, PART, ball, block), padding=0.02))
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
    (message,) = published_messages(carried)
    (item,) = message.robot_state.attached_collision_objects
    assert (item.link_name, item.object.id, item.object.header.frame_id) == ("tool0", "part", "tool0")
    assert item.object.primitive_poses[0].position.z == pytest.approx(0.2)
    assert set(item.touch_links) == {"link_5", "link_6", "flange", "tool0"}
    assert [thing.id for thing in message.world.collision_objects] == ["table"]


def test_who_is_checked_with_whom_is_what_our_own_world_checks():
    carried = Scene((TABLE, PIPE, PART), padding=0.02).attach("part", "tool0", IN_HAND, ("link_5", "table"))
    (message,) = published_messages(carried)
    matrix = message.allowed_collision_matrix
    allowed = np.array([row.enabled for row in matrix.entry_values], dtype=bool)
    assert (allowed == allowed.T).all() and allowed.diagonal().all()

    def may_touch(one: str, other: str) -> bool:
        return bool(allowed[matrix.entry_names.index(one), matrix.entry_names.index(other)])

    assert may_touch("link_0", "table"), "pedestal and table: nothing moves either"
    assert not may_touch("link_3", "table") and not may_touch("part", "pipe") and not may_touch("part", "link_0")
    assert may_touch("part", "table") and may_touch("part", "link_5") and may_touch("part", "link_6")
    assert may_touch("link_1", "link_2") and not may_touch("link_1", "link_5")
    assert (matrix.default_entry_names, list(map(bool, matrix.default_entry_values))) == (["link_0"], [True])


def test_the_track_s_base_is_its_own_frame():
    wire = Wire()
    PlanningScenePublisher(TYPES, track7(), track7_pairs(), wire).publish(Scene((PIPE,)), STAMP)
    (pipe,) = wire.messages[0].world.collision_objects
    assert pipe.header.frame_id == track7().base_link


def test_moveit_follows_an_object_that_is_lifted_put_down_and_removed():
    standing = Scene((TABLE, PART))
    carried = standing.attach("part", "tool0", IN_HAND)
    put_down = carried.detach("part", PART.pose)
    scenes = (standing, carried, put_down, carried, carried.without(["part"]), standing)
    for count, scene in enumerate(scenes, 1):
        seen = scene_after(published_messages(*scenes[:count]))
        assert set(seen.attached) == {item.name for item in scene.objects if item.link}
        assert set(seen.world) == {item.name for item in scene.objects if not item.link}
        assert seen.printed == []


def test_objects_that_only_the_planner_knows_stay():
    seen = MoveitScene(world={"theirs": object()})
    for message in published_messages(Scene((TABLE,)), Scene()):
        seen.take(message)
    assert set(seen.world) == {"theirs"}

"""moveit_msgs/PlanningScene and what is in it, made by genpy from the fields and constants of the Noetic messages.

moveit_msgs, object_recognition_msgs and octomap_msgs are not in Debian. The md5 sum of a type is over all of its fields: equal to
the official one, these are the same messages on the wire. Also a MoveIt that knows only how it takes such messages.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import ModuleType

import rospkg
from genpy.dynamic import generate_dynamic

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

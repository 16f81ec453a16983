"""The scene as messages, without loss, so that it has one hash on both sides; and as rviz markers."""

from __future__ import annotations

from collections.abc import Collection, Iterable

import genpy
from geometry_msgs.msg import Point, Quaternion, Vector3
from geometry_msgs.msg import Pose as PoseMsg
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from construction_twin.kinematics.chain import Pose
from construction_twin.msg import Scene as SceneMsg
from construction_twin.msg import SceneObject as ObjectMsg
from construction_twin.robot.frames import rotation_to_quaternion
from construction_twin.robot.motion_errors import SceneError
from construction_twin.ros.messages.records import to_msg
from construction_twin.scene.objects import Scene, SceneObject

#: Colours r, g, b, a in rviz: contacts are the most visible, fixed objects (the floor) the least.
_CONTACT = (0.9, 0.05, 0.05, 0.9)
_FIXED = (0.55, 0.57, 0.6, 0.35)
_CARRIED = (0.2, 0.65, 0.35, 0.9)
_STANDING = (0.85, 0.7, 0.35, 0.85)
#: What rviz draws of each kind of shape.
SHAPES = {"box": Marker.CUBE, "cylinder": Marker.CYLINDER, "sphere": Marker.SPHERE, "mesh": Marker.MESH_RESOURCE}


def object_to_msg(item: SceneObject) -> ObjectMsg:
    """Return the message."""
    message = to_msg(item, ObjectMsg)
    message.pose = PoseMsg(Point(*item.position), Quaternion(*item.quaternion))
    return message


def object_from_msg(msg: ObjectMsg) -> SceneObject:
    """Return the object, not a fixed one; SceneError where it is none."""
    position, orientation = msg.pose.position, msg.pose.orientation
    return SceneObject(
        **{name: getattr(msg, name) for name in ("name", "shape", "mesh", "padding", "link")},
        size=tuple(msg.size),
        position=(position.x, position.y, position.z),
        quaternion=(orientation.x, orientation.y, orientation.z, orientation.w),
        touch=tuple(msg.touch),
    )


def scene_to_msg(scene: Scene, stamp: genpy.Time, frame_id: str) -> SceneMsg:
    """Return the message; `frame_id` is the tf frame of the robot's base_link."""
    msg = SceneMsg(hash=scene.hash, padding=scene.padding, objects=list(map(object_to_msg, scene.objects)))
    msg.header.stamp = stamp
    msg.header.frame_id = frame_id
    return msg


def scene_from_msg(msg: SceneMsg) -> Scene:
    """Return the scene; SceneError where it is none, or its hash another one's: then a mesh file differs between two machines."""
    scene = Scene(tuple(map(object_from_msg, msg.objects)), msg.padding)
    if scene.hash != msg.hash:
        raise SceneError("the scene's hash", msg.hash, f"{scene.hash}, its contents'; a mesh file may have changed")
    return scene


def scene_markers(
    scene: Scene, gone: Iterable[str], touching: Collection[str], base_link: str, tf_prefix: str
) -> MarkerArray:
    """Return one marker per object, in a namespace of its name, and the removal of what is `gone`."""
    markers = [_marker(item, item.name in touching, base_link, tf_prefix) for item in scene.objects]
    markers += [Marker(ns=name, action=Marker.DELETE) for name in gone]
    return MarkerArray(markers)


def tf_frame(tf_prefix: str, link: str) -> str:
    """Return the tf frame of a link."""
    return f"{tf_prefix}/{link}" if tf_prefix else link


def body_marker(item: SceneObject, frame_id: str, colour: tuple[float, ...], pose: Pose | None = None) -> Marker:
    """Return an object's shape for rviz, at its own pose by default, in a namespace of its name."""
    marker = Marker(ns=item.name, type=SHAPES[item.shape], action=Marker.ADD, frame_locked=True)
    marker.header.frame_id = frame_id
    position, quaternion = item.position, item.quaternion
    if pose is not None:
        position, quaternion = pose.position.tolist(), rotation_to_quaternion(pose.rotation).tolist()
    marker.pose = PoseMsg(Point(*position), Quaternion(*quaternion))
    marker.scale = Vector3(*_scale(item))
    marker.color = ColorRGBA(*colour)
    if item.mesh:
        marker.mesh_resource = f"file://{item.mesh}"
    return marker


def _marker(item: SceneObject, touching: bool, base_link: str, tf_prefix: str) -> Marker:
    return body_marker(item, tf_frame(tf_prefix, item.link or base_link), _colour(item, touching))


def _scale(item: SceneObject) -> tuple[float, ...]:
    if item.shape == "cylinder":
        radius, length = item.size
        return 2 * radius, 2 * radius, length
    return (2 * item.size[0],) * 3 if item.shape == "sphere" else item.size


def _colour(item: SceneObject, touching: bool) -> tuple[float, ...]:
    if touching:
        return _CONTACT
    if item.link:
        return _CARRIED
    return _FIXED if item.fixed else _STANDING

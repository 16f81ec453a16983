"""The scene as `moveit_msgs/PlanningScene`. The package is not needed here: the message types are an argument."""

from __future__ import annotations

import importlib
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from types import ModuleType

import genpy
from geometry_msgs.msg import Point, Quaternion
from geometry_msgs.msg import Pose as PoseMsg

from construction_twin.robot.frames import rotation_to_quaternion
from construction_twin.scene.planner_scene import PlannerObject, PlannerScene


@dataclass(frozen=True)
class MoveitTypes:
    """The message types.

    Attributes:
        moveit, shapes: ``moveit_msgs.msg`` and ``shape_msgs.msg``, or something with the same classes.
    """

    moveit: ModuleType
    shapes: ModuleType


def moveit_types() -> MoveitTypes:
    """Return the installed types: call it only where moveit_msgs is installed."""
    return MoveitTypes(importlib.import_module("moveit_msgs.msg"), importlib.import_module("shape_msgs.msg"))


def planning_scene_message(
    types: MoveitTypes,
    told: PlannerScene,
    robot_name: str,
    stamp: genpy.Time,
    gone: Collection[str] = (),
    put_down: Collection[str] = (),
):
    """Return the whole scene as a difference: objects that only the receiver knows stay.

    Poses are in links by their URDF names, which MoveIt knows without tf. The allowed collision matrix replaces the receiver's.

    Args:
        robot_name: The URDF's name.
        gone: Objects of the last message that are in the scene no more. MoveIt complains of those that it does not know.
        put_down: Objects that were carried in the last message and are not now; likewise.
    """
    moveit = types.moveit
    message = moveit.PlanningScene(is_diff=True, robot_model_name=robot_name)
    message.robot_state.is_diff = True
    attached = message.robot_state.attached_collision_objects
    # MoveIt takes these first: what is put down stands in the world then, where it is replaced or removed
    for name in sorted(put_down):
        removed = moveit.AttachedCollisionObject()
        removed.object.id, removed.object.operation = name, moveit.CollisionObject.REMOVE
        attached.append(removed)
    for item in told.objects:
        thing = _object(types, item, stamp)
        if item.carried:
            attached.append(
                moveit.AttachedCollisionObject(link_name=item.frame, object=thing, touch_links=list(item.touch_links))
            )
        else:
            message.world.collision_objects.append(thing)
    message.world.collision_objects += _removed(types, gone)
    matrix = message.allowed_collision_matrix
    matrix.entry_names = list(told.names)
    matrix.entry_values = [moveit.AllowedCollisionEntry(enabled=row.tolist()) for row in told.allowed]
    matrix.default_entry_names = list(told.fixed_links)
    matrix.default_entry_values = [True] * len(told.fixed_links)
    return message


def beside_message(types: MoveitTypes, objects: Iterable[PlannerObject], stamp: genpy.Time, gone: Collection[str] = ()):
    """Return objects that stand as a difference that changes nothing else: neither the robot's state nor who is checked with whom.

    Args:
        types, stamp: As of `planning_scene_message`.
        gone: Objects of earlier messages that are there no more.
    """
    message = types.moveit.PlanningScene(is_diff=True)
    message.robot_state.is_diff = True
    message.world.collision_objects = [_object(types, item, stamp) for item in objects] + _removed(types, gone)
    return message


def _removed(types: MoveitTypes, names: Iterable[str]) -> list:
    remove = types.moveit.CollisionObject.REMOVE
    return [types.moveit.CollisionObject(id=name, operation=remove) for name in sorted(names)]


def _object(types: MoveitTypes, item: PlannerObject, stamp: genpy.Time):
    thing = types.moveit.CollisionObject(id=item.name, operation=types.moveit.CollisionObject.ADD)
    thing.header.frame_id, thing.header.stamp = item.frame, stamp
    pose = PoseMsg(Point(*item.pose.position), Quaternion(*rotation_to_quaternion(item.pose.rotation)))
    # of versions with a pose of the object's own, MoveIt takes the only shape's when that is not set
    if hasattr(thing, "pose"):
        thing.pose.orientation.w = 1.0
    if item.shape == "mesh":
        thing.meshes, thing.mesh_poses = [_mesh(types, item)], [pose]
    else:
        thing.primitives, thing.primitive_poses = [_primitive(types, item)], [pose]
    return thing


def _mesh(types: MoveitTypes, item: PlannerObject):
    triangles = [types.shapes.MeshTriangle(vertex_indices=list(map(int, row))) for row in item.triangles]
    return types.shapes.Mesh(triangles=triangles, vertices=[Point(*vertex) for vertex in item.vertices.tolist()])


def _primitive(types: MoveitTypes, item: PlannerObject):
    kind = types.shapes.SolidPrimitive
    if item.shape == "cylinder":
        radius, length = item.dimensions
        return kind(type=kind.CYLINDER, dimensions=[length, radius])
    return kind(type=kind.BOX if item.shape == "box" else kind.SPHERE, dimensions=list(item.dimensions))

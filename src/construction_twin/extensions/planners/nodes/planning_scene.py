"""The scene as `moveit_msgs/PlanningScene`. The package is not needed here: the message types are an argument.

A message is a difference, and what is gone must be named, once: MoveIt complains of each object that it is to detach or remove and
does not know. So a change that takes something away is followed by a message that says all that is there and removes nothing. That
one stays latched, for a planner that comes later.
"""

from __future__ import annotations

import importlib
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from types import ModuleType

import genpy
from geometry_msgs.msg import Point, Quaternion
from geometry_msgs.msg import Pose as PoseMsg

from construction_twin.extensions.planners.planner_scene import PlannerObject, PlannerScene, planner_scene
from construction_twin.robot.description import RobotModel
from construction_twin.robot.frames import rotation_to_quaternion
from construction_twin.robot.urdf import parse_urdf
from construction_twin.ros.transport.publisher import AnyPublisher
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import SelfCollision


@dataclass(frozen=True)
class MoveitTypes:
    """``moveit_msgs.msg`` and ``shape_msgs.msg``, or something with the same classes."""

    moveit: ModuleType
    shapes: ModuleType


def moveit_types() -> MoveitTypes:
    """Return the installed types: call it only where moveit_msgs is installed."""
    return MoveitTypes(importlib.import_module("moveit_msgs.msg"), importlib.import_module("shape_msgs.msg"))


class PlanningScenePublisher:
    """Publishes scenes as `moveit_msgs/PlanningScene`."""

    def __init__(self, types: MoveitTypes, robot: RobotModel, self_collision: SelfCollision, publisher: AnyPublisher):
        self._types = types
        self._bodies = RobotBodies(robot)
        self._self_collision = self_collision
        self._publisher = publisher
        self._robot_name = parse_urdf(robot.urdf).name
        self._published: set[str] = set()
        self._carried: set[str] = set()

    def publish(self, scene: Scene, stamp: genpy.Time) -> None:
        """Publish a scene that was checked before."""
        scene_of_planner = planner_scene(self._bodies, scene, self._self_collision)
        carried = {item.name for item in scene_of_planner.objects if item.carried}
        gone, put_down = self._published - set(scene.names), self._carried - carried
        if gone or put_down:
            change = planning_scene_message(self._types, scene_of_planner, self._robot_name, stamp, gone, put_down)
            self._publisher.publish(change)
        self._published, self._carried = set(scene.names), carried
        self._publisher.publish(planning_scene_message(self._types, scene_of_planner, self._robot_name, stamp))


def planning_scene_message(
    types: MoveitTypes,
    scene_of_planner: PlannerScene,
    robot_name: str,
    stamp: genpy.Time,
    gone: Collection[str] = (),
    put_down: Collection[str] = (),
):
    """Return the whole scene as a difference: objects that only the receiver knows stay.

    Poses are in links by their URDF names, which MoveIt knows without tf. The allowed collision matrix replaces the receiver's.
    Objects of the last message are `gone`, or are carried no more (`put_down`).
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
    for item in scene_of_planner.objects:
        collision_object = _object(types, item, stamp)
        if item.carried:
            attached.append(
                moveit.AttachedCollisionObject(
                    link_name=item.frame, object=collision_object, touch_links=list(item.touch_links)
                )
            )
        else:
            message.world.collision_objects.append(collision_object)
    message.world.collision_objects += _removed(types, gone)
    matrix = message.allowed_collision_matrix
    matrix.entry_names = list(scene_of_planner.names)
    matrix.entry_values = [moveit.AllowedCollisionEntry(enabled=row.tolist()) for row in scene_of_planner.allowed]
    matrix.default_entry_names = list(scene_of_planner.fixed_links)
    matrix.default_entry_values = [True] * len(scene_of_planner.fixed_links)
    return message


def _removed(types: MoveitTypes, names: Iterable[str]) -> list:
    remove = types.moveit.CollisionObject.REMOVE
    return [types.moveit.CollisionObject(id=name, operation=remove) for name in sorted(names)]


def _object(types: MoveitTypes, item: PlannerObject, stamp: genpy.Time):
    collision_object = types.moveit.CollisionObject(id=item.name, operation=types.moveit.CollisionObject.ADD)
    collision_object.header.frame_id, collision_object.header.stamp = item.frame, stamp
    pose = PoseMsg(Point(*item.pose.position), Quaternion(*rotation_to_quaternion(item.pose.rotation)))
    # of versions with a pose of the object's own, MoveIt takes the only shape's when that is not set
    if hasattr(collision_object, "pose"):
        collision_object.pose.orientation.w = 1.0
    if item.shape == "mesh":
        collision_object.meshes, collision_object.mesh_poses = [_mesh(types, item)], [pose]
    else:
        collision_object.primitives, collision_object.primitive_poses = [_primitive(types, item)], [pose]
    return collision_object


def _mesh(types: MoveitTypes, item: PlannerObject):
    triangles = [types.shapes.MeshTriangle(vertex_indices=list(map(int, row))) for row in item.triangles]
    return types.shapes.Mesh(triangles=triangles, vertices=[Point(*vertex) for vertex in item.vertices.tolist()])


def _primitive(types: MoveitTypes, item: PlannerObject):
    kind = types.shapes.SolidPrimitive
    if item.shape == "cylinder":
        radius, length = item.dimensions
        return kind(type=kind.CYLINDER, dimensions=[length, radius])
    return kind(type=kind.BOX if item.shape == "box" else kind.SPHERE, dimensions=list(item.dimensions))

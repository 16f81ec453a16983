"""The scene as `moveit_msgs/PlanningScene`; the message types are an argument, so the package is optional.

MoveIt has no padding per object, so it is put into the shape: what stands is larger by the scene's padding and its own, what is
carried by its own (the standing objects have the scene's already). A mesh is sent as it is.

A message is a difference, and what is gone must be named, once: MoveIt complains of each object that it is to detach or remove and
does not know. So a change that takes something away is followed by a message that says all that is there and removes nothing. That
one stays latched, for a planner that comes later.
"""

from __future__ import annotations

import importlib
from collections.abc import Collection
from dataclasses import dataclass
from types import ModuleType

import genpy
import numpy as np
import pinocchio
from geometry_msgs.msg import Point, Quaternion
from geometry_msgs.msg import Pose as PoseMsg

from construction_twin.robot.description import RobotModel
from construction_twin.robot.frames import rotation_to_quaternion
from construction_twin.robot.urdf import parse_urdf
from construction_twin.ros.transport.publisher import AnyPublisher
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.mesh_file import parse_mesh
from construction_twin.scene.objects import Scene, SceneObject, read_mesh_file
from construction_twin.scene.pair_checks import checked_pairs
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
        carried = {item.name for item in scene.objects if item.link}
        gone, put_down = self._published - set(scene.names), self._carried - carried
        if gone or put_down:
            self._publisher.publish(self._message(scene, stamp, gone, put_down))
        self._published, self._carried = set(scene.names), carried
        self._publisher.publish(self._message(scene, stamp))

    def _message(self, scene: Scene, stamp: genpy.Time, gone: Collection[str] = (), put_down: Collection[str] = ()):
        """Return the whole scene as a difference: objects that only the receiver knows stay.

        Poses are in links by their URDF names, which MoveIt knows without tf. The allowed collision matrix replaces the receiver's.
        """
        moveit = self._types.moveit
        message = moveit.PlanningScene(is_diff=True, robot_model_name=self._robot_name)
        message.robot_state.is_diff = True
        attached = message.robot_state.attached_collision_objects
        # MoveIt takes these first: what is put down stands in the world then, where it is replaced or removed
        for name in sorted(put_down):
            removed = moveit.AttachedCollisionObject()
            removed.object.id, removed.object.operation = name, moveit.CollisionObject.REMOVE
            attached.append(removed)
        for item in scene.objects:
            collision_object = self._object(item, scene, stamp)
            if item.link:
                links = self._touch_links(item)
                attached.append(
                    moveit.AttachedCollisionObject(link_name=item.link, object=collision_object, touch_links=links)
                )
            else:
                message.world.collision_objects.append(collision_object)
        message.world.collision_objects += [
            moveit.CollisionObject(id=name, operation=moveit.CollisionObject.REMOVE) for name in sorted(gone)
        ]
        self._fill_matrix(message.allowed_collision_matrix, scene)
        return message

    def _object(self, item: SceneObject, scene: Scene, stamp: genpy.Time):
        moveit, shapes = self._types.moveit, self._types.shapes
        collision_object = moveit.CollisionObject(id=item.name, operation=moveit.CollisionObject.ADD)
        collision_object.header.frame_id = item.link or self._bodies.robot.base_link
        collision_object.header.stamp = stamp
        pose = PoseMsg(Point(*item.pose.position), Quaternion(*rotation_to_quaternion(item.pose.rotation)))
        # of versions with a pose of the object's own, MoveIt takes the only shape's when that is not set
        if hasattr(collision_object, "pose"):
            collision_object.pose.orientation.w = 1.0
        if item.shape == "mesh":
            x, y, z = item.size
            contents = read_mesh_file(item.name, item.mesh)
            vertices, triangles = parse_mesh(f"object {item.name!r} mesh", item.mesh, contents, (x, y, z))
            mesh = shapes.Mesh(
                triangles=[shapes.MeshTriangle(vertex_indices=row) for row in triangles.tolist()],
                vertices=[Point(*vertex) for vertex in vertices.tolist()],
            )
            collision_object.meshes, collision_object.mesh_poses = [mesh], [pose]
            return collision_object
        margin = item.padding + (0.0 if item.link else scene.padding)
        kind = shapes.SolidPrimitive
        if item.shape == "box":
            primitive = kind(type=kind.BOX, dimensions=[size + 2.0 * margin for size in item.size])
        elif item.shape == "cylinder":
            radius, length = item.size
            primitive = kind(type=kind.CYLINDER, dimensions=[length + 2.0 * margin, radius + margin])
        else:
            primitive = kind(type=kind.SPHERE, dimensions=[item.size[0] + margin])
        collision_object.primitives, collision_object.primitive_poses = [primitive], [pose]
        return collision_object

    def _touch_links(self, item: SceneObject) -> list[str]:
        """Return the links that a carried object may touch: those that move with it, and those it names."""
        bodies = self._bodies
        moves = bodies.model.frames[bodies.model.getFrameId(item.link, pinocchio.FrameType.BODY)].parentJoint
        with_it = {link for link, joint in bodies.link_joints.items() if joint == moves}
        return sorted(with_it | (set(item.touch) & set(bodies.link_joints)))

    def _fill_matrix(self, matrix, scene: Scene) -> None:
        """Allow each pair that is unchecked here, and fixed links with any unlisted object."""
        bodies = self._bodies
        own = (*bodies.bodies, *bodies.place_all(scene))
        names = list(dict.fromkeys(body.owner for body in own))
        index = {name: number for number, name in enumerate(names)}
        allowed = np.ones((len(names), len(names)), dtype=bool)
        for first, second, _ in checked_pairs(own, scene.padding, self._self_collision):
            one, other = index[own[first].owner], index[own[second].owner]
            allowed[one, other] = allowed[other, one] = False
        fixed_links = [
            link for link in dict.fromkeys(body.link for body in bodies.bodies) if not bodies.link_joints[link]
        ]
        matrix.entry_names = names
        matrix.entry_values = [self._types.moveit.AllowedCollisionEntry(enabled=row.tolist()) for row in allowed]
        matrix.default_entry_names, matrix.default_entry_values = fixed_links, [True] * len(fixed_links)

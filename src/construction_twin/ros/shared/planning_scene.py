"""Tells MoveIt of the scene, and remembers what it was told: what is gone must be named, because a message is a difference."""

from __future__ import annotations

import genpy

from construction_twin.robot.description import RobotModel
from construction_twin.robot.urdf import parse_urdf
from construction_twin.ros.messages.planning_scene import MoveitTypes, planning_scene_message
from construction_twin.ros.transport.publisher import Sink
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene
from construction_twin.scene.planner_scene import planner_scene
from construction_twin.scene.self_collision import SelfCollision


class PlanningScenePublisher:
    """Publishes scenes as `moveit_msgs/PlanningScene`.

    Every message says all that was ever told, so that a planner that comes later needs the latched one only.

    Parameters
    ----------
    types : MoveitTypes
    robot : RobotModel
    self_collision : SelfCollision
    publisher : Sink
        Of that type, latched.
    """

    def __init__(self, types: MoveitTypes, robot: RobotModel, self_collision: SelfCollision, publisher: Sink):
        self._types = types
        self._bodies = RobotBodies(robot)
        self._self_collision = self_collision
        self._publisher = publisher
        self._robot_name = parse_urdf(robot.urdf).name
        self._told: set[str] = set()
        self._carried: set[str] = set()

    def publish(self, scene: Scene, stamp: genpy.Time) -> None:
        """Publish a scene that was checked before."""
        told = planner_scene(self._bodies, scene, self._self_collision)
        carried = {item.name for item in told.objects if item.carried}
        gone, put_down = self._told - set(scene.names), self._carried - carried
        message = planning_scene_message(self._types, told, self._robot_name, stamp, gone, put_down)
        self._told |= set(scene.names)
        self._carried |= carried
        self._publisher.publish(message)

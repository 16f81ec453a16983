"""Tells MoveIt of the scene and of the other arm, and remembers what it was told: a message is a difference.

What is gone must be named, once: MoveIt complains of each object that it is to detach or remove and does not know. So a change that
takes something away is followed by a message that says all that is there and removes nothing. That one stays latched, for a planner
that comes later.
"""

from __future__ import annotations

from collections.abc import Collection

import genpy

from construction_twin.robot.description import RobotModel
from construction_twin.robot.urdf import parse_urdf
from construction_twin.ros.messages.planning_scene import MoveitTypes, beside_message, planning_scene_message
from construction_twin.ros.shared.ports import Publication
from construction_twin.ros.transport.publisher import Sink
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.neighbour import Obstacle
from construction_twin.scene.neighbour_objects import neighbour_objects
from construction_twin.scene.objects import Scene
from construction_twin.scene.planner_scene import planner_scene
from construction_twin.scene.self_collision import SelfCollision

#: Where MoveIt is told, if its message types are installed. For one that is busy many messages are kept: one that is dropped may be
#: the one that took something away.
PLANNING_SCENE = Publication("planning_scene", "moveit_msgs/PlanningScene", queue_size=50, latch=True)


class PlanningScenePublisher:
    """Publishes scenes as `moveit_msgs/PlanningScene`."""

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
        if gone or put_down:
            change = planning_scene_message(self._types, told, self._robot_name, stamp, gone, put_down)
            self._publisher.publish(change)
        self._told, self._carried = set(scene.names), carried
        self._publisher.publish(planning_scene_message(self._types, told, self._robot_name, stamp))


class OtherArmPublisher:
    """Publishes where the other arm rests, as objects that stand, as `moveit_msgs/PlanningScene`.

    Args:
        robot: Ours, which must not touch it.
        publisher: Of that type, latched.
        padding: Distance that our plans keep from it, besides the scene's padding [m].
    """

    def __init__(self, types: MoveitTypes, robot: RobotModel, publisher: Sink, padding: float):
        self._types = types
        self._root = parse_urdf(robot.urdf).get_root()
        self._publisher = publisher
        self._padding = padding
        self._names: set[str] = set()
        self._seen: tuple[Collection[Obstacle], float] | None = None
        self._told: tuple[Collection[Obstacle], float] | None = None

    def moves(self) -> None:
        """Take that the arm follows a plan, or that its pose is not known: MoveIt goes on with where it rested last."""
        self._seen = None

    def stands(self, obstacles: Collection[Obstacle], scene_padding: float, stamp: genpy.Time) -> None:
        """Take what the arm occupies without a plan; it rests when this is the same twice, and is told of once.

        Args:
            obstacles: As `Neighbour.between` returns them: the same object while the arm stays where it is.
            scene_padding: [m]
        """
        before, self._seen = self._seen, (obstacles, scene_padding)
        if not _same(before, self._seen) or _same(self._told, self._seen):
            return
        objects = neighbour_objects(obstacles, self._root, self._padding + scene_padding)
        names = {item.name for item in objects}
        gone = self._names - names
        if gone:
            self._publisher.publish(beside_message(self._types, objects, stamp, gone))
        self._publisher.publish(beside_message(self._types, objects, stamp))
        self._names, self._told = names, self._seen


def _same(one: tuple[Collection[Obstacle], float] | None, other: tuple[Collection[Obstacle], float]) -> bool:
    return one is not None and one[0] is other[0] and one[1] == other[1]

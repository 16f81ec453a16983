"""The command `twin scene`: the scene as it stands, in words or as a planning scene of MoveIt."""

from __future__ import annotations

import argparse
import sys
import time

import rospy

from construction_twin.core.errors import SilenceError
from construction_twin.core.motion_errors import NeighbourUnknownError
from construction_twin.core.sentences import Sentence
from construction_twin.msg import Scene as SceneMsg
from construction_twin.robot.description import RobotModel
from construction_twin.robot.urdf import parse_urdf
from construction_twin.ros.commands.twin_output import write_or_print
from construction_twin.ros.messages.scene_convert import scene_from_msg
from construction_twin.ros.shared.arm_listener import listen_to_other_arm, neighbour_settings
from construction_twin.ros.shared.master import expect_publisher
from construction_twin.ros.shared.params import robot_from_parameters
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.neighbour_objects import neighbour_objects
from construction_twin.scene.objects import Scene
from construction_twin.scene.planner_scene import PlannerObject, planner_scene, scene_text
from construction_twin.scene.self_collision import SelfCollision
from construction_twin.views.arguments import Exit
from construction_twin.views.texts import scene_lines

#: Oldest pose of the other arm that is used [s].
LATCHED = 2.0
#: Between two looks at what has been heard of the other arm [s].
PAUSE = 0.05


class SceneCommand:
    """One call of `twin scene`."""

    def __init__(self, options: argparse.Namespace, namespace: str):
        self._options, self._namespace = options, namespace

    def run(self) -> Exit:
        """Show or write the scene that stands now."""
        scene = self._present_scene()
        if self._options.moveit is None:
            print("\n".join(scene_lines(scene)))
            return Exit.DONE
        bodies = RobotBodies(robot_from_parameters(f"{self._namespace}/"))
        root = parse_urdf(bodies.robot.urdf).get_root()
        told = planner_scene(bodies, scene, SelfCollision({}, ""))
        beside, about = self._other_arm(bodies.robot, root, scene.padding)
        text, remarks = scene_text(told, f"{self._options.robot} {scene.hash[:12]}", beside)
        for remark in (*remarks, *about):
            print(f"twin: {remark}", file=sys.stderr)
        path = write_or_print(self._options.moveit, text)
        if path is not None:
            objects = sum(not item.link for item in scene.objects)
            arm = f" and {len(beside)} parts of the other arm" if beside else ""
            print(f"{path}: {objects} objects{arm}, in {root}")
        return Exit.DONE

    def _other_arm(self, robot: RobotModel, root: str, padding: float) -> tuple[tuple[PlannerObject, ...], list[str]]:
        """Return the other arm of the cell where it is now as objects, and what there is to say about it."""
        settings = neighbour_settings(f"{self._namespace}/")
        if settings is None:
            return (), []
        refused: list[str] = []
        other = listen_to_other_arm(
            robot.name, settings, lambda _, sentence: refused.append(sentence), True, f"{self._namespace}/"
        )
        deadline = time.monotonic() + self._options.timeout
        while True:
            try:
                obstacles = other.occupied(LATCHED)
            except NeighbourUnknownError as error:
                unknown = str(error)
            else:
                unknown = other.unknown
            if not unknown or time.monotonic() > deadline:
                break
            rospy.sleep(PAUSE)
        if unknown:
            return (), [*refused, f"{settings.name} is not in it: {unknown}"]
        moves = [f"{settings.name} follows a plan: in it is the rest of that path"] if other.claim is not None else []
        return neighbour_objects(obstacles, root, settings.padding + padding), moves

    def _present_scene(self) -> Scene:
        """Return the scene that stands now; SilenceError when nobody publishes one."""
        topic = f"{self._namespace}/scene"
        expect_publisher(topic)
        try:
            return scene_from_msg(rospy.wait_for_message(topic, SceneMsg, self._options.timeout))
        except rospy.ROSException as error:
            raise SilenceError(topic, Sentence("view.silent.scene"), Sentence("view.to_do.down")) from error

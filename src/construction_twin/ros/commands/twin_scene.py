"""The command `twin scene`: the scene as it stands, in words or as a planning scene of MoveIt."""

from __future__ import annotations

import argparse
import sys

import rospy

from construction_twin.core.errors import SilenceError
from construction_twin.msg import Scene as SceneMsg
from construction_twin.robot.urdf import parse_urdf
from construction_twin.ros.commands.twin_output import write_or_print
from construction_twin.ros.messages.scene_convert import scene_from_msg
from construction_twin.ros.shared.master import expect_publisher
from construction_twin.ros.shared.params import robot_from_parameters
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene
from construction_twin.scene.planner_scene import planner_scene, scene_text
from construction_twin.scene.self_collision import SelfCollision
from construction_twin.views.arguments import Exit
from construction_twin.views.texts import scene_lines


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
        text, remarks = scene_text(told, f"{self._options.robot} {scene.hash[:12]}")
        for remark in remarks:
            print(f"twin: {remark}", file=sys.stderr)
        path = write_or_print(self._options.moveit, text)
        if path is not None:
            objects = sum(not item.link for item in scene.objects)
            print(f"{path}: {objects} objects, in {root}")
        return Exit.DONE

    def _present_scene(self) -> Scene:
        """Return the scene that stands now; SilenceError when nobody publishes one."""
        topic = f"{self._namespace}/scene"
        expect_publisher(topic)
        try:
            return scene_from_msg(rospy.wait_for_message(topic, SceneMsg, self._options.timeout))
        except rospy.ROSException as error:
            raise SilenceError(topic, "the scene node does not publish", "see why it is down") from error

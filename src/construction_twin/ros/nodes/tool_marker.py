"""tool_marker: the operator's handle in rviz. Dragged away from the tool, it shows at once whether the arm can go there."""

from __future__ import annotations

import getpass
import math
import textwrap
import threading
import time
from collections.abc import Callable
from typing import Annotated

import numpy as np
import pydantic
import rospy
from geometry_msgs.msg import Point, Quaternion, Vector3
from geometry_msgs.msg import Pose as PoseMsg
from interactive_markers.interactive_marker_server import InteractiveMarkerServer
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import (
    InteractiveMarker,
    InteractiveMarkerControl,
    InteractiveMarkerFeedback,
    Marker,
    MarkerArray,
)

from construction_twin.core.errors import ConstructionTwinError, PayloadError, PoseUnknownError
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.msg import Execution
from construction_twin.msg import Scene as SceneMsg
from construction_twin.robot.description import RobotModel
from construction_twin.robot.motion_errors import KinematicsError, SceneError
from construction_twin.ros.messages.convert import pose_from_msg, pose_to_msg
from construction_twin.ros.messages.scene_convert import scene_from_msg, tf_frame
from construction_twin.ros.shared import node_shell as shell
from construction_twin.ros.shared.diagnostics import OK, WARN, Diagnosis
from construction_twin.ros.shared.params import PrivateSettings
from construction_twin.ros.shared.robot_client import REPORTS, OperatorClient, RobotListener
from construction_twin.ros.shared.tool_marker_menu import ToolMarkerMenu, moved
from construction_twin.ros.transport.subscriber import PUBLISHER, caller_of
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import read_self_collision
from construction_twin.views.reachability import PoseVerdict, Reach, judge_pose
from construction_twin.views.texts import waiting_plan


class MarkerServer(InteractiveMarkerServer):
    """As `InteractiveMarkerServer`, but deaf to what is played: `refused(reason, sentence)` is told of it."""

    def __init__(self, topic: str, refused: Callable[[str, str], None]):
        self._refused = refused
        super().__init__(topic)

    def keepAlive(self, msg: object) -> None:  # noqa: N802 (the name of its base class)
        """Tell clients that it is here; at shutdown its topic may be closed already."""
        try:
            super().keepAlive(msg)
        except rospy.ROSException:
            if not rospy.core.is_shutdown_requested():
                raise

    def processFeedback(self, feedback: InteractiveMarkerFeedback) -> None:  # noqa: N802 (the name of its base class)
        """Take what a client sent, if it is the client's own."""
        caller = caller_of(feedback)
        if caller and feedback.client_id.startswith(f"{caller}/"):
            super().processFeedback(feedback)
            return
        sender = caller or "a node without a name"
        self._refused(PUBLISHER, f"click of {feedback.client_id!r} on the marker, sent by {sender}: no rviz's own")


#: How often the marker follows the tool while it has not been dragged, and the texts are renewed [s].
PERIOD = 0.1
#: Oldest pose of the twin that a goal may be judged from [s].
MAX_POSE_AGE = 0.5
#: Time for the inverse kinematics of a pose [s]; only arms without a closed form need it.
IK_BUDGET = 0.1
#: How long the marker's menu waits for a node that does not answer [s].
SERVICE_TIMEOUT = 2.0

#: Name of the interactive marker.
NAME = "tool"
#: Colours r, g, b, a of a verdict; None: not known. Clear enough that the tool path can be seen through them.
COLOURS = {
    Reach.FREE: (0.1, 0.75, 0.25, 0.5),
    Reach.CONTACT: (1.0, 0.55, 0.0, 0.55),
    Reach.OUT: (0.9, 0.05, 0.05, 0.55),
    Reach.UNKNOWN: (0.55, 0.35, 0.75, 0.55),
    None: (0.55, 0.57, 0.6, 0.5),
}
#: Can be read in front of the sky, the floor and the arm.
_TEXT_COLOUR = (0.1, 0.1, 0.15, 1.0)
#: Height of a letter, and distance of the text below the marker, where it seldom hides the arm, as fractions of the marker's size.
_LETTER, _BELOW = 0.1, 0.95
#: Characters of a line.
_WIDTH = 45
#: Size of the handle, and of the sphere in it that shows the verdict, as fractions of the marker's size. The handle is a clear
#: shell around the sphere, because rviz gives a click to the first object it meets, and the sphere has no menu.
_HANDLE, _SPHERE = 0.3, 0.25
_HALF = math.sqrt(0.5)
#: Orientation of a control whose axis is the marker's x, y, z.
_AXES = {"x": (_HALF, 0.0, 0.0, _HALF), "y": (0.0, 0.0, _HALF, _HALF), "z": (0.0, _HALF, 0.0, _HALF)}


class Settings(PrivateSettings):
    """Private parameters: behaviour in config/tool_marker.yaml; `self_collision`, `tf_prefix` in the launch file."""

    scale: Annotated[float, pydantic.Field(gt=0.0, allow_inf_nan=False)]
    self_collision: str
    tf_prefix: str
    reviewer: str


def tool_marker(frame: str, pose: PoseMsg, scale: float) -> InteractiveMarker:
    """Return the interactive marker, of `scale` [m]; its stamp is 0: rviz keeps it in this frame, and reports poses in it."""
    marker = InteractiveMarker(name=NAME, description="", pose=pose, scale=scale)
    marker.header.frame_id = frame
    handle = Marker(type=Marker.SPHERE, color=ColorRGBA(1.0, 1.0, 1.0, 0.2))
    handle.scale = Vector3(*[_HANDLE * scale] * 3)
    menu = InteractiveMarkerControl(name="menu", interaction_mode=InteractiveMarkerControl.MENU, always_visible=True)
    menu.description = "plan, review, stop"
    menu.markers.append(handle)
    marker.controls.append(menu)
    for axis, orientation in _AXES.items():
        for name, mode in (
            ("move", InteractiveMarkerControl.MOVE_AXIS),
            ("turn", InteractiveMarkerControl.ROTATE_AXIS),
        ):
            control = InteractiveMarkerControl(name=f"{name}_{axis}", interaction_mode=mode)
            control.orientation = Quaternion(*orientation)
            marker.controls.append(control)
    return marker


def verdict_markers(frame: str, pose: PoseMsg, scale: float, reach: Reach | None, lines: list[str]) -> MarkerArray:
    """Return the coloured sphere and the text."""
    sphere = Marker(ns="verdict", id=0, type=Marker.SPHERE, pose=pose, color=ColorRGBA(*COLOURS[reach]))
    sphere.scale = Vector3(*[_SPHERE * scale] * 3)
    text = _text("\n".join(textwrap.fill(line, _WIDTH) for line in lines if line), pose.position, scale)
    for marker in (sphere, text):
        # stamp 0: with the newest transform
        marker.header.frame_id = frame
        marker.frame_locked = True
    return MarkerArray([sphere, text])


def _text(text: str, at: Point, scale: float) -> Marker:
    marker = Marker(ns="verdict", id=1, type=Marker.TEXT_VIEW_FACING, color=ColorRGBA(*_TEXT_COLOUR), text=text)
    # rviz centres a text on its position: a longer one is placed lower, so that all begin at the same height
    below = _BELOW + 0.6 * _LETTER * text.count("\n")
    marker.pose = PoseMsg(Point(at.x, at.y, at.z - below * scale), Quaternion(w=1.0))
    marker.scale.z = _LETTER * scale
    return marker


class ToolMarkerNode:
    """Interactive marker `tool_marker`, markers `tool_marker/verdict`; its menu calls the services that an operator would."""

    def __init__(self, settings: Settings, robot: RobotModel, node_io: shell.NodeIO):
        self._settings = settings
        self._robot = robot
        self._chain = Chain(self._robot)
        ik = IkSettings(budget_s=IK_BUDGET)
        self._solver = inverse_kinematics(Chain(self._robot), ik, np.random.default_rng(0), time.monotonic)
        self._self_collision = read_self_collision(self._settings.self_collision, self._robot)
        self._frame = tf_frame(self._settings.tf_prefix, self._robot.base_link)
        # wakes the worker: a pose or a scene is to be judged (pending), or a sentence to be shown
        self._news = threading.Condition()
        self._pending = False
        self._scene: Scene | None = None
        self._shown_text = ""
        # what only the worker uses
        self._world: CollisionWorld | None = None
        self._place: Pose | None = None
        self._verdict: PoseVerdict | None = None
        self._fault: str = "the twin's pose is not known yet"
        self._drawn: MarkerArray | None = None
        self._finished = ""
        namespace = rospy.get_namespace()
        self._diagnostics = node_io.diagnostics
        self._listener = RobotListener(namespace, self._robot, refuse=self._diagnostics.refuse)
        client = OperatorClient(namespace, SERVICE_TIMEOUT, "tool_marker")
        reviewer = settings.reviewer or getpass.getuser()
        self._menu = ToolMarkerMenu(client, self._listener.under_review, robot.home, reviewer, self._show_text)
        self._verdicts = node_io.publishers["tool_marker/verdict"]
        self._server = MarkerServer("tool_marker", self._diagnostics.refuse)
        self._twin = node_io.poses["twin/joint_states"]

    def run(self) -> None:
        """Judge the newest pose, or follow the tool, until shutdown."""
        while not rospy.is_shutdown():
            with self._news:
                self._news.wait_for(lambda: self._pending, PERIOD)
                asked, self._pending = self._pending, False
                scene = self._scene
            if not asked:
                self._drop_reached_goal()
                if self._menu.goal is None:
                    self._follow()
            goal = self._menu.goal
            # a pose that could not be judged is tried again
            if asked or self._verdict is None:
                self._judge(self._place if goal is None else goal, scene)
            self._draw()

    # -- what rviz and the scene node send: nothing here waits

    def _on_feedback(self, feedback: InteractiveMarkerFeedback) -> None:
        if feedback.event_type not in (feedback.POSE_UPDATE, feedback.MOUSE_UP):
            return
        try:
            pose = self._read(feedback)
        except (KinematicsError, PayloadError) as error:
            self._diagnostics.refuse("pose", str(error))
            return
        if feedback.event_type == feedback.MOUSE_UP:
            # the other clients learn the new place at the end of a drag only
            self._server.applyChanges()
            if self._menu.goal is None:
                return
        self._menu.drag(pose)
        self._wake()

    def _read(self, feedback: InteractiveMarkerFeedback) -> Pose:
        frame = feedback.header.frame_id
        if frame not in ("", self._frame):
            raise PayloadError("pose", f"marker pose in frame {frame}; expected {self._frame}, as the marker is")
        pose = pose_from_msg(feedback.pose)
        if not np.isfinite(pose.position).all():
            raise PayloadError("pose", f"marker at {pose.position.tolist()} m; expected finite numbers")
        return pose

    def on_click(self, feedback: InteractiveMarkerFeedback) -> None:
        """Take a click on the marker's menu."""
        self._menu.on_feedback(feedback)

    def on_scene(self, message: SceneMsg) -> None:
        """Take the scene in which poses are judged."""
        try:
            self._scene = scene_from_msg(message)
        except SceneError as error:
            self._diagnostics.refuse("scene", str(error))
            self._scene = None
        self._wake()

    def _wake(self) -> None:
        with self._news:
            self._pending = True
            self._news.notify_all()

    def _show_text(self, sentence: str) -> None:
        with self._news:
            self._shown_text = sentence
            self._news.notify_all()

    # -- the worker

    def _drop_reached_goal(self) -> None:
        """Drop the goal when a plan has brought the tool there."""
        execution = self._listener.newest("execution")
        if execution is None or execution.outcome != "finished" or execution.state != Execution.IDLE:
            return
        if execution.plan_id == self._finished:
            return
        self._finished = execution.plan_id
        plan = self._listener.plan(execution.plan_id)
        if plan is not None:
            self._menu.reached(self._chain.forward(plan.trajectory.positions[-1]))

    def _follow(self) -> None:
        try:
            tool = self._chain.forward(self._twin.pose(MAX_POSE_AGE))
        except (PoseUnknownError, PayloadError) as error:
            self._verdict, self._fault = None, str(error)
            return
        if self._place is None or moved(self._place, tool):
            self._place_marker(tool)

    def _place_marker(self, tool: Pose) -> None:
        if self._place is None:
            marker = tool_marker(self._frame, pose_to_msg(tool), self._settings.scale)
            self._server.insert(marker, self._on_feedback)
            self._menu.attach(self._server, NAME)
        else:
            self._server.setPose(NAME, pose_to_msg(tool))
        self._server.applyChanges()
        self._place = tool
        self._wake()

    def _judge(self, pose: Pose | None, scene: Scene | None) -> None:
        if pose is None:
            return
        self._place = pose
        try:
            if scene is None:
                raise SceneError("the scene", None, "one on the topic scene; is the scene node running?")
            seed = self._twin.pose(MAX_POSE_AGE)
            self._verdict = judge_pose(pose, seed, self._solver, self._world_of(scene))
        except ConstructionTwinError as error:
            self._verdict, self._fault = None, str(error)

    def _world_of(self, scene: Scene) -> CollisionWorld:
        if self._world is None:
            self._world = CollisionWorld(self._robot, scene, self._self_collision)
        elif self._world.scene.hash != scene.hash:
            self._world = self._world.with_scene(scene)
        return self._world

    def _draw(self) -> None:
        if self._place is None:
            return
        verdict, plan = self._verdict, self._listener.under_review()
        lines = [self._fault if verdict is None else verdict.sentence, self._shown_text]
        if plan is not None:
            lines.append(waiting_plan(plan))
        reach = None if verdict is None else verdict.reach
        markers = verdict_markers(self._frame, pose_to_msg(self._place), self._settings.scale, reach, lines)
        if markers != self._drawn:
            self._drawn = markers
            self._verdicts.publish(markers)
        self._menu.show("" if plan is None else plan.id)

    def diagnose(self) -> Diagnosis:
        """Return the state for `/diagnostics`."""
        verdict = self._verdict
        if verdict is None:
            return Diagnosis(WARN, self._fault)
        free = "free" if verdict.reach is Reach.FREE else "not free"
        return Diagnosis(
            OK, f"{'follows the tool' if self._menu.goal is None else f'goal is {free}'}: {verdict.sentence}"
        )


INTERFACE = shell.Interface(
    diagnose=ToolMarkerNode.diagnose,
    publishes=(shell.Publication("tool_marker/verdict", MarkerArray, queue_size=2, latch=True),),
    polls=(shell.PolledPose("twin/joint_states"),),
    subscribes=(
        shell.Subscription("scene", SceneMsg, ToolMarkerNode.on_scene, queue_size=1),
        shell.Subscription("tool_marker/feedback", InteractiveMarkerFeedback, ToolMarkerNode.on_click, queue_size=50),
    ),
    listeners=REPORTS,
)
NODE = shell.NodeShell("tool_marker", Settings, ToolMarkerNode, INTERFACE)
main = NODE.run

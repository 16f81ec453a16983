"""tool_marker: the operator's handle in rviz: shows whether the arm can go where it is dragged; its menu plans, reviews, stops."""

from __future__ import annotations

import getpass
import math
import textwrap
import threading
import time
from collections.abc import Callable, Sequence
from typing import Annotated

import numpy as np
import pydantic
import rospy
from geometry_msgs.msg import Point, Quaternion, Vector3
from geometry_msgs.msg import Pose as PoseMsg
from interactive_markers.interactive_marker_server import InteractiveMarkerServer
from interactive_markers.menu_handler import MenuHandler
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import (
    InteractiveMarker,
    InteractiveMarkerControl,
    InteractiveMarkerFeedback,
    Marker,
    MarkerArray,
)

from construction_twin.core.errors import ConstructionTwinError, PayloadError, PoseUnknownError, RequestRefused
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.link.requests import GoalRequest, ReviewRequest
from construction_twin.msg import Execution
from construction_twin.msg import Scene as SceneMsg
from construction_twin.robot.description import RobotModel
from construction_twin.robot.motion_errors import KinematicsError, SceneError
from construction_twin.robot.plan import Plan
from construction_twin.ros.messages.convert import pose_from_msg, pose_to_msg
from construction_twin.ros.messages.scene_convert import scene_from_msg, tf_frame
from construction_twin.ros.messages.services import Outcome, pose_fields
from construction_twin.ros.shared import node_shell as shell
from construction_twin.ros.shared.diagnostics import OK, WARN, Diagnosis
from construction_twin.ros.shared.robot_client import REPORTS, OperatorClient, RobotListener
from construction_twin.ros.transport.subscriber import PUBLISHER, caller_of
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import read_self_collision
from construction_twin.validation import StrictModel
from construction_twin.views.reachability import PoseVerdict, Reach, judge_pose
from construction_twin.views.texts import waiting_plan

#: A tool that has moved less is not followed [m, and elements of the rotation].
STILL = 1e-6
#: A plan that ends within this of the goal was the plan to this goal [m, and elements of the rotation].
REACHED = 1e-3
#: How long a plan must have been shown before the menu approves or rejects it [s]: a plan that came with the click was not seen.
SHOWN = 1.0
#: The entry that counts from every client; see `ToolMarkerMenu.on_feedback`.
STOP = "Stop"


def in_thread(title: str, action: Callable[[], None]) -> None:
    """Run an action in a thread of its own, so that a stop waits for no other action."""
    threading.Thread(target=action, name=title, daemon=True).start()


def moved(before: Pose, after: Pose, tolerance: float = STILL) -> bool:
    """Return whether two poses differ by more than a tolerance [m, and elements of the rotation]."""
    position, rotation = np.abs(after.position - before.position), np.abs(after.rotation - before.rotation)
    return bool(position.max() > tolerance or rotation.max() > tolerance)


class ToolMarkerMenu:
    """Carries out what an operator chooses, by `run(title, action)`; `home` in [rad], [m]."""

    def __init__(
        self,
        client: OperatorClient,
        under_review: Callable[[], Plan | None],
        home: Sequence[float],
        reviewer: str,
        show_text: Callable[[str], None],
        run: Callable[[str, Callable[[], None]], None] = in_thread,
    ):
        self._client = client
        self._under_review = under_review
        #: Where the marker was dragged to, as ``base_T_tool``; None: it follows the tool.
        self.goal: Pose | None = None
        self._dragging = threading.Lock()
        self._reviewer = reviewer
        self._show_text = show_text
        self._run = run
        self._planning = threading.Lock()
        # the plan that the operator sees, empty: none, and since when [s, monotonic]
        self._shown = "", 0.0
        self._actions: dict[str, Callable[[], Outcome]] = {
            "Plan": lambda: self._plan(lambda: self._pose_request("pose")),
            "Plan straight line": lambda: self._plan(lambda: self._pose_request("line")),
            "Preview": client.preview,
            "Approve": lambda: self._review("approved"),
            "Reject": lambda: self._review("rejected"),
            STOP: lambda: client.trigger("stop"),
            "Plan to home": lambda: self._plan(lambda: GoalRequest("joints", joints=tuple(home))),
            "Back to the tool": self._back,
        }
        self._menu = MenuHandler()
        # the marker server ignores a second rviz for a second after the first one's last message; a stop must not be lost, so that
        # entry does nothing here, and on_feedback hears it from every rviz
        calls = {title: lambda _, title=title: None if title == STOP else self.choose(title) for title in self._actions}
        self._entries = {title: self._menu.insert(title, callback=call) for title, call in calls.items()}

    def attach(self, server: InteractiveMarkerServer, marker: str) -> None:
        """Give a marker of a server this menu."""
        self._menu.apply(server, marker)

    def on_feedback(self, feedback: InteractiveMarkerFeedback) -> None:
        """Carry out a stop of any rviz; the rest is the marker server's."""
        if feedback.event_type == feedback.MENU_SELECT and feedback.menu_entry_id == self._entries[STOP]:
            self.choose(STOP)

    def show(self, plan_id: str) -> None:
        """Store which plan the operator sees now; empty: none."""
        if plan_id != self._shown[0]:
            self._shown = plan_id, time.monotonic()

    def drop_reached_goal(self, end: Pose) -> None:
        """Drop the goal if a motion has ended there; a goal that was dragged further meanwhile stays."""
        with self._dragging:
            if self.goal is not None and not moved(self.goal, end, REACHED):
                self.goal = None

    def drag(self, pose: Pose) -> None:
        """Set a new goal."""
        with self._dragging:
            self.goal = pose

    def choose(self, title: str) -> None:
        """Carry out an entry, and tell the operator how it ended."""
        self._run(title, lambda: self._carry_out(title))

    def _carry_out(self, title: str) -> None:
        self._show_text(f"{title} ...")
        try:
            sentence = self._actions[title]().message
        except ConstructionTwinError as error:
            rospy.logwarn("%s: %s", title, error)
            self._show_text(f"{title}: {error}")
            return
        except rospy.ROSInterruptException:
            return  # the node ends
        rospy.loginfo("%s: %s", title, sentence)
        self._show_text(f"{title}: {sentence}")

    def _plan(self, request: Callable[[], GoalRequest]) -> Outcome:
        if not self._planning.acquire(blocking=False):
            raise RequestRefused("a plan is being made already; wait for it")
        try:
            return self._client.plan(request())
        finally:
            self._planning.release()

    def _pose_request(self, kind: str) -> GoalRequest:
        pose = self.goal
        if pose is None:
            raise RequestRefused("the marker is at the tool; drag it to a goal first")
        return GoalRequest(kind, **pose_fields(pose))

    def _review(self, verdict: str) -> Outcome:
        plan = self._under_review()
        if plan is None:
            raise RequestRefused("no plan waits for approval; plan one first")
        shown, since = self._shown
        if shown != plan.id or time.monotonic() - since < SHOWN:
            raise RequestRefused(f"plan {plan.id[:8]} has only just come; look at it, then choose again")
        return self._client.review(ReviewRequest(plan.id, plan.hash, verdict, self._reviewer, "by the marker's menu"))

    def _back(self) -> Outcome:
        self.goal = None
        return Outcome(True, "the marker follows the tool")


class MarkerServer(InteractiveMarkerServer):
    """As `InteractiveMarkerServer`, but played-back clicks are `refused(reason, sentence)`."""

    def __init__(self, topic: str, refused: Callable[[str, str], None]):
        self._refused = refused
        super().__init__(topic)

    def keepAlive(self, msg: object) -> None:  # noqa: N802 (the name of its base class)
        """Announce the server; at shutdown its topic may be closed already."""
        try:
            super().keepAlive(msg)
        except rospy.ROSException:
            if not rospy.core.is_shutdown_requested():
                raise

    def processFeedback(self, feedback: InteractiveMarkerFeedback) -> None:  # noqa: N802 (the name of its base class)
        """Handle what a client sent, if it is the client's own."""
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


class Settings(StrictModel):
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
        """Handle a click on the marker's menu."""
        self._menu.on_feedback(feedback)

    def on_scene(self, message: SceneMsg) -> None:
        """Store the scene in which poses are judged."""
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
            self._menu.drop_reached_goal(self._chain.forward(plan.trajectory.positions[-1]))

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

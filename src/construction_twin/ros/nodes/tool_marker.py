"""tool_marker: the operator's handle in rviz: drag it, see at once whether the arm can go there; plan, review, stop by its menu."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Annotated

import numpy as np
import pydantic
import rospy
from geometry_msgs.msg import Pose as PoseMsg
from interactive_markers.interactive_marker_server import InteractiveMarkerServer
from interactive_markers.menu_handler import MenuHandler
from visualization_msgs.msg import InteractiveMarkerFeedback, MarkerArray

from construction_twin.core.errors import ConstructionTwinError, PayloadError, PoseUnknownError, RequestRefused
from construction_twin.core.motion_errors import KinematicsError, SceneError
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.msg import Execution
from construction_twin.msg import Scene as SceneMsg
from construction_twin.ros.messages.convert import pose_from_msg
from construction_twin.ros.messages.scene_convert import scene_from_msg, tf_frame
from construction_twin.ros.shared.diagnostics import OK, WARN, NodeDiagnostics
from construction_twin.ros.shared.node import run_node
from construction_twin.ros.shared.operator_client import OperatorClient, pose_to_msg
from construction_twin.ros.shared.params import read_parameters, robot_from_parameters
from construction_twin.ros.shared.robot_listener import RobotListener
from construction_twin.ros.shared.tool_marker_shapes import NAME, tool_marker, verdict_markers
from construction_twin.ros.transport.latest_pose import LatestPose
from construction_twin.ros.transport.publisher import Publisher
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene
from construction_twin.scene.self_collision import read_self_collision
from construction_twin.views.reachability import PoseVerdict, Reach, judge_pose

#: How often the marker follows the tool while nobody has dragged it, and the texts are renewed [s].
PERIOD = 0.1
#: A tool that has moved less is not followed; a goal as near to a plan's end was the plan's [m, and elements of the rotation].
_STILL, _REACHED = 1e-6, 1e-3
#: How long a plan must have been shown before the menu decides about it [s]: nobody has looked at one that came with the click.
SHOWN = 1.0

_Positive = Annotated[float, pydantic.Field(gt=0.0, allow_inf_nan=False)]


class Settings(pydantic.BaseModel):
    """Private parameters: behaviour in config/tool_marker.yaml; `self_collision`, `tf_prefix`, `reviewer` in the launch file.

    Attributes
    ----------
    scale : float
        [m]
    max_pose_age, ik_budget, service_timeout : float
        [s]
    self_collision : str
        YAML of the link pairs that are not checked.
    tf_prefix : str
        Of the tf frames of the robot's links; empty: none.
    reviewer : str
        Who approves and rejects by the menu.
    """

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    scale: _Positive
    max_pose_age: _Positive
    ik_budget: Annotated[float, pydantic.Field(gt=0.0, le=10.0)]
    service_timeout: _Positive
    self_collision: str
    tf_prefix: str
    reviewer: Annotated[str, pydantic.Field(min_length=1)]


class ToolMarkerNode:
    """Interactive marker `tool_marker`, markers `tool_marker/verdict`; calls the services an operator would."""

    def __init__(self):
        self._settings = read_parameters(Settings)
        self._robot = robot_from_parameters()
        self._chain = Chain(self._robot)
        ik = IkSettings(budget_s=self._settings.ik_budget)
        self._solver = inverse_kinematics(Chain(self._robot), ik, np.random.default_rng(0), time.monotonic)
        self._self_collision = read_self_collision(self._settings.self_collision, self._robot)
        self._frame = tf_frame(self._settings.tf_prefix, self._robot.base_link)
        self._news = threading.Condition()
        self._scene: Scene | None = None
        self._world: CollisionWorld | None = None
        # the goal: None while the marker follows the tool
        self._goal: Pose | None = None
        self._pending = False
        self._place: Pose | None = None
        self._verdict: PoseVerdict | None = None
        self._problem = "the twin's pose is not known yet"
        self._said = ""
        self._finished = ""
        self._planning = threading.Lock()
        self._client = OperatorClient(
            rospy.get_namespace(), self._settings.service_timeout, "tool_marker"
        )
        self._listener = RobotListener(rospy.get_namespace(), self._robot)
        self._diagnostics = NodeDiagnostics(self._robot.name, self._report)
        self._verdicts = Publisher("tool_marker/verdict", MarkerArray, queue_size=2, latch=True)
        self._drawn: MarkerArray | None = None
        # the plan that the text names, and since when
        self._shown: tuple[str, float] = ("", 0.0)
        self._server = InteractiveMarkerServer("tool_marker")
        self._menu = self._make_menu()
        self._twin = LatestPose("twin/joint_states", self._robot.joint_names, self._diagnostics.refuse)
        rospy.Subscriber("scene", SceneMsg, self._on_scene, queue_size=1)
        rospy.Subscriber("tool_marker/feedback", InteractiveMarkerFeedback, self._on_any_feedback, queue_size=50)

    def run(self) -> None:
        """Judge the newest pose, or follow the tool, until shutdown."""
        while not rospy.is_shutdown():
            with self._news:
                self._news.wait_for(lambda: self._pending, PERIOD)
                dragged, self._pending = self._pending, False
                goal, scene = self._goal, self._scene
            if not dragged:
                goal = self._follow(goal)
            # what could not be judged is tried again
            self._judge(goal if goal is not None else self._place, scene, dragged or self._verdict is None)
            self._draw()

    # -- what rviz sends: nothing here waits

    def _on_feedback(self, feedback: InteractiveMarkerFeedback) -> None:
        if feedback.event_type not in (feedback.POSE_UPDATE, feedback.MOUSE_UP):
            return
        try:
            pose = self._read(feedback)
        except (KinematicsError, PayloadError) as error:
            self._diagnostics.refuse("pose", str(error))
            return
        if feedback.event_type == feedback.MOUSE_UP:
            # every other rviz learns the new place; while somebody drags, the place is his alone
            self._server.applyChanges()
            if self._goal is None:
                return
        with self._news:
            self._goal, self._pending = pose, True
            self._news.notify_all()

    def _read(self, feedback: InteractiveMarkerFeedback) -> Pose:
        frame = feedback.header.frame_id
        if frame not in ("", self._frame):
            raise PayloadError("pose", f"marker pose in frame {frame!r}; expected {self._frame!r}, as the marker is")
        pose = pose_from_msg(feedback.pose)
        if not np.isfinite(pose.position).all():
            raise PayloadError("pose", f"marker at {pose.position.tolist()} m; expected finite numbers")
        return pose

    def _on_scene(self, message: SceneMsg) -> None:
        try:
            scene = scene_from_msg(message)
        except SceneError as error:
            self._diagnostics.refuse("scene", str(error))
            scene = None
        with self._news:
            self._scene, self._pending = scene, True
            self._news.notify_all()

    # -- the menu

    def _make_menu(self) -> MenuHandler:
        menu = MenuHandler()
        entries = {
            "Plan": self._planned(lambda: self._client.plan_to_pose(self._demand_goal())),
            "Plan straight line": self._planned(lambda: self._client.plan_line(self._demand_goal())),
            "Preview": self._client.preview,
            "Approve": lambda: self._review(True),
            "Reject": lambda: self._review(False),
            "Stop": None,
            "Plan to home": self._planned(lambda: self._client.plan_to_joints(self._robot.home)),
            "Back to the tool": self._back,
        }
        for title, action in entries.items():
            if action is None:
                # the markers' server is deaf to a second rviz for a second after the first one's last word; a stop must not be lost
                self._stop_entry = menu.insert(title, callback=lambda _: None)
            else:
                menu.insert(title, callback=lambda _, title=title, action=action: self._start(title, action))
        return menu

    def _on_any_feedback(self, feedback: InteractiveMarkerFeedback) -> None:
        if feedback.event_type == feedback.MENU_SELECT and feedback.menu_entry_id == self._stop_entry:
            self._start("Stop", lambda: self._client.trigger("stop"))

    def _start(self, title: str, action: Callable[[], str]) -> None:
        """Do something in a thread of its own: a stop waits for nobody."""
        threading.Thread(target=self._do, args=(title, action), name=title, daemon=True).start()

    def _do(self, title: str, action: Callable[[], str]) -> None:
        self._say(f"{title} ...")
        try:
            sentence = action()
        except ConstructionTwinError as error:
            rospy.logwarn("%s: %s", title, error)
            self._say(f"{title}: {error}")
            return
        except rospy.ROSInterruptException:
            return  # the node ends
        rospy.loginfo("%s: %s", title, sentence)
        self._say(f"{title}: {sentence}")

    def _planned(self, request: Callable[[], str]) -> Callable[[], str]:
        """Return a request for a plan that is refused while another one is under way."""

        def ask() -> str:
            if not self._planning.acquire(blocking=False):
                raise RequestRefused("a plan is being made already; wait for it")
            try:
                return request()
            finally:
                self._planning.release()

        return ask

    def _demand_goal(self) -> Pose:
        if self._goal is None:
            raise RequestRefused("the marker is at the tool; drag it to a goal first")
        return self._goal

    def _review(self, approve: bool) -> str:
        plan = self._listener.under_review()
        if plan is None:
            raise RequestRefused("no plan waits for approval; plan one first")
        shown, since = self._shown
        if shown != plan.id or time.monotonic() - since < SHOWN:
            raise RequestRefused(f"plan {plan.id[:8]} has only just come; look at it, then choose again")
        return self._client.review(plan.id, plan.hash, approve, self._settings.reviewer, "by the marker's menu")

    def _back(self) -> str:
        with self._news:
            self._goal = None
        return "the marker follows the tool"

    # -- the worker

    def _follow(self, goal: Pose | None) -> Pose | None:
        """Let the marker go where the tool is, unless it has a goal; a goal that was reached is none any more."""
        execution = self._listener.newest("execution")
        ended = execution is not None and execution.outcome == "finished" and execution.state == Execution.IDLE
        if ended and execution.plan_id != self._finished:
            self._finished = execution.plan_id
            if goal is not None and self._led_to(execution.plan_id, goal):
                with self._news:
                    if self._goal is goal:  # it may have been dragged further meanwhile
                        self._goal = None
                    goal = self._goal
        if goal is not None:
            return goal
        try:
            tool = self._chain.forward(self._twin.pose(self._settings.max_pose_age))
        except (PoseUnknownError, PayloadError) as error:
            self._verdict, self._problem = None, str(error)
            return None
        if self._place is None or _moved(self._place, tool):
            self._put(tool)
        return None

    def _led_to(self, plan_id: str, goal: Pose) -> bool:
        """Return whether a plan that has ended was the one to this goal."""
        plan = self._listener.plan(plan_id)
        return plan is not None and not _moved(goal, self._chain.forward(plan.trajectory.positions[-1]), _REACHED)

    def _put(self, tool: Pose) -> None:
        if self._place is None:
            marker = tool_marker(self._frame, pose_to_msg(tool), self._settings.scale)
            self._server.insert(marker, self._on_feedback)
            self._menu.apply(self._server, NAME)
        else:
            self._server.setPose(NAME, pose_to_msg(tool))
        self._server.applyChanges()
        self._place = tool
        self._pending = True

    def _judge(self, pose: Pose | None, scene: Scene | None, asked: bool) -> None:
        if pose is None or not asked:
            return
        self._place = pose
        try:
            if scene is None:
                raise SceneError("the scene", None, "one on the topic scene; is the scene node running?")
            seed = self._twin.pose(self._settings.max_pose_age)
            self._verdict = judge_pose(pose, seed, self._solver, self._world_of(scene))
        except ConstructionTwinError as error:
            self._verdict, self._problem = None, str(error)

    def _world_of(self, scene: Scene) -> CollisionWorld:
        if self._world is None:
            self._world = CollisionWorld(self._robot, scene, self._self_collision)
        elif self._world.scene.hash != scene.hash:
            self._world = self._world.with_scene(scene)
        return self._world

    # -- what the operator sees

    def _say(self, sentence: str) -> None:
        with self._news:
            self._said = sentence
            self._news.notify_all()

    def _draw(self) -> None:
        if self._place is None:
            return
        verdict, plan = self._verdict, self._listener.under_review()
        shown = plan.id if plan is not None else ""
        lines = [verdict.sentence if verdict is not None else self._problem, self._said]
        if plan is not None:
            clearance = plan.report.clearance.distance
            close = f", closest {clearance * 1e3:.0f} mm" if math.isfinite(clearance) else ""
            lines.append(f"plan {plan.id[:8]} waits for approval: {plan.trajectory.duration:.1f} s{close}")
        reach = verdict.reach if verdict is not None else None
        place: PoseMsg = pose_to_msg(self._place)
        markers = verdict_markers(self._frame, place, self._settings.scale, reach, lines)
        if markers != self._drawn:
            self._drawn = markers
            self._verdicts.publish(markers)
        if shown != self._shown[0]:
            self._shown = shown, time.monotonic()

    def _report(self) -> tuple[int, str, dict]:
        verdict = self._verdict
        if verdict is None:
            return WARN, self._problem, {}
        free = "free" if verdict.reach is Reach.FREE else "not free"
        return OK, f"{'follows the tool' if self._goal is None else f'goal is {free}'}: {verdict.sentence}", {}


def _moved(before: Pose, after: Pose, least: float = _STILL) -> bool:
    return bool(
        np.abs(after.position - before.position).max() > least or np.abs(after.rotation - before.rotation).max() > least
    )


def main() -> None:
    """Run the node."""
    run_node("tool_marker", ToolMarkerNode)

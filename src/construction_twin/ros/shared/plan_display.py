"""The plan under review and its rehearsal, as rviz shows them, and the ghost that plays the plan."""

from __future__ import annotations

import threading
import time
from bisect import bisect_left

from visualization_msgs.msg import Marker, MarkerArray

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.kinematics.chain import Chain
from construction_twin.msg import Execution, Plan, Rehearsal, Review
from construction_twin.msg import Scene as SceneMsg
from construction_twin.review.rehearsal_report import RehearsalReport, is_consistent
from construction_twin.robot.description import RobotModel
from construction_twin.robot.motion_errors import SceneError
from construction_twin.robot.plan import Plan as MadePlan
from construction_twin.ros.messages.convert import change_from_msg, plan_from_msg
from construction_twin.ros.messages.display_markers import (
    grip_markers,
    headline_height,
    plan_markers,
    rehearsal_markers,
)
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.messages.scene_convert import scene_from_msg
from construction_twin.ros.shared.node_shell import NodeIO
from construction_twin.scene.collision_bodies import RobotBodies
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_change import SceneChange
from construction_twin.srv import PreviewPlanRequest
from construction_twin.views.preview import Preview, WorkStates, work_states

#: How long a preview waits for the plan that was made just before [s].
PLAN_TIMEOUT = 1.0


class PlanDisplay:
    """ROS around a Preview; `tf_prefix`: of the ghost's frames."""

    def __init__(self, robot: RobotModel, shapes: list[Marker], tf_prefix: str, node_io: NodeIO):
        self._robot, self._shapes, self._tf_prefix = robot, shapes, tf_prefix
        self._chain = Chain(robot)
        self._markers = node_io.publishers["plan_markers"]
        self._refuse = node_io.diagnostics.refuse
        self._preview = Preview()
        self._scene: Scene | None = None
        self._changes: dict[str, tuple[SceneChange, ...]] = {}
        self._states: WorkStates | None = None
        self._gripped: tuple[SceneObject, ...] = ()
        self._still: list[Marker] = []
        self._rehearsed: list[Marker] = []
        #: The newest: it may come before its plan, and never after the next plan's.
        self._report: RehearsalReport | None = None
        #: Made for the first rehearsal.
        self._bodies: RobotBodies | None = None
        self._rehearsal_drawn: tuple[str, str, bool] | None = None
        self._news = threading.Condition()
        self._frame = ""
        self._drawn: str | None = None

    @property
    def plan_id(self) -> str:
        """The plan that is shown; empty: none."""
        plan = self._preview.plan
        return "" if plan is None else plan.id

    def on_plan(self, message: Plan) -> None:
        """Show a plan."""
        try:
            plan = plan_from_msg(message)
            changes = tuple(map(change_from_msg, message.segments))
        except ConstructionTwinError as error:
            self._refuse("plan", str(error))
            return
        with self._news:
            self._frame = message.header.frame_id
            self._changes = {plan.id: changes}
            self._preview.on_plan(plan)
            self._draw()
            self._news.notify_all()

    def on_scene(self, message: SceneMsg) -> None:
        """Store the scene in which a work plan may begin."""
        try:
            scene = scene_from_msg(message)
        except SceneError as error:
            self._refuse("scene", str(error))
            return
        with self._news:
            self._scene = scene
            plan = self._preview.under_review
            # after a start of this node the plan may come before the scene that it begins in
            if plan is not None and plan.scene == scene.hash:
                if plan.segments:
                    self._drawn = None
                self._draw()

    def on_rehearsal(self, message: Rehearsal) -> None:
        """Show what the rehearsal of the plan under review has found."""
        report = from_msg(RehearsalReport, message)
        if not is_consistent(report) or len(report.worst_pose) not in (0, len(self._robot.joint_names)):
            self._refuse("rehearsal", f"the rehearsal of plan {report.plan_id!r} is not what its hash says")
            return
        with self._news:
            self._report = report
            self._draw_rehearsal()

    def on_review(self, message: Review) -> None:
        """Remove a rejected plan."""
        with self._news:
            self._preview.on_verdict(message.plan_id, message.approved)
            self._draw()

    def on_execution(self, message: Execution) -> None:
        """Remove what was played."""
        if not message.plan_id:
            return
        with self._news:
            self._preview.on_verdict(message.plan_id, True)
            if message.outcome:
                self._preview.on_ending(message.plan_id)
            self._draw()

    def on_preview(self, request: PreviewPlanRequest) -> str:
        """Play the plan under review with the ghost."""
        with self._news:
            if request.speed > 0.0:
                self._news.wait_for(lambda: self._preview.under_review is not None, PLAN_TIMEOUT)
            return self._preview.play(request.speed, request.loop, time.monotonic())

    def ghost(self, now: float, twin: tuple[float, ...] | None) -> tuple[float, ...] | None:
        """Return where the ghost is at a monotonic time [s]; None before the twin has a pose and without a plan."""
        with self._news:
            if twin is not None:
                self._preview.on_twin(twin)
            self._grip(now)
            return self._preview.pose(now)

    def _draw(self) -> None:
        self._draw_plan()
        self._draw_rehearsal()

    def _draw_plan(self) -> None:
        plan = self._preview.plan
        name = None if plan is None else plan.id
        if name == self._drawn:
            return
        self._drawn = name
        self._still, self._states = [], None
        self._gripped = ()
        if plan is not None:
            changes, chain = self._changes.get(plan.id, ()), self._chain
            self._states = work_states(plan, changes, self._scene) if plan.segments else None
            self._still += plan_markers(plan, chain, self._frame, headline_height(chain), changes, self._states)
        self._publish()
        self._grip(time.monotonic())

    def _draw_rehearsal(self) -> None:
        plan, report = self._preview.under_review, self._report
        rehearsed = report and (report.plan_id, report.plan_hash, report.scene)
        if plan is None or report is None or rehearsed != (plan.id, plan.hash, plan.scene):
            if self._rehearsal_drawn is not None:
                self._rehearsal_drawn, self._rehearsed = None, []
                self._publish()
            return
        carried = self._carried(plan, report.worst_time)
        drawn = report.plan_id, report.hash, bool(carried)
        if drawn == self._rehearsal_drawn:
            return
        self._rehearsal_drawn = drawn
        if self._bodies is None:
            self._bodies = RobotBodies(self._robot)
        link_pose, length = self._bodies.link_pose, self._chain.arm_length
        self._rehearsed = rehearsal_markers(report, self._shapes, link_pose, length, carried, self._frame)
        self._publish()

    def _carried(self, plan: MadePlan, at: float) -> tuple[SceneObject, ...]:
        """Return what the arm carries at a time of a plan [s], where the scene that it begins in is known."""
        if self._states is not None:
            ends = [segment.end for segment in plan.segments]
            return self._states.carried[min(bisect_left(ends, at), len(ends) - 1)]
        if self._scene is None or self._scene.hash != plan.scene:
            return ()
        return tuple(item for item in self._scene.objects if item.link)

    def _grip(self, now: float) -> None:
        """Let the ghost carry what the arm will carry where the ghost is; the twin shows what is carried during execution."""
        gripped: tuple[SceneObject, ...] = ()
        if self._states is not None and self._preview.under_review is not None:
            number = self._preview.segment(now)
            gripped = self._states.carried[-1 if number is None else number]
        if gripped != self._gripped:
            self._gripped = gripped
            self._publish()

    def _publish(self) -> None:
        """Publish all markers in one message: a late subscriber receives the last one only."""
        gripped = grip_markers(self._gripped, self._tf_prefix)
        gone = Marker(ns="plan", action=Marker.DELETEALL)
        self._markers.publish(MarkerArray(markers=[gone, *self._still, *gripped, *self._rehearsed]))

"""preview: shows the plan under review in rviz (`plan_markers`), and plays it with a ghost (`preview/joint_states`)."""

from __future__ import annotations

import threading
import time

import pydantic
import rospy
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from construction_twin.core.errors import ConstructionTwinError, PayloadError, PoseUnknownError
from construction_twin.kinematics.chain import Chain
from construction_twin.msg import Execution, Plan, Review
from construction_twin.ros.messages.convert import plan_from_msg
from construction_twin.ros.shared.diagnostics import OK, NodeDiagnostics, Report
from construction_twin.ros.shared.node import Service, run_node
from construction_twin.ros.shared.params import read_parameters, robot_from_parameters
from construction_twin.ros.transport.joint_stream import JointPublisher, now_ns
from construction_twin.ros.transport.latest_pose import LatestPose
from construction_twin.ros.transport.publisher import Publisher
from construction_twin.ros.transport.subscriber import Subscriber
from construction_twin.srv import PreviewPlan, PreviewPlanRequest, PreviewPlanResponse
from construction_twin.views.preview import TEXT_SIZE, PlanPicture, Preview, picture
from construction_twin.views.sync_picture import headline_height

#: How long a preview waits for the plan that was made just before [s].
PLAN_TIMEOUT = 1.0
#: The twin's pose counts as known this long after its last message [s].
TWIN_TIMEOUT = 0.5
PINK = ColorRGBA(1.0, 0.25, 0.65, 1.0)
ORANGE = ColorRGBA(1.0, 0.45, 0.0, 0.9)
DARK = ColorRGBA(0.1, 0.1, 0.15, 1.0)
#: Width of the tool path and diameter of the closest point [m].
LINE_WIDTH, POINT_SIZE = 0.012, 0.06


class Settings(pydantic.BaseModel):
    """Private parameters, given in launch/twin.launch: poses of the ghost per second."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    frame_rate: float = pydantic.Field(ge=1, le=250)


class PreviewNode:
    """ROS around a Preview."""

    def __init__(self):
        settings = read_parameters(Settings)
        self._robot = robot_from_parameters()
        self._chain = Chain(self._robot)
        self._preview = Preview()
        self._news = threading.Condition()
        self._frame = ""
        self._drawn: str | None = None
        self._diagnostics = NodeDiagnostics(self._robot.name, self._report)
        self._ghost = JointPublisher("preview/joint_states", self._robot.joint_names)
        self._markers = Publisher("plan_markers", MarkerArray, queue_size=2, latch=True)
        refuse = self._diagnostics.refuse
        self._twin = LatestPose("twin/joint_states", self._robot.joint_names, refuse)
        Subscriber("review", Review, self._on_review, refuse, queue_size=5)
        Subscriber("execution", Execution, self._on_execution, refuse, queue_size=10)
        Subscriber("plan", Plan, self._on_plan, refuse, queue_size=2)
        Service("preview_plan", PreviewPlan, self._on_preview)
        self._timer = rospy.Timer(rospy.Duration(1 / settings.frame_rate), self._on_timer)

    # -- subscriptions

    def _on_plan(self, message: Plan) -> None:
        try:
            plan = plan_from_msg(message)
        except ConstructionTwinError as error:
            self._diagnostics.refuse("plan", str(error))
            return
        with self._news:
            self._frame = message.header.frame_id
            self._preview.on_plan(plan)
            self._draw()
            self._news.notify_all()

    def _on_review(self, message: Review) -> None:
        with self._news:
            self._preview.on_verdict(message.plan_id, message.approved)
            self._draw()

    def _on_execution(self, message: Execution) -> None:
        if not message.plan_id:
            return
        with self._news:
            self._preview.on_verdict(message.plan_id, True)
            if message.outcome:
                self._preview.on_ending(message.plan_id)
            self._draw()

    # -- the ghost

    def _on_preview(self, request: PreviewPlanRequest) -> PreviewPlanResponse:
        try:
            with self._news:
                if request.speed > 0.0:
                    self._news.wait_for(lambda: self._preview.under_review is not None, PLAN_TIMEOUT)
                sentence = self._preview.play(request.speed, request.loop, time.monotonic())
        except ConstructionTwinError as error:
            rospy.logwarn("preview refused: %s", error)
            return PreviewPlanResponse(False, str(error))
        return PreviewPlanResponse(True, sentence)

    def _on_timer(self, _event) -> None:
        try:
            twin = self._twin.pose(TWIN_TIMEOUT)
        except PoseUnknownError:
            twin = None  # before the first pose there is nothing to hide in; afterwards the ghost stays where it is
        except PayloadError as error:
            self._diagnostics.refuse(error.reason, str(error))
            twin = None
        with self._news:
            if twin is not None:
                self._preview.on_twin(twin)
            pose = self._preview.pose(time.monotonic())
        if pose is not None:
            self._ghost.publish(now_ns(), pose)

    # -- the markers

    def _draw(self) -> None:
        """Publish the markers of another plan than the one drawn, or their removal."""
        plan = self._preview.plan
        name = None if plan is None else plan.id
        if name == self._drawn:
            return
        self._drawn = name
        markers = [Marker(ns="plan", action=Marker.DELETEALL)]
        if plan is not None:
            chain = self._chain
            headline = headline_height(float(chain.shoulder[2]), chain.arm_length)
            markers += plan_markers(picture(plan, chain.skeleton, headline), self._frame)
        self._markers.publish(MarkerArray(markers=markers))

    def _report(self) -> Report:
        plan = self._preview.plan
        return Report(OK, "no plan to show" if plan is None else f"shows plan {plan.id}")


def plan_markers(drawing: PlanPicture, frame: str) -> list[Marker]:
    """Return a plan's markers in the frame of its points: tool path, closest point, text."""
    path = _marker(frame, 0, Marker.LINE_STRIP, PINK, LINE_WIDTH)
    path.points = [Point(*point) for point in drawing.path.tolist()]
    text = _marker(frame, 1, Marker.TEXT_VIEW_FACING, DARK, TEXT_SIZE)
    text.text, text.pose.position = drawing.text, Point(*drawing.text_at)
    if drawing.closest is None:
        return [path, text]
    closest = _marker(frame, 2, Marker.SPHERE, ORANGE, POINT_SIZE)
    closest.pose.position = Point(*drawing.closest)
    return [path, text, closest]


def _marker(frame: str, number: int, kind: int, color: ColorRGBA, size: float) -> Marker:
    marker = Marker(ns="plan", id=number, type=kind, action=Marker.ADD, color=color)
    # stamp 0: with the newest transform, as the plan is valid at any time
    marker.header.frame_id = frame
    marker.pose.orientation.w = 1.0
    marker.scale.x = marker.scale.y = marker.scale.z = size
    return marker


def main() -> None:
    """Run the node."""
    run_node("preview", PreviewNode)

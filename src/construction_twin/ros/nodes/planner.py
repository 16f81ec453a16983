"""ROS shell of the planner: requests in, plans for review out. It commands no motion."""

from __future__ import annotations

import threading
import time
import traceback
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import pydantic
import rospy
import tf2_ros
from geometry_msgs.msg import PoseStamped
from trajectory_msgs.msg import JointTrajectory

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.motion_errors import CartesianPathError, PlanningError, SceneError
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.msg import Plan as PlanMsg
from construction_twin.msg import PlanOutcome
from construction_twin.msg import Scene as SceneMsg
from construction_twin.planning.pipeline import PlanningPipeline
from construction_twin.planning.planner import PlannerSettings, PlanRequest
from construction_twin.robot.plan import Plan
from construction_twin.ros.messages.convert import plan_to_msg, pose_from_msg, pose_from_transform_msg
from construction_twin.ros.messages.plan_requests import (
    check_asked,
    plan_request,
    read_waypoints,
    tool_waypoints,
    trajectory_waypoints,
)
from construction_twin.ros.messages.scene_convert import scene_from_msg, tf_frame
from construction_twin.ros.shared.arm_listener import OtherArm, listen_to_other_arm, neighbour_settings
from construction_twin.ros.shared.diagnostics import OK, WARN, NodeDiagnostics
from construction_twin.ros.shared.node import Service, run_node
from construction_twin.ros.shared.params import read_parameters, robot_from_parameters
from construction_twin.ros.transport.joint_stream import now_ns
from construction_twin.ros.transport.latest_pose import LatestPose
from construction_twin.ros.transport.publisher import Publisher
from construction_twin.ros.transport.subscriber import Subscriber, caller_of
from construction_twin.scene.neighbour import Obstacle
from construction_twin.scene.objects import product
from construction_twin.scene.self_collision import read_self_collision
from construction_twin.srv import (
    PlanCartesian,
    PlanCartesianResponse,
    PlanFromCsv,
    PlanFromCsvResponse,
    PlanToJoints,
    PlanToJointsResponse,
    PlanToPose,
    PlanToPoseResponse,
)


class Settings(PlannerSettings):
    """The node's parameters: the planner's, and what only the node needs.

    Behaviour is explained in config/planner.yaml; `self_collision` and `tf_prefix` are given in launch/twin.launch.

    Attributes
    ----------
    ik_budget, max_pose_age, tf_timeout, scene_timeout : float
        [s]
    self_collision : str
        YAML of the link pairs that are not checked.
    tf_prefix : str
        What stands before the robot's `base_link` in tf; empty: nothing.
    """

    ik_budget: Annotated[float, pydantic.Field(gt=0.0, le=600.0)]
    max_pose_age: Annotated[float, pydantic.Field(gt=0.0)]
    tf_timeout: Annotated[float, pydantic.Field(ge=0.0, le=60.0)]
    scene_timeout: Annotated[float, pydantic.Field(ge=0.0, le=60.0)]
    self_collision: str
    tf_prefix: str


@dataclass(frozen=True)
class Answer:
    """The answer to a request.

    Attributes
    ----------
    success : bool
    sentence : str
    plan_id, plan_hash : str
        Empty without a plan.
    duration : float
        Of the plan [s].
    fraction : float
        Fraction of a tool path that can be followed.
    """

    success: bool
    sentence: str
    plan_id: str = ""
    plan_hash: str = ""
    duration: float = 0.0
    fraction: float = 0.0

    @property
    def fields(self) -> tuple[bool, str, str, str, float]:
        """The fields that all services answer with, in their order."""
        return self.success, self.sentence, self.plan_id, self.plan_hash, self.duration


class PlannerNode:
    """Services `plan_to_joints`, `plan_to_pose`, `plan_cartesian`, `plan_from_csv`; topic `joint_trajectory`.

    Latched topics `plan` and `plan_outcome`; listens to `twin/joint_states`, `scene` and tf.
    """

    def __init__(self):
        self._settings = read_parameters(Settings)
        self._robot = robot_from_parameters()
        self._chain = Chain(self._robot)
        self._beside = neighbour_settings()
        self._pipeline = self._make_pipeline()
        self._base_frame = tf_frame(self._settings.tf_prefix, self._robot.base_link)
        # one request at a time: `plan` latches one plan, and its outcome belongs to it
        self._busy = threading.Lock()
        self._unknown = ""
        self._plans = 0
        self._last = "no plan asked for yet"
        self._diagnostics = NodeDiagnostics(self._robot.name, self._report)
        # it subscribes to the other arm's topics now, to its poses only while a plan is made
        self._other: OtherArm | None = None
        if self._beside is not None:
            refuse = self._diagnostics.refuse
            self._other = listen_to_other_arm(self._robot.name, self._beside, refuse, streams=False)
        self._tf = tf2_ros.Buffer()
        self._tf_listener = tf2_ros.TransformListener(self._tf)
        self._publisher = Publisher("plan", PlanMsg, queue_size=1, latch=True)
        self._outcome_publisher = Publisher("plan_outcome", PlanOutcome, queue_size=1, latch=True)
        refuse = self._diagnostics.refuse
        self._twin = LatestPose("twin/joint_states", self._robot.joint_names, refuse)
        self._scene_subscriber = Subscriber("scene", SceneMsg, self._on_scene, refuse, queue_size=1)
        Subscriber("joint_trajectory", JointTrajectory, self._on_trajectory, refuse, queue_size=10)
        Service("plan_to_joints", PlanToJoints, self._on_plan_to_joints)
        Service("plan_to_pose", PlanToPose, self._on_plan_to_pose)
        Service("plan_cartesian", PlanCartesian, self._on_plan_cartesian)
        Service("plan_from_csv", PlanFromCsv, self._on_plan_from_csv)

    def _make_pipeline(self) -> PlanningPipeline:
        settings = self._settings
        rng = np.random.default_rng(settings.seed or None)
        ik = IkSettings(budget_s=settings.ik_budget)
        return PlanningPipeline(
            self._robot,
            inverse_kinematics(self._chain, ik, rng, time.monotonic),
            settings,
            read_self_collision(settings.self_collision, self._robot),
            time.monotonic,
            rng,
            rospy.resolve_name("scene"),
            self._occupied if self._beside is not None else None,
        )

    def _occupied(self) -> list[Obstacle]:
        """Return the space that the other arm occupies, with the distance that a plan keeps from it.

        If the other arm's pose is not known, this is its whole reach.
        """
        assert self._other is not None and self._beside is not None
        obstacles = self._other.occupied(self._beside.max_pose_age)
        if self._other.unknown:
            self._unknown = f"plans keep clear of the whole reach of {self._beside.name}, because {self._other.unknown}"
            rospy.logwarn("%s", self._unknown)
        return [item.padded(self._beside.padding) for item in obstacles]

    # -- subscriptions

    def _on_scene(self, msg: SceneMsg) -> None:
        try:
            self._pipeline.set_scene(scene_from_msg(msg))
        except SceneError as error:
            self._pipeline.refuse_scene(error)
            self._diagnostics.refuse("scene", str(error))

    # -- requests

    def _on_plan_to_joints(self, request) -> PlanToJointsResponse:
        arrived = now_ns()

        def plan(asked: PlanRequest) -> Plan:
            if request.asked:
                check_asked(asked, arrived)
            return self._pipeline.to_joints(request.start or self._present_pose(), request.goal, asked)

        return PlanToJointsResponse(*self._answer(plan, self._request(request)).fields)

    def _on_plan_to_pose(self, request) -> PlanToPoseResponse:
        def plan(asked: PlanRequest) -> Plan:
            goal = self._goal_in_base(request.goal)
            return self._pipeline.to_pose(self._present_pose(), goal, asked, request.configuration)

        return PlanToPoseResponse(*self._answer(plan, self._request(request)).fields)

    def _on_plan_cartesian(self, request) -> PlanCartesianResponse:
        def plan(asked: PlanRequest) -> Plan:
            path = tool_waypoints(request.waypoints, self._base_T(request.frame_id, rospy.Time(0)))
            return self._pipeline.along(self._present_pose(), path, request.speed or None, asked)

        answer = self._answer(plan, self._request(request))
        success, message, *plan_fields = answer.fields
        return PlanCartesianResponse(success, message, answer.fraction, *plan_fields)

    def _on_plan_from_csv(self, request) -> PlanFromCsvResponse:
        def read() -> Callable[[PlanRequest], Plan]:
            waypoints = read_waypoints(request.path, self._robot)
            return lambda asked: self._pipeline.through(waypoints, self._present_pose(), asked)

        return PlanFromCsvResponse(*self._answer_read(read, self._request(request, request.path)).fields)

    def _on_trajectory(self, msg: JointTrajectory) -> None:
        def read() -> Callable[[PlanRequest], Plan]:
            waypoints = trajectory_waypoints(msg, self._robot)
            return lambda asked: self._pipeline.through(waypoints, self._present_pose(), asked)

        caller = caller_of(msg)
        self._answer_read(read, PlanRequest(str(uuid.uuid4()), now_ns(), f"joint_trajectory from {caller}"))

    def _request(self, request, source: str = "request") -> PlanRequest:
        return plan_request(request, str(uuid.uuid4()), now_ns(), source)

    def _answer(self, make_plan: Callable[[PlanRequest], Plan], asked: PlanRequest) -> Answer:
        """Make and publish a plan; see `_answer_read`."""
        return self._answer_read(lambda: make_plan, asked)

    def _answer_read(self, read: Callable[[], Callable[[PlanRequest], Plan]], asked: PlanRequest) -> Answer:
        """Read what a request refers to, then make and publish a plan. Every failure becomes an answer here."""
        try:
            make_plan = read()  # before taking the lock, so that no request waits while another one reads its file
            with self._busy:
                return self._make(make_plan, asked)
        except ConstructionTwinError as error:
            return self._failed(error, asked, str(error))
        except (ArithmeticError, MemoryError, ValueError) as error:
            # a request that fails with an unexpected exception must get an answer, too
            rospy.logerr("%s", traceback.format_exc())
            kind = type(error).__name__
            return self._failed(error, asked, f"the request cannot be computed ({kind}: {error}); please report it")

    def _make(self, make_plan: Callable[[PlanRequest], Plan], asked: PlanRequest) -> Answer:
        self._unknown = ""
        self._demand_scene()
        try:
            return self._published(make_plan(asked), asked)
        except ConstructionTwinError as error:
            if not self._unknown:
                raise
            # a sentence such as "the start is in collision" is understood only with the reason
            return self._failed(error, asked, f"{error}; {self._unknown}")

    def _demand_scene(self) -> None:
        """Wait for a scene whose publisher is connected: without it, the present surroundings of the arm are not known."""
        seen = self._pipeline.scene
        if not self._scene_subscriber.get_num_connections():
            self._pipeline.forget_scene(seen)
        self._pipeline.wait_for_scene(self._settings.scene_timeout)

    def _published(self, plan: Plan, asked: PlanRequest) -> Answer:
        tool_path = np.array([self._chain.forward(q).position for q in plan.trajectory.positions])
        self._publisher.publish(plan_to_msg(plan, self._base_frame, tool_path))
        sentence = _sentence(plan)
        self._plans += 1
        self._last = sentence
        rospy.loginfo("%s", sentence)
        self._publish_outcome(True, asked, sentence, plan.id)
        return Answer(True, sentence, plan.id, plan.hash, plan.trajectory.duration, 1.0)

    def _failed(self, error: Exception, asked: PlanRequest, sentence: str) -> Answer:
        self._last = f"no plan: {sentence}"
        self._diagnostics.count(type(error).__name__, sentence)
        rospy.logwarn("%s", self._last)
        self._publish_outcome(False, asked, sentence, "")
        fraction = error.fraction if isinstance(error, CartesianPathError) else 0.0
        return Answer(False, sentence, fraction=fraction)

    def _publish_outcome(self, success: bool, asked: PlanRequest, message: str, plan_id: str) -> None:
        outcome = PlanOutcome(success=success, source=asked.source, message=message, plan_id=plan_id)
        outcome.header.stamp = rospy.Time.now()
        self._outcome_publisher.publish(outcome)

    # -- inputs of requests

    def _present_pose(self) -> tuple[float, ...]:
        oldest = self._settings.max_pose_age
        return self._twin.pose(oldest, oldest)

    def _goal_in_base(self, goal: PoseStamped) -> Pose:
        """Return ``base_T_tool`` for a goal in any frame tf knows, at the goal's stamp (0: the latest)."""
        return product(self._base_T(goal.header.frame_id, goal.header.stamp), pose_from_msg(goal.pose))

    def _base_T(self, frame: str, stamp: rospy.Time) -> Pose:  # noqa: N802 (a transform's name)
        """Return the pose of a frame in the robot's base; an empty name is the base itself."""
        if frame in ("", self._base_frame):
            return Pose(np.zeros(3), np.eye(3))
        timeout = rospy.Duration(self._settings.tf_timeout)
        try:
            transform = self._tf.lookup_transform(self._base_frame, frame, stamp, timeout)
        except tf2_ros.TransformException as error:
            raise PlanningError(f"no transform from goal frame {frame!r} to {self._base_frame!r}: {error}") from error
        return pose_from_transform_msg(transform.transform)

    def _report(self) -> tuple[int, str, dict]:
        scene = self._pipeline.scene
        values = {"plans": self._plans, "scene": scene.hash if scene is not None else "none"}
        return OK if scene is not None else WARN, self._last, values


def _sentence(plan: Plan) -> str:
    trajectory, clearance = plan.trajectory, plan.report.clearance
    close = f"closest {clearance.distance:.3f} m at {clearance.time:.2f} s ({' to '.join(clearance.between)})"
    return (
        f"plan {plan.id} for {plan.source!r}: {trajectory.duration:.3f} s, {len(trajectory.times)} waypoints, made by "
        f"{plan.planner} in {plan.planning_time:.3f} s; {close if clearance.between else 'nothing to touch'}; "
        "waiting for review"
    )


def main() -> None:
    """Run the node until shutdown."""
    run_node("planner", PlannerNode)

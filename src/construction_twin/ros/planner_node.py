"""ROS shell of the planner: services in, plans for review out. Nothing here moves anything."""

from __future__ import annotations

import math
import threading
import time
import uuid
from collections.abc import Callable, Sequence
from typing import Annotated

import pydantic
import rospy
import tf2_ros
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import JointState

from construction_twin.errors import ConstructionTwinError, PlanningError
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.msg import Plan as PlanMsg
from construction_twin.planning.planner import Planner, PlannerSettings, PlanRequest
from construction_twin.ros.convert import plan_to_msg, pose_from_msg, pose_from_transform_msg
from construction_twin.ros.diagnostics import OK, NodeDiagnostics
from construction_twin.ros.joint_stream import joint_values, now_ns
from construction_twin.ros.node import run_node
from construction_twin.ros.params import read_parameters, robot_from_parameters
from construction_twin.srv import PlanToJoints, PlanToJointsResponse, PlanToPose, PlanToPoseResponse
from construction_twin.plan import Plan


class Settings(PlannerSettings):
    """The node's parameters: the planner's, and what only the node needs. Explained in config/planner.yaml.

    Attributes
    ----------
    max_pose_age, tf_timeout : float
        [s]
    base_frame : str
        Empty: the robot's `base_link`.
    """

    max_pose_age: Annotated[float, pydantic.Field(gt=0.0)]
    tf_timeout: Annotated[float, pydantic.Field(ge=0.0, le=60.0)]
    base_frame: str


class PlannerNode:
    """Services `plan_to_joints` and `plan_to_pose`, latched topic `plan`; listens to `twin/joint_states` and tf."""

    def __init__(self):
        self._settings = read_parameters(Settings)
        self._robot = robot_from_parameters()
        self._chain = Chain(self._robot)
        self._planner = Planner(self._robot, self._chain, self._settings, clock=time.monotonic)
        self._base_frame = self._settings.base_frame or self._robot.base_link
        self._twin: tuple[float, JointState] | None = None
        self._twin_news = threading.Condition()
        # one plan at a time: planner and kinematics are not made for several threads, and `plan` latches one
        self._busy = threading.Lock()
        self._plans = 0
        self._last = "no plan asked for yet"
        self._diagnostics = NodeDiagnostics(self._robot.name, self._report)
        self._tf = tf2_ros.Buffer()
        self._tf_listener = tf2_ros.TransformListener(self._tf)
        self._publisher = rospy.Publisher("plan", PlanMsg, queue_size=1, latch=True)
        rospy.Subscriber("twin/joint_states", JointState, self._on_twin, queue_size=1, tcp_nodelay=True)
        rospy.Service("plan_to_joints", PlanToJoints, self._on_plan_to_joints)
        rospy.Service("plan_to_pose", PlanToPose, self._on_plan_to_pose)

    def _on_twin(self, msg: JointState) -> None:
        with self._twin_news:
            self._twin = (time.monotonic(), msg)
            self._twin_news.notify_all()

    def _pose_age(self) -> float:
        return math.inf if self._twin is None else time.monotonic() - self._twin[0]

    def _on_plan_to_joints(self, request) -> PlanToJointsResponse:
        def plan() -> Plan:
            start = request.start or self._present_pose()
            return self._planner.plan_to_joints(start, request.goal, _plan_request(request))

        return self._answer(plan, PlanToJointsResponse)

    def _on_plan_to_pose(self, request) -> PlanToPoseResponse:
        def plan() -> Plan:
            start = self._present_pose()
            return self._planner.plan_to_pose(start, self._goal_in_base(request.goal), _plan_request(request))

        return self._answer(plan, PlanToPoseResponse)

    def _answer(self, make_plan: Callable[[], Plan], response: type):
        """Make and publish a plan; the one place where a failure becomes an answer."""
        try:
            with self._busy:
                plan = make_plan()
                self._publish(plan)
        except ConstructionTwinError as error:
            self._last = f"no plan: {error}"
            self._diagnostics.refused[type(error).__name__] += 1
            rospy.logwarn("%s", self._last)
            return response(success=False, message=str(error))
        trajectory = plan.trajectory
        sentence = (
            f"plan {plan.id} for {plan.source!r}: {trajectory.duration:.3f} s, {len(trajectory.times)} waypoints, "
            f"made by {plan.planner} in {plan.planning_time:.3f} s; waiting for review"
        )
        self._plans += 1
        self._last = sentence
        rospy.loginfo("%s", sentence)
        return response(True, sentence, plan.id, plan.hash, trajectory.duration)

    def _publish(self, plan: Plan) -> None:
        tool_path = [self._chain.forward(q).position for q in plan.trajectory.positions]
        self._publisher.publish(plan_to_msg(plan, self._base_frame, tool_path))

    def _present_pose(self) -> Sequence[float]:
        """Return the twin's pose; right after start-up the first one may still be on its way, and is waited for."""
        oldest = self._settings.max_pose_age
        with self._twin_news:
            if not self._twin_news.wait_for(lambda: self._pose_age() <= oldest, oldest):
                topic, age = rospy.resolve_name("twin/joint_states"), self._pose_age()
                found = f"{age:.3f} s old" if math.isfinite(age) else "unknown, nothing was received"
                raise PlanningError(
                    f"the twin's pose on {topic} is {found}; expected one at most {oldest:g} s old, check that the twin runs"
                )
            _, msg = self._twin
        return joint_values(msg, self._robot.joint_names)

    def _goal_in_base(self, goal: PoseStamped) -> Pose:
        """Return ``base_T_tool`` for a goal in any frame tf knows, at the goal's stamp (0: the latest)."""
        pose = pose_from_msg(goal.pose)
        frame = goal.header.frame_id
        if frame in ("", self._base_frame):
            return pose
        try:
            transform = self._tf.lookup_transform(
                self._base_frame, frame, goal.header.stamp, rospy.Duration(self._settings.tf_timeout)
            )
        except tf2_ros.TransformException as error:
            raise PlanningError(f"no transform from goal frame {frame!r} to {self._base_frame!r}: {error}") from error
        base_T_frame = pose_from_transform_msg(transform.transform)
        return Pose(
            position=base_T_frame.position + base_T_frame.rotation @ pose.position,
            rotation=base_T_frame.rotation @ pose.rotation,
        )

    def _report(self) -> tuple[int, str, dict]:
        return OK, self._last, {"plans": self._plans}


def _plan_request(request) -> PlanRequest:
    """Return the request behind either service's; zero and empty mean the default."""
    return PlanRequest(
        plan_id=str(uuid.uuid4()),
        created_ns=now_ns(),
        source=request.source or "request",
        duration=request.duration or None,
        speed_scale=request.speed_scale or None,
        waypoints=request.waypoints or None,
    )


def main() -> None:
    """Run the node until shutdown."""
    run_node("planner", PlannerNode)

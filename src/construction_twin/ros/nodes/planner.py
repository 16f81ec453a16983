"""ROS shell of the planner: requests in, plans for review out. It commands no motion."""

from __future__ import annotations

import functools
import json
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Annotated, Any

import numpy as np
import pydantic
import rospy
from std_srvs.srv import Trigger, TriggerRequest
from trajectory_msgs.msg import JointTrajectory

from construction_twin import msg, srv
from construction_twin.core.extensions import import_extension
from construction_twin.core.freshness import parse_moment, present_moment
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.engagement import scene_obstacle
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.planning.pipeline import PlanningPipeline
from construction_twin.planning.planner import PlannerSettings, PlanRequest
from construction_twin.planning.requests import Answer, PlanRequests
from construction_twin.planning.tool_path import ToolWaypoint
from construction_twin.planning.waypoints import Waypoints, from_points
from construction_twin.planning.work_plan import in_segment
from construction_twin.replay import request_json
from construction_twin.robot.description import RobotModel
from construction_twin.robot.executed_path import ExecutedPath
from construction_twin.robot.motion_errors import PlanningError, SceneError
from construction_twin.robot.plan import Plan
from construction_twin.robot.segments import Signal
from construction_twin.ros.messages.convert import (
    plan_to_msg,
    pose_from_msg,
    trajectory_from_msg,
    work_segment_from_msg,
)
from construction_twin.ros.messages.records import from_msg
from construction_twin.ros.messages.scene_convert import scene_from_msg
from construction_twin.ros.messages.services import Outcome
from construction_twin.ros.nodes.neighbour import neighbour_obstacles
from construction_twin.ros.shared import node_shell as shell
from construction_twin.ros.shared.diagnostics import OK, WARN, Diagnosis
from construction_twin.ros.shared.frames import FRAMES, listen_to_frames
from construction_twin.ros.transport.subscriber import caller_of
from construction_twin.scene.objects import product
from construction_twin.scene.scene_change import SceneChange
from construction_twin.scene.self_collision import read_self_collision


class EngagedError(PlanningError):
    """The arm was left inside an engaged segment of a work plan: only the way back along the executed path can be planned."""

    def __init__(self, task: str, segment: str, reason: str):
        super().__init__(
            Sentence(
                "the arm was left in {segment} of task {task}{why}: only the way back along its path can be planned "
                "(plan_way_back, twin back), until its end, or until release_engagement says that it is free",
                segment=repr(segment),
                task=task,
                why=f" ({reason})" if reason else "",
            )
        )


def plan_request(request, source: str = "request") -> PlanRequest:
    """Return the `PlanRequest` of any service's request; PlanningError for a future moment, or one of another clock."""
    arrived = present_moment()
    asked = parse_moment(request.asked) if getattr(request, "asked", "") else arrived
    if asked.origin != arrived.origin or asked.at > arrived.at:
        raise PlanningError(
            f"the request was asked for at {asked}, expected a moment of this computer before {arrived}; "
            "repeat the `moment` of `execution`, or give none"
        )
    names = ("duration", "speed_scale", "acceleration_scale", "waypoints")
    options: dict[str, Any] = {name: getattr(request, name, None) or None for name in names}
    return PlanRequest(asked=asked, source=request.source or source, **options)


def tool_waypoints(waypoints: Iterable, base_T_frame: Pose) -> list[ToolWaypoint]:
    """Return a Cartesian path in the robot's base; KinematicsError where an orientation is no unit quaternion."""
    path = []
    for message in waypoints:
        via = base_T_frame.position + base_T_frame.rotation @ np.array((message.via.x, message.via.y, message.via.z))
        pose = product(base_T_frame, pose_from_msg(message.pose))
        path.append(ToolWaypoint(pose, via if message.arc else None, message.blend))
    return path


def trajectory_waypoints(message: JointTrajectory, robot: RobotModel) -> Waypoints:
    """Return the waypoints of a trajectory message; raises like `waypoints.from_points`."""
    names = ("positions", "velocities", "accelerations")
    rows, velocities, accelerations = ([getattr(point, name) for point in message.points] for name in names)
    times = [point.time_from_start.to_nsec() / NANOSECONDS for point in message.points]
    return from_points(robot, message.joint_names, rows, velocities, accelerations, times)


#: Oldest pose of the twin that a plan may start from, and longest wait for one [s since its reception].
MAX_POSE_AGE = 0.5
#: How long to wait for a tf transform of a goal given in another frame [s].
TF_TIMEOUT = 1.0
#: How long a request waits for the first scene when the planner has just started [s].
SCENE_TIMEOUT = 5.0


class Settings(PlannerSettings):
    """The planner's parameters (config/planner.yaml), and those of the launch file."""

    ik_budget: Annotated[float, pydantic.Field(gt=0.0, le=600.0)]
    self_collision: str
    tf_prefix: str


class PlannerNode:
    """ROS around a PlanningPipeline: requests by service and topic in, plans out."""

    def __init__(self, settings: Settings, robot: RobotModel, node_io: shell.NodeIO):
        self._robot = robot
        self._chain = Chain(self._robot)
        self._diagnostics, refuse = node_io.diagnostics, node_io.diagnostics.refuse
        rng, ik = np.random.default_rng(settings.seed), IkSettings(budget_s=settings.ik_budget)
        solver = inverse_kinematics(self._chain, ik, rng, time.monotonic)
        pairs, scene = read_self_collision(settings.self_collision, robot), rospy.resolve_name("scene")
        others = neighbour_obstacles(robot, refuse)
        self._pipeline = PlanningPipeline(robot, solver, settings, pairs, time.monotonic, scene, others)
        self._plans = 0
        self._last = "no plan asked for yet"
        self._frames = listen_to_frames(robot, settings.tf_prefix, TF_TIMEOUT, refuse)
        self._publisher, self._outcome_publisher = node_io.publishers["plan"], node_io.publishers["plan_outcome"]
        self._twin = node_io.poses["twin/joint_states"]
        self._engagement: msg.Engagement | None = None
        self._connections = functools.partial(node_io.connections, "scene")
        self._requests = PlanRequests(self._await_surroundings, self._publish)

    def _await_surroundings(self) -> None:
        """Wait for a scene whose publisher is connected: an older one may miss the arm's present surroundings."""
        scene = self._pipeline.scene
        if not self._connections():
            self._pipeline.forget_scene(scene)
        self._pipeline.wait_for_scene(SCENE_TIMEOUT)

    # -- subscriptions

    def on_scene(self, message: msg.Scene) -> None:
        """Store the scene to plan in."""
        try:
            self._pipeline.set_scene(scene_from_msg(message))
        except SceneError as error:
            self._pipeline.refuse_scene(error)
            self._diagnostics.refuse("scene", str(error))

    def on_engagement(self, message: msg.Engagement) -> None:
        """Store whether the arm was left inside an engaged segment."""
        self._engagement = message if message.engaged else None

    def on_review(self, message: msg.Review) -> None:
        """Drop the plan that has its verdict from those that wait."""
        self._requests.on_verdict(message.plan_id)

    # -- requests

    def on_plan_to_joints(self, request: srv.PlanToJointsRequest) -> Outcome:
        """Plan to joint positions."""
        asked = plan_request(request)

        def plan() -> Plan:
            return self._pipeline.to_joints(request.start or self._present_pose(), request.goal, asked)

        return self._answer(asked, lambda: plan)

    def on_plan_to_pose(self, request: srv.PlanToPoseRequest) -> Outcome:
        """Plan to a pose of the tool, in a link or any frame tf knows, at the goal's stamp (0: the latest)."""
        asked = plan_request(request)

        def plan() -> Plan:
            header, pose = request.goal.header, pose_from_msg(request.goal.pose)
            goal = product(self._frames.in_base(header.frame_id, header.stamp), pose)
            return self._pipeline.to_pose(self._present_pose(), goal, asked, request.configuration)

        return self._answer(asked, lambda: plan)

    def on_plan_cartesian(self, request: srv.PlanCartesianRequest) -> Outcome:
        """Plan along a path of the tool."""
        asked = plan_request(request)

        def plan() -> Plan:
            path = tool_waypoints(request.waypoints, self._frames.in_base(request.frame_id, rospy.Time(0)))
            return self._pipeline.along(self._present_pose(), path, request.speed or None, asked)

        return self._answer(asked, lambda: plan)

    def on_plan_trajectory(self, request: srv.PlanTrajectoryRequest) -> Outcome:
        """Plan a motion from elsewhere, from a message or a file."""
        asked = plan_request(request, request.path or f"plan_trajectory from {caller_of(request)}")

        def read() -> Waypoints:
            if not request.path:
                return trajectory_waypoints(request.trajectory, self._robot)
            if request.trajectory.points:
                raise PlanningError("both a trajectory and the path of a file are given; expected one of them")
            return import_extension("planners.waypoint_file").read_waypoints(request.path, self._robot)

        return self._through(asked, read, request.retime)

    def on_trajectory(self, message: JointTrajectory) -> None:
        """Plan a motion from elsewhere; `plan_outcome` has the result."""
        asked = PlanRequest(asked=present_moment(), source=f"joint_trajectory from {caller_of(message)}")
        self._through(asked, lambda: trajectory_waypoints(message, self._robot))

    def _through(self, asked: PlanRequest, read: Callable[[], Waypoints], retime: bool = False) -> Outcome:

        def plan() -> Callable[[], Plan]:
            waypoints = read()
            return lambda: self._pipeline.through(self._present_pose(), waypoints, asked, retime)

        return self._answer(asked, plan)

    def on_plan_work(self, request: srv.PlanWorkRequest) -> Outcome:
        """Plan the segments of a task as one."""
        asked = PlanRequest(asked=present_moment(), source=request.source or f"task {request.task}")
        changes: list[SceneChange] = []

        def read() -> Callable[[], Plan]:
            segments = []
            for number, message in enumerate(request.segments):
                with in_segment(number, message.name):
                    segments.append(work_segment_from_msg(message))
            changes.extend(segment.change for segment in segments)
            return lambda: self._pipeline.work(self._present_pose(), request.task, segments, asked)

        return self._answer(asked, read, changes)

    def on_plan_way_back(self, _request: TriggerRequest) -> Outcome:
        """Plan the way back out of an engaged segment."""
        left = self._engagement
        source = f"way back out of {left.segment!r}: {left.reason}" if left is not None else "way back"
        asked = PlanRequest(asked=present_moment(), source=source)

        def read() -> Callable[[], Plan]:
            if left is None:
                nothing = Sentence(
                    "the arm was not left inside an engaged segment: there is no way back, any motion can be planned"
                )
                raise PlanningError(nothing)
            path = ExecutedPath(trajectory_from_msg(left.trajectory), left.end)
            requires = tuple(from_msg(Signal, signal) for signal in left.requires)

            def plan() -> Plan:
                way_back = self._pipeline.way_back(self._present_pose(), left.task, path, requires, asked)
                if way_back.scene not in left.scenes:
                    problem = scene_obstacle(way_back.scene, left.scenes)
                    raise PlanningError(Sentence("there is no way back now: {problem}", problem=problem))
                return way_back

            return plan

        return self._answer(asked, read, back=True)

    # -- answers

    def _answer(
        self,
        asked: PlanRequest,
        read: Callable[[], Callable[[], Plan]],
        changes: Sequence[SceneChange] = (),
        back: bool = False,
    ) -> Outcome:
        """Answer a request; while the arm is inside an engaged segment that it was left in, only the way back is planned."""

        def demanded() -> Callable[[], Plan]:
            left = self._engagement
            if left is not None and not back:
                raise EngagedError(left.task, left.segment, left.reason)
            return read()

        answer = self._requests.answer(asked, demanded, changes)
        if not answer.success:
            if answer.trace:
                rospy.logerr("%s", answer.trace)
            self._diagnostics.count(answer.failure, answer.message)
            self._publish_outcome(asked, answer)
        return Outcome(answer.success, answer.message, fields=vars(answer))

    def _publish(self, plan: Plan | None, changes: Sequence[SceneChange], asked: PlanRequest, answer: Answer) -> None:
        if plan is not None:
            tool_path = np.array([self._chain.forward(q).position for q in plan.trajectory.positions])
            message = plan_to_msg(plan, self._frames.base, tool_path, changes)
            message.header.stamp = rospy.Time.now()
            self._publisher.publish(message)
            self._plans += 1
        self._publish_outcome(asked, answer)

    def _publish_outcome(self, asked: PlanRequest, answer: Answer) -> None:
        self._last = answer.message if answer.success else f"no plan: {answer.message}"
        (rospy.loginfo if answer.success else rospy.logwarn)("%s", self._last)
        failed, request = self._pipeline.failed, ""
        if not answer.success and failed is not None and failed.sentence == answer.message:
            try:
                request = json.dumps(request_json(failed), allow_nan=False)
            except ValueError as error:
                # a goal that is no number: the answer comes all the same
                rospy.logwarn("`twin save-failure` will not find this request: %s", error)
        outcome = msg.PlanOutcome(
            success=answer.success,
            source=asked.source,
            message=answer.message,
            plan_id=answer.plan_id,
            request=request,
        )
        outcome.header.stamp = rospy.Time.now()
        self._outcome_publisher.publish(outcome)

    def _present_pose(self) -> tuple[float, ...]:
        return self._twin.pose(MAX_POSE_AGE, MAX_POSE_AGE)

    def diagnose(self) -> Diagnosis:
        """Return the state for `/diagnostics`."""
        scene = self._pipeline.scene
        values = {"plans": self._plans, "repeated": self._requests.repeated, "scene": scene.hash if scene else "none"}
        return Diagnosis(OK if scene is not None else WARN, self._last, values)


INTERFACE = shell.Interface(
    diagnose=PlannerNode.diagnose,
    publishes=(
        shell.Publication("plan", msg.Plan, queue_size=1, latch=True),
        shell.Publication("plan_outcome", msg.PlanOutcome, queue_size=1, latch=True),
    ),
    polls=(shell.PolledPose("twin/joint_states"),),
    subscribes=(
        shell.Subscription("engagement", msg.Engagement, PlannerNode.on_engagement, queue_size=1),
        shell.Subscription("review", msg.Review, PlannerNode.on_review, queue_size=10),
        shell.Subscription("scene", msg.Scene, PlannerNode.on_scene, queue_size=1),
        shell.Subscription("joint_trajectory", JointTrajectory, PlannerNode.on_trajectory, queue_size=10),
    ),
    listeners=FRAMES,
    serves=(
        shell.Served("plan_to_joints", srv.PlanToJoints, PlannerNode.on_plan_to_joints),
        shell.Served("plan_to_pose", srv.PlanToPose, PlannerNode.on_plan_to_pose),
        shell.Served("plan_cartesian", srv.PlanCartesian, PlannerNode.on_plan_cartesian),
        shell.Served("plan_trajectory", srv.PlanTrajectory, PlannerNode.on_plan_trajectory),
        shell.Served("plan_work", srv.PlanWork, PlannerNode.on_plan_work),
        shell.Served("plan_way_back", Trigger, PlannerNode.on_plan_way_back),
    ),
)


def check(settings: Settings, robot: RobotModel, *_: object) -> None:
    """Check the file of pairs; see `NodeShell`."""
    read_self_collision(settings.self_collision, robot)


NODE = shell.NodeShell("planner", Settings, PlannerNode, INTERFACE, check)
main = NODE.run

"""follow_joint_trajectory: the action control_msgs/FollowJointTrajectory, for MoveIt, MATLAB and ROS-Industrial clients.

A goal becomes a plan for review; the node itself commands no motion. One thread, `run`, does everything: callbacks and the threads
that wait for a service's answer only put into its inbox what has happened.
"""

from __future__ import annotations

import functools
import queue
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Literal

import pydantic
import rospy
from actionlib import ServerGoalHandle

from construction_twin.execution.executor import ExecutorState
from construction_twin.extensions.planners.goal_states import GoalState
from construction_twin.extensions.planners.joint_tolerances import GoalError, GoalJointsError, Tolerances
from construction_twin.extensions.planners.nodes.joint_goals import (
    LONGEST,
    GoalDefaults,
    GoalServer,
    asked_duration,
    control_messages,
    fill_feedback,
    trajectory_goal,
)
from construction_twin.extensions.planners.tracking import Tracking
from construction_twin.extensions.planners.trajectory_goals import (
    Accept,
    Brake,
    Effect,
    End,
    Ending,
    GoalPlan,
    RequestPlan,
    ResultCode,
    Status,
    TrajectoryGoal,
    TrajectoryGoals,
    Withdraw,
)
from construction_twin.msg import Execution, Feedback, PlanCaller, Review
from construction_twin.robot.description import RobotModel
from construction_twin.robot.plan import BY_ACTION
from construction_twin.ros.shared.diagnostics import OK, Diagnosis
from construction_twin.ros.shared.node_shell import (
    Interface,
    NodeIO,
    NodeShell,
    PoseSubscription,
    Publication,
    Shared,
    Subscription,
    has_arm,
)
from construction_twin.ros.transport.joint_stream import from_time
from construction_twin.ros.transport.persistent_service import NO_ANSWER
from construction_twin.ros.transport.subscriber import caller_of
from construction_twin.srv import PlanTrajectory, ReviewPlan, StopPlan
from construction_twin.validation import StrictModel

#: Time between two looks at poses and clock while a goal has the arm, and while none has [s].
PERIOD, IDLE_PERIOD = 0.02, 0.2
#: Between two feedbacks while nothing moves [s].
WAITING_FEEDBACK = 0.5
#: How long the streams are not read while no plan of a goal is played [s]; then only the newest pose is.
PAUSE = 0.1
#: A plan of the goal is, or may be, played.
IN_MOTION = (GoalState.MOVING, GoalState.BRAKING, GoalState.STOPPED, GoalState.SETTLING)
#: The streams are read in full then: a plan may begin at any moment of WITHDRAWING. REVIEW lasts minutes.
FOLLOWED = (GoalState.WITHDRAWING, *IN_MOTION)

#: How long a goal waits for a planner that is being started [s].
PLANNER_TIMEOUT = 10.0

Tolerance = Annotated[float, pydantic.Field(ge=0.0, allow_inf_nan=False)]


class Settings(StrictModel):
    """Private parameters; see config/follow_joint_trajectory.yaml, `arm` is given in launch/bringup.launch."""

    arm: Literal["mock", "real", "none"]
    action_names: Annotated[
        list[Annotated[str, pydantic.Field(pattern=r"^/?[A-Za-z]\w*(/\w+)*$")]], pydantic.Field(min_length=1)
    ]
    goal_tolerance: Tolerance
    goal_tolerance_linear: Tolerance
    goal_time_tolerance: Annotated[float, pydantic.Field(gt=0.0, le=LONGEST)]
    retime: bool


@dataclass(frozen=True)
class Client:
    """A goal as its client knows it: its handle, and the joints in its own order as indices of the robot's."""

    server: GoalServer
    handle: ServerGoalHandle
    order: tuple[int, ...]


class FollowJointTrajectoryNode:
    """ROS around TrajectoryGoals."""

    def __init__(self, settings: Settings, robot: RobotModel, node_io: NodeIO):
        self._messages = control_messages()
        self._robot = robot
        self._retime = settings.retime
        self._defaults = GoalDefaults(
            Tolerances.default(robot, settings.goal_tolerance, settings.goal_tolerance_linear),
            settings.goal_time_tolerance,
        )
        self._goals = TrajectoryGoals(robot, rospy.resolve_name("review_plan"))
        self._clients: dict[str, Client] = {}
        # not SimpleQueue: in Python 3.11 its `get` waits for ever after a signal handler that took longer than the timeout, and
        # rospy shuts down in one
        self._inbox: queue.Queue[Callable[[], None]] = queue.Queue()
        self._poses = threading.Lock()
        self._tracking = Tracking(settings.arm != "none")
        self._needs_poses = threading.Event()
        self._fed_back = 0.0
        self._goal_count = 0
        self._last = self._described = "no goal yet"
        self._caller: tuple[str, bool] | None = None
        self._caller_publisher = node_io.publishers["plan_caller"]
        self._diagnostics = node_io.diagnostics
        self._names = settings.action_names
        self._servers: list[GoalServer] = []

    def _serve(self, name: str) -> GoalServer:
        server: GoalServer = GoalServer(
            name,
            self._messages.FollowJointTrajectoryAction,
            lambda handle: self._enqueue(self._on_goal, server, handle),
            lambda handle: self._enqueue(self._goals.on_cancel, _key(server, handle)),
            self._diagnostics.refuse,
            functools.partial(self._result, ResultCode.GOAL_TOLERANCE_VIOLATED),
        )
        server.start()
        return server

    def run(self) -> None:
        """Handle events, and tick, until shutdown."""
        # here it can follow what becomes of a goal
        self._servers = [self._serve(name) for name in self._names]
        next_tick = time.monotonic()
        while not rospy.is_shutdown():
            now = time.monotonic()
            if now >= next_tick:
                next_tick = max(next_tick + PERIOD, now) if self._is_busy() else now + IDLE_PERIOD
                self._tick()
            else:
                try:
                    self._inbox.get(timeout=next_tick - now)()
                except queue.Empty:
                    continue
            for effect in self._goals.pop_effects():
                self._apply(effect)
            self._described = self._goals.describe()
            if self._goals.state in FOLLOWED:
                self._needs_poses.set()
            else:
                self._needs_poses.clear()
            if self._is_busy():
                next_tick = min(next_tick, time.monotonic() + PERIOD)

    def _is_busy(self) -> bool:
        return self._goals.state is not GoalState.FREE or bool(self._clients)

    def _tick(self) -> None:
        with self._poses:
            tracking = self._tracking
            sample, at_rest, settled = tracking.sample(), tracking.at_rest, tracking.settled
        now = time.monotonic()
        self._goals.tick(time.monotonic_ns(), sample, at_rest, settled)
        self._publish_caller()
        goal = self._goals.goal
        if goal is None or sample is None or goal.id not in self._clients:
            return
        if self._goals.state in IN_MOTION or now - self._fed_back >= WAITING_FEEDBACK:
            self._fed_back = now
            client = self._clients[goal.id]
            feedback = self._messages.FollowJointTrajectoryFeedback()
            feedback.header.stamp = rospy.Time.now()
            feedback.joint_names = [self._robot.joint_names[index] for index in client.order]
            fill_feedback(feedback, sample, self._goals.plan_start, client.order)
            client.handle.publish_feedback(feedback)

    def _publish_caller(self) -> None:
        """Publish for reviewers whether the client of the plan under review is still connected."""
        goals = self._goals
        if goals.state is not GoalState.REVIEW or goals.goal is None or goals.plan is None:
            return
        client = goals.goal.client
        connected = self._clients[goals.goal.id].server.is_connected(client)
        if self._caller == (goals.plan.id, connected):
            return
        self._caller = (goals.plan.id, connected)
        message = PlanCaller(plan_id=goals.plan.id, client=client, connected=connected)
        message.header.stamp = rospy.Time.now()
        self._caller_publisher.publish(message)
        if not connected:
            rospy.logwarn(
                "goal of %s: it is connected no more, and plan %s still waits for review", client, goals.plan.id
            )

    # -- subscriptions and actions: other threads

    def on_twin(self, stamp: int, q: tuple[float, ...]) -> None:
        """Store the twin's pose [rad] with its stamp [ns]."""
        with self._poses:
            self._tracking.on_twin(stamp, q)
        self._pause_reading()

    def on_feedback(self, _stamp: int, q: tuple[float, ...], _seq: int, command_stamp: int) -> None:
        """Store the arm's pose [rad] with the stamp of its command [ns]."""
        with self._poses:
            self._tracking.on_arm(q, command_stamp)
        self._pause_reading()

    def _pause_reading(self) -> None:
        """Delay rospy's reading while no goal needs poses, by `PAUSE` at most."""
        self._needs_poses.wait(PAUSE)

    def on_review(self, message: Review) -> None:
        """Queue a verdict."""
        self._enqueue(self._goals.on_verdict, message.plan_id, message.approved, message.reviewer, message.reason)

    def on_execution(self, message: Execution) -> None:
        """Queue the executor's report."""
        if message.state not in ExecutorState._value2member_map_:
            unknown = f"execution state {message.state} is unknown; expected one of Execution.msg"
            self._diagnostics.refuse("execution", unknown)
            return
        state, start = ExecutorState(message.state), from_time(message.plan_start)
        self._enqueue(self._goals.on_execution, message.plan_id, state, message.outcome, message.reason, start)

    def _enqueue(self, handle: Callable[..., None], *arguments: object) -> None:
        self._inbox.put(lambda: handle(*arguments, time.monotonic_ns()))

    # -- what was in the inbox

    def _on_goal(self, server: GoalServer, handle: ServerGoalHandle, now: int) -> None:
        goal, client, goal_id = handle.get_goal(), caller_of(handle.goal), _key(server, handle)
        self._goal_count += 1
        names = goal.trajectory.joint_names
        try:
            if not names and not goal.trajectory.points:
                goal.trajectory.joint_names = names = list(self._robot.joint_names)
            checked_goal = trajectory_goal(goal, goal_id, client, self._robot, self._defaults)
        except GoalError as error:
            code = ResultCode.INVALID_JOINTS if isinstance(error, GoalJointsError) else ResultCode.INVALID_GOAL
            self._last = f"goal of {client} rejected: {error}"
            self._diagnostics.refuse("goal", self._last)
            handle.set_rejected(self._result(code, str(error)), str(error))
            return
        self._clients[goal_id] = Client(server, handle, tuple(self._robot.joint_names.index(name) for name in names))
        (self._goals.on_goal if goal.trajectory.points else self._goals.on_stand_still)(checked_goal, now)

    # -- effects

    def _apply(self, effect: Effect) -> None:
        if isinstance(effect, RequestPlan):
            self._in_background(self._plan, effect.goal, self._clients[effect.goal.id].handle.get_goal().trajectory)
        elif isinstance(effect, Withdraw):
            verdict = {"approve": False, "reviewer": f"client {effect.client}", "reason": effect.reason}
            plan = {"plan_id": effect.plan_id, "plan_hash": effect.plan_hash}
            self._in_background(self._call, "review_plan", ReviewPlan, plan | verdict)
        elif isinstance(effect, Brake):
            self._in_background(self._call, "stop_plan", StopPlan, {"plan_id": effect.plan_id})
        elif isinstance(effect, Accept):
            rospy.loginfo("goal of %s: %s", caller_of(self._clients[effect.goal_id].handle.goal), effect.text)
            self._clients[effect.goal_id].handle.set_accepted(effect.text)
        elif isinstance(effect, Status):
            self._send_status(self._clients[effect.goal_id], effect.text)
        else:
            self._end(effect)

    @staticmethod
    def _in_background(call: Callable[..., None], *arguments: object) -> None:
        threading.Thread(target=call, args=arguments, daemon=True, name=call.__name__).start()

    @staticmethod
    def _send_status(client: Client, text: str) -> None:
        with client.server.lock:
            client.handle.get_goal_status().text = text
            client.server.publish_status()

    def _end(self, effect: End) -> None:
        handle = self._clients.pop(effect.goal_id).handle
        self._last = f"goal of {caller_of(handle.goal)} {effect.ending.value}: {effect.sentence}"
        wanted = effect.ending in (Ending.SUCCEEDED, Ending.CANCELED)
        (rospy.loginfo if wanted else rospy.logwarn)("%s", self._last)
        if not wanted:
            self._diagnostics.count(effect.code.name, self._last)
        finish = {
            Ending.REJECTED: handle.set_rejected,
            Ending.CANCELED: handle.set_canceled,
            Ending.ABORTED: handle.set_aborted,
            Ending.SUCCEEDED: handle.set_succeeded,
        }
        finish[effect.ending](self._result(effect.code, effect.sentence), effect.sentence)

    def _result(self, code: ResultCode, sentence: str):
        return self._messages.FollowJointTrajectoryResult(int(code), sentence)

    # -- services of other nodes, each call in a thread of its own

    def _plan(self, goal: TrajectoryGoal, trajectory) -> None:
        try:
            rospy.wait_for_service("plan_trajectory", PLANNER_TIMEOUT)
            planner = rospy.ServiceProxy("plan_trajectory", PlanTrajectory)
            source = f"{BY_ACTION} {goal.client}"
            answer = planner(trajectory=trajectory, retime=self._retime, source=source)
        except rospy.ROSInterruptException:
            return
        except (rospy.ROSException, *NO_ANSWER) as error:
            sentence = (
                f"the planner gave no answer ({error}); see whether the node planner runs, and send the goal again"
            )
            self._enqueue(self._goals.on_not_planned, sentence)
            return
        if answer.success:
            self._enqueue(
                self._goals.on_planned,
                GoalPlan(answer.plan_id, answer.plan_hash, answer.duration, asked_duration(trajectory), answer.retimed),
            )
        else:
            self._enqueue(self._goals.on_not_planned, answer.message)

    def _call(self, service: str, kind: type, fields: Mapping[str, object]) -> None:
        try:
            done = rospy.ServiceProxy(service, kind)(**fields).success
        except rospy.ROSInterruptException:
            return
        except NO_ANSWER as error:
            if rospy.core.is_shutdown_requested():
                return
            rospy.logwarn("%s gave no answer (%s); trying again", rospy.resolve_name(service), error)
            done = False
        if not done:
            # the plan has not reached the executor yet, or its verdict, start or end has just crossed this call
            self._enqueue(self._goals.on_call_failed)

    def diagnose(self) -> Diagnosis:
        """Return the state for `/diagnostics`."""
        values = {"goals": self._goal_count, "last goal": self._last}
        return Diagnosis(OK, self._described, values)


def _key(server: GoalServer, handle: ServerGoalHandle) -> str:
    return f"{server.ns} {handle.get_goal_id().id}"


INTERFACE = Interface(
    diagnose=FollowJointTrajectoryNode.diagnose,
    publishes=(Publication("plan_caller", PlanCaller, queue_size=5, latch=True),),
    subscribes=(
        PoseSubscription("twin/joint_states", FollowJointTrajectoryNode.on_twin, queue_size=1),
        PoseSubscription("physical/feedback", FollowJointTrajectoryNode.on_feedback, 1, Feedback, when=has_arm),
        Subscription("review", Review, FollowJointTrajectoryNode.on_review, queue_size=20),
        Subscription("execution", Execution, FollowJointTrajectoryNode.on_execution, queue_size=50, tcp_nodelay=True),
    ),
)


def check(_settings: Settings, _robot: RobotModel, _shared: Shared) -> None:
    """Check that the action's messages are installed; see `NodeShell`."""
    control_messages()


NODE = NodeShell("follow_joint_trajectory", Settings, FollowJointTrajectoryNode, INTERFACE, check)
main = NODE.run

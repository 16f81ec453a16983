"""pca_monitor: the pose checking algorithm as the gate between `next/joint_states` and `command/joint_states`."""

from __future__ import annotations

import math
import sys
import threading
from typing import Literal

import pydantic
import rospy

from construction_twin.errors import PayloadError
from construction_twin.gate import Gate, GateSettings, SyncState
from construction_twin.limits import MotionLimits
from construction_twin.mqtt.codec import JointStringCodec
from construction_twin.msg import Execution, Feedback, Link, Plan, Sync
from construction_twin.ros.diagnostics import OK, WARN, NodeDiagnostics
from construction_twin.ros.joint_stream import JointPublisher, JointSubscriber, from_time, joint_values, now_ns
from construction_twin.ros.node import run_node
from construction_twin.ros.params import NodeSettings, read_parameters, robot_from_parameters
from construction_twin.srv import PlanToJoints
from construction_twin.units import NANOSECONDS

#: Plans remembered: the one that plays, and those that were offered since.
PLANS_KEPT = 20


class Settings(NodeSettings):
    """Private parameters; see config/pca_monitor.yaml."""

    arm: Literal["mock", "real", "none"]
    decimals: int = pydantic.Field(ge=1, le=6)
    threshold: float = pydantic.Field(gt=0)
    lag_allowance: float = pydantic.Field(ge=0)
    feedback_timeout: float = pydantic.Field(gt=0)
    agree_time: float = pydantic.Field(ge=0)
    sync_rate: float = pydantic.Field(ge=5)
    executor: str = "executor"


class PcaMonitorNode:
    """ROS around a Gate."""

    def __init__(self):
        settings = read_parameters(Settings)
        self._robot = robot_from_parameters()
        names = self._robot.joint_names
        self._gate = Gate(
            MotionLimits.of(self._robot),
            JointStringCodec.of(self._robot, settings.decimals),
            GateSettings(
                settings.threshold,
                settings.lag_allowance,
                settings.feedback_timeout,
                settings.agree_time,
                settings.arm != "none",
            ),
        )
        self._lock = threading.Lock()
        self._session: str | None = None
        self._sync_period = round(NANOSECONDS / settings.sync_rate)
        self._sync_at = 0
        self._reported: tuple = ()
        self._plans: dict[str, Plan] = {}
        self._playing: str | None = None
        self._diagnostics = NodeDiagnostics(self._robot.name, self._report)
        self._command = JointPublisher("command/joint_states", names)
        self._sync = rospy.Publisher("sync", Sync, queue_size=50, latch=True, tcp_nodelay=True)
        self._plan_to_joints = rospy.ServiceProxy("plan_to_joints", PlanToJoints)
        refuse = self._diagnostics.refuse
        JointSubscriber("twin/joint_states", names, self._on_twin, refuse)
        rospy.Subscriber("physical/feedback", Feedback, self._on_feedback, queue_size=50, tcp_nodelay=True)
        JointSubscriber("next/joint_states", names, self._on_next, refuse, rospy.resolve_name(settings.executor))
        rospy.Subscriber("plan", Plan, self._on_plan, queue_size=5)
        rospy.Subscriber("execution", Execution, self._on_execution, queue_size=5)
        rospy.Subscriber("link", Link, self._on_link, queue_size=5)
        self._watch = rospy.Timer(rospy.Duration(1 / settings.sync_rate), self._on_timer)

    # -- the path

    def _on_next(self, stamp: int, theta_next: tuple[float, ...]) -> None:
        now = now_ns()
        with self._lock:
            was = self._gate.state
            command = self._gate.pass_next(stamp, theta_next, now)
            self._note_closing(was)
        if command is not None:
            self._command.publish(stamp, command)
        self._publish_sync(now)

    def _on_timer(self, _event) -> None:
        now = now_ns()
        with self._lock:
            was = self._gate.state
            self._gate.watch(now)
            self._note_closing(was)
        self._publish_sync(now)

    def _on_twin(self, stamp: int, q: tuple[float, ...]) -> None:
        with self._lock:
            self._gate.on_twin(stamp, q)

    def _on_feedback(self, message: Feedback) -> None:
        try:
            q = joint_values(message, self._robot.joint_names)
        except PayloadError as error:
            self._diagnostics.refuse(error.reason, str(error))
            return
        with self._lock:
            self._gate.on_physical(q, from_time(message.command_stamp), from_time(message.header.stamp))

    def _on_link(self, message: Link) -> None:
        if not message.session or message.session == self._session:
            return
        with self._lock:
            if self._session is not None:
                self._gate.restart("new command session")
            self._session = message.session

    # -- the re-plan

    def _on_plan(self, message: Plan) -> None:
        self._plans[message.id] = message
        while len(self._plans) > PLANS_KEPT:
            del self._plans[next(iter(self._plans))]

    def _on_execution(self, message: Execution) -> None:
        # a plan that a person stops is not taken up again
        self._playing = message.plan_id if message.state == Execution.PLAYING else None

    def _note_closing(self, was: SyncState) -> None:
        """When the gate has just closed, ask once, beside the stream, for a plan from the held pose to the interrupted one's goal.

        Whoever noticed calls this before anybody can hear of it: the executor then drops the plan.
        """
        state = self._gate.state
        if was is not SyncState.IN_SYNC or state is SyncState.IN_SYNC:
            return
        rospy.logwarn("gate closed, %s: %s", state.name, self._gate.reason)
        plan = None if state is SyncState.REFUSING else self._plans.get(self._playing)
        if plan is not None:
            request = self._gate.held, plan.trajectory.points[-1].positions, state.name
            threading.Thread(target=self._request_plan, args=request, daemon=True).start()

    def _request_plan(self, held: tuple[float, ...], goal: tuple[float, ...], cause: str) -> None:
        try:
            answer = self._plan_to_joints(goal=goal, start=held, source=f"re-plan after {cause}")
        except rospy.ServiceException as error:
            rospy.logerr("re-plan failed, the planner did not answer: %s", error)
            return
        if answer.success:
            rospy.logwarn("re-planned from the held pose: %s; it waits for review", answer.message)
        else:
            rospy.logerr("re-plan failed: %s", answer.message)

    # -- reports

    def _publish_sync(self, now: int) -> None:
        with self._lock:
            state = (self._gate.state, self._gate.reason, self._gate.agreed(now))
            if state == self._reported and now - self._sync_at < self._sync_period:
                return
            changed = state[0] is not (self._reported[0] if self._reported else None)
            self._reported, self._sync_at = state, now
            message = self._sync_message(*state)
        self._sync.publish(message)
        if changed:
            rospy.loginfo("%s: %s", state[0].name, state[1])

    def _sync_message(self, state: SyncState, reason: str, agreed: bool) -> Sync:
        message = Sync(
            state=state.value, text=state.name, reason=reason, agreed=agreed, violations=self._gate.violations
        )
        message.header.stamp = rospy.Time.now()
        message.round_trip = math.nan
        last = self._gate.comparison.last
        if last is not None:
            message.comparison, message.round_trip = last.mode, last.round_trip
            message.name, message.error, message.threshold = self._robot.joint_names, last.error, last.threshold
        return message

    def _report(self) -> tuple[int, str, dict]:
        gate = self._gate
        level = OK if gate.state is SyncState.IN_SYNC else WARN
        return (
            level,
            f"{gate.state.name}: {gate.reason}",
            {"violations": gate.violations, "refused setpoints": gate.refused},
        )


def main() -> None:
    """Run the node."""
    sys.setswitchinterval(0.001)
    run_node("pca_monitor", PcaMonitorNode)

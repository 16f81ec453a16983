"""pca_monitor: the pose checking algorithm as the gate between `next/joint_states` and `command/joint_states`."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections import deque
from dataclasses import replace
from typing import Annotated, Literal

import pydantic
import rospy

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import NANOSECONDS
from construction_twin.monitor.gate import REPLAN, Gate
from construction_twin.monitor.replan import ReplanGoal, ReplanGoals
from construction_twin.monitor.settings import Behaviour
from construction_twin.monitor.states import SyncState, Transition
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.msg import Execution, Feedback, Link, Plan, Sync
from construction_twin.ros.shared.diagnostics import ERROR, OK, WARN, NodeDiagnostics, Report
from construction_twin.ros.shared.node import Service, run_node
from construction_twin.ros.shared.params import NodeSettings, read_parameters, robot_from_parameters
from construction_twin.ros.shared.stop_memory import PARAMETER, StopMemory
from construction_twin.ros.shared.transition_report import TransitionReport
from construction_twin.ros.transport.joint_stream import (
    JointPublisher,
    JointSubscriber,
    from_time,
    now_ns,
    to_time,
)
from construction_twin.ros.transport.publisher import Publisher
from construction_twin.ros.transport.subscriber import Subscriber
from construction_twin.srv import ConfigureGate, ConfigureGateRequest, ConfigureGateResponse, PlanToJoints

#: Setpoints kept while the gate is busy, 0.1 s: what is older it does not let pass.
SETPOINTS_KEPT = 25
#: Poses of the arm kept while the gate is busy.
FEEDBACK_KEPT = 50


class Settings(NodeSettings, Behaviour):
    """Private parameters; see config/pca_monitor.yaml."""

    arm: Literal["mock", "real", "none"]
    decimals: int = pydantic.Field(ge=1, le=6)
    sync_rate: float = pydantic.Field(ge=5)
    transition_file: Annotated[str, pydantic.Field(min_length=1)]


class PcaMonitorNode:
    """ROS around a Gate."""

    def __init__(self):
        settings = read_parameters(Settings)
        self._robot = robot_from_parameters()
        names = self._robot.joint_names
        self._compares = settings.arm != "none"
        self._gate = Gate(
            MotionLimits.of(self._robot),
            JointStringCodec.of(self._robot, settings.decimals),
            settings.gate_settings(self._compares),
            time.monotonic_ns(),
        )
        self._lock = threading.Lock()
        self._heard = 0
        self._session: str | None = None
        self._stopped = self._stopped_before()
        self._sync_period = round(NANOSECONDS / settings.sync_rate)
        self._sync_at = 0
        self._reported: tuple = ()
        self._goals = ReplanGoals()
        self._changes: deque[Transition] = deque()
        # each from making a message until it is out: several threads publish, and the newest state must be the last one heard
        self._syncing, self._reporting = threading.Lock(), threading.Lock()
        self._transitions = TransitionReport(settings.transition_file, names)
        self._diagnostics = NodeDiagnostics(self._robot.name, self._report)
        self._command = JointPublisher("command/joint_states", names)
        self._sync = Publisher("sync", Sync, queue_size=50, latch=True, tcp_nodelay=True)
        self._plan_to_joints = rospy.ServiceProxy("plan_to_joints", PlanToJoints)
        self._behaviour = Behaviour.model_validate(settings.model_dump(include=set(Behaviour.model_fields)))
        #: The executor's sentence while a plan is being executed, at rest or not; empty otherwise.
        self._executing = ""
        Service("configure_gate", ConfigureGate, self._on_configure)
        self._subscribe(names)
        self._watch = rospy.Timer(rospy.Duration(1 / settings.sync_rate), self._on_timer)

    def _subscribe(self, names: tuple[str, ...]) -> None:
        refuse = self._diagnostics.refuse
        JointSubscriber("twin/joint_states", names, self._on_twin, refuse)
        JointSubscriber("physical/feedback", names, self._on_feedback, refuse, queue_size=FEEDBACK_KEPT, kind=Feedback)
        JointSubscriber("next/joint_states", names, self._on_next, refuse, SETPOINTS_KEPT)
        Subscriber("plan", Plan, self._on_plan, refuse, queue_size=5)
        Subscriber("execution", Execution, self._on_execution, refuse, queue_size=5)
        Subscriber("link", Link, self._on_link, refuse, queue_size=5)

    def _stopped_before(self) -> StopMemory:
        """Begin in STOPPED where a monitor before this one was, until the link tells of another session."""
        session = rospy.get_param(PARAMETER, "") if self._compares else ""
        if session:
            self._session = session
            self._gate.stay_stopped(
                f"a monitor before this one was STOPPED in session {session}; see to the arm, then call reset",
                time.monotonic_ns(),
            )
        return StopMemory(session, lambda value: rospy.set_param(PARAMETER, value))

    # -- the path; all times but those of stamps and reports are monotonic

    def _on_next(self, stamp: int, theta_next: tuple[float, ...]) -> None:
        now = time.monotonic_ns()
        with self._lock:
            command = self._gate.pass_next(stamp, theta_next, now)
            self._note_changes()
        if command is not None:
            self._command.publish(stamp, command)
        self._publish(now)

    def _on_timer(self, _event) -> None:
        now = time.monotonic_ns()
        with self._lock:
            self._gate.watch(now)
            self._note_changes()
            stopped = self._gate.state is SyncState.STOPPED
        self._publish(now)
        self._transitions.flush()
        self._stopped.keep((self._session or "") if stopped else "", now)

    def _on_twin(self, stamp: int, q: tuple[float, ...]) -> None:
        with self._lock:
            self._gate.on_twin(stamp, q)

    def _on_feedback(self, received: int, q: tuple[float, ...], _seq: int, command_stamp: int) -> None:
        now = time.monotonic_ns()
        # what waited in a queue is not fresh because it is read now. Both stamps are taken moments apart: a clock that is
        # set makes a single pose look old, never the ones before it
        self._heard = max(self._heard, now - max(now_ns() - received, 0))
        with self._lock:
            self._gate.on_physical(q, command_stamp, self._heard, received)
            self._note_changes()
        if self._changes:
            self._publish(now)

    def _on_link(self, message: Link) -> None:
        now = time.monotonic_ns()
        with self._lock:
            self._gate.mirror(message.state == Link.MIRROR, now)
            if message.session and message.session != self._session:
                if self._session is not None:
                    self._gate.restart("new command session", now)
                self._session = message.session
            self._note_changes()

    def _on_configure(self, request: ConfigureGateRequest) -> ConfigureGateResponse:
        now = time.monotonic_ns()
        try:
            with self._lock:
                if not request.operator.strip():
                    raise ConfigurationError(
                        "operator", request.operator, "the name of a person: the change is recorded"
                    )
                if self._executing:
                    raise ConfigurationError("the executor", self._executing, "no plan that is being executed")
                # before the text is read: whatever reading it costs, it costs at rest
                self._gate.check_rest(now)
                behaviour = self._behaviour.changed(request.settings)
                difference = self._behaviour.difference(behaviour)
                if difference:
                    settings = behaviour.gate_settings(self._compares)
                    self._gate.configure(settings, f"{request.operator.strip()} changed {difference}", now)
                    self._behaviour = behaviour
                    self._note_changes()
        except ConfigurationError as error:
            sentence = f"{error}; nothing was changed"
            self._diagnostics.refuse("configure_gate", sentence)
            return ConfigureGateResponse(False, sentence)
        self._publish(now)
        return ConfigureGateResponse(True, f"changed {difference}" if difference else "nothing to change")

    # -- the re-plan

    def _on_plan(self, message: Plan) -> None:
        if not message.trajectory.points:
            self._diagnostics.refuse("plan", f"plan {message.id} has no points; expected at least a start and a goal")
            return
        goal = message.trajectory.points[-1].positions
        self._goals.on_plan(message.id, goal, message.velocity_use, message.acceleration_use)

    def _on_execution(self, message: Execution) -> None:
        active = message.state not in (Execution.WAITING, Execution.IDLE)
        self._executing = f"plan {message.plan_id} is {message.text}" if active else ""
        self._goals.on_execution(message.plan_id, message.state == Execution.PLAYING, from_time(message.header.stamp))

    def _note_changes(self) -> None:
        """Take over the gate's transitions; when it has just closed ask once, beside the stream, for a plan to the old goal.

        To be called under the lock, before a change can be heard: the executor then drops the plan.
        """
        if not self._gate.changed:
            return
        changes = self._gate.take_transitions()
        closed = changes[0].source is SyncState.IN_SYNC and changes[0].target is not SyncState.IN_SYNC
        if closed and self._gate.policy == REPLAN:
            self._ask_for_plan(changes[0])
            changes += self._gate.take_transitions()
        # the gate's clock is its own
        to_ros_time = now_ns() - time.monotonic_ns()
        self._changes.extend(replace(change, at=change.at + to_ros_time) for change in changes)

    def _ask_for_plan(self, change: Transition) -> None:
        wanted = self._goals.interrupted
        if wanted is None:
            return
        asked = f"a path to the goal of plan {wanted.plan_id} was asked for, no faster than that plan"
        if self._gate.on_replan(asked, change.at):
            request = self._gate.held, wanted, change.target.name, self._gate.violations
            threading.Thread(target=self._request_plan, args=request, daemon=True).start()

    def _request_plan(self, held: tuple[float, ...], wanted: ReplanGoal, cause: str, violation: int) -> None:
        try:
            answer = self._plan_to_joints(
                goal=wanted.goal,
                start=held,
                speed_scale=wanted.speed_scale,
                acceleration_scale=wanted.acceleration_scale,
                source=f"re-plan after {cause}",
                # not now: a person may have called `stop` since then, which this node has not heard of
                asked=to_time(wanted.seen),
            )
        except rospy.ServiceException as error:
            self._on_replan_failed(f"the planner did not answer: {error}", violation)
            return
        if answer.success:
            rospy.logwarn("re-planned from the held pose: %s; it waits for review", answer.message)
        else:
            self._on_replan_failed(answer.message, violation)

    def _on_replan_failed(self, problem: str, violation: int) -> None:
        rospy.logerr("re-plan failed: %s", problem)
        now = time.monotonic_ns()
        with self._lock:
            # the answer may come late, in another hold
            if self._gate.violations == violation:
                self._gate.on_replan_failed(f"re-plan failed: {problem}", now)
                self._note_changes()
        self._publish(now)

    # -- reports

    def _publish(self, now: int) -> None:
        # the executor waits for `sync`, and no node for the rest
        self._publish_sync(now)
        if self._changes:
            with self._reporting:
                while self._changes:
                    self._transitions.report(self._changes.popleft())

    def _publish_sync(self, now: int) -> None:
        with self._syncing:
            with self._lock:
                gate = self._gate
                state = (gate.state, gate.reason, gate.agreed(now))
                if state == self._reported and now - self._sync_at < self._sync_period:
                    return
                self._reported, self._sync_at = state, now
                message = self._sync_message(*state)
            self._sync.publish(message)

    def _sync_message(self, state: SyncState, reason: str, agreed: bool) -> Sync:
        gate = self._gate
        message = Sync(
            state=state.value,
            text=state.name,
            reason=reason,
            agreed=agreed,
            policy=gate.policy,
            violations=gate.violations,
            held_stamp=to_time(gate.held_stamp),
        )
        message.header.stamp = rospy.Time.now()
        message.round_trip = message.servo_lag = math.nan
        last = gate.comparison.last
        if last is not None:
            message.comparison, message.round_trip, message.servo_lag = last.mode, last.round_trip, last.servo_lag
            message.name, message.error, message.threshold = self._robot.joint_names, last.error, last.threshold
        return message

    def _report(self) -> Report:
        gate, problem = self._gate, self._transitions.problem or self._stopped.problem
        last = gate.comparison.last
        values = {
            "policy": gate.policy,
            "comparison": last.mode if last else "none yet",
            "servo lag [s]": f"{last.servo_lag:.6f}" if last else "nan",
            "violations": gate.violations,
            "refused setpoints": gate.refused,
        }
        level = {SyncState.IN_SYNC: OK, SyncState.STOPPED: ERROR, SyncState.FAULT: ERROR}.get(gate.state, WARN)
        sentence = f"{gate.state.name}: {gate.reason}" + (f"; {problem}" if problem else "")
        return Report(ERROR if problem else level, sentence, values | self._transitions.values())


def main() -> None:
    """Run the node."""
    sys.setswitchinterval(0.001)
    run_node("pca_monitor", PcaMonitorNode)

"""pca_monitor: the pose checking algorithm as the gate between `next/joint_states` and `command/joint_states`.

It also merges what limits the speed, beside the gate: see `ros.shared.speed_limits`.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import pydantic
import rospy

from construction_twin.core.errors import ConfigurationError, RequestRefused
from construction_twin.core.files import check_writable
from construction_twin.core.limits import MotionLimits
from construction_twin.core.reports import HoldReport, SyncReport
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.monitor.gate import REPLAN, Cause, Gate
from construction_twin.monitor.replan import ReplanGoal, ReplanGoals
from construction_twin.monitor.servo_watch import ServoWatch
from construction_twin.monitor.settings import Behaviour
from construction_twin.monitor.states import SyncState, Transition
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.msg import (
    Execution,
    Feedback,
    Hold,
    Link,
    Plan,
    SpeedChange,
    SpeedLimit,
    SpeedLimitInForce,
    Sync,
)
from construction_twin.msg import Transition as TransitionMsg
from construction_twin.robot.description import RobotModel
from construction_twin.ros.messages.records import to_msg
from construction_twin.ros.shared.diagnostics import ERROR, OK, WARN, NodeDiagnostics, Report
from construction_twin.ros.shared.node_shell import NodeShell
from construction_twin.ros.shared.params import NodeSettings, robot_file, ros_home
from construction_twin.ros.shared.ports import (
    Every,
    Interface,
    Ports,
    PosePublication,
    PoseSubscription,
    Publication,
    Served,
    Shared,
    SharedParameter,
    Subscription,
    has_arm,
)
from construction_twin.ros.shared.speed_limits import AGAIN, PERIOD, PROGRAM, SpeedLimitService
from construction_twin.ros.shared.stop_memory import PARAMETER, StopMemory
from construction_twin.ros.shared.transition_report import TransitionReport
from construction_twin.ros.transport.joint_stream import now_ns
from construction_twin.ros.transport.publisher import Sink
from construction_twin.servo.file import read_servos
from construction_twin.srv import (
    ConfigureGate,
    ConfigureGateRequest,
    LimitSpeed,
    PlanToJoints,
    PlanToJointsResponse,
)

#: Setpoints kept while the gate is busy, 0.1 s: what is older it does not let pass.
SETPOINTS_KEPT = 25
#: Poses of the arm kept while the gate is busy.
FEEDBACK_KEPT = 50
#: Longest time between two `sync` of an open gate while the command rests [ns]: five nodes read each of them.
RESTING_SYNC = NANOSECONDS // 10
#: Rate of `sync` while its state does not change [Hz]. After 0.5 s of silence the executor takes the gate for closed.
SYNC_RATE = 50.0
#: How long transitions wait for their file [s].
WRITE_PERIOD = 0.1


class Settings(NodeSettings, Behaviour):
    """Private parameters; see config/pca_monitor.yaml."""

    arm: Literal["mock", "real", "none"]
    decimals: int = pydantic.Field(ge=1, le=6)
    transition_file: Annotated[str, pydantic.Field(min_length=1)]
    servo_model: str


@dataclass(frozen=True)
class Outputs:
    """What the monitor says, and to whom.

    Attributes:
        plan_to_joints: The planner's service; takes the fields of its request as keywords.
        remember: Keeps the session in which the gate is STOPPED beyond this process; takes "" when it is not.
        expected: Takes where the arm's servos should have it; None: nobody knows these.
    """

    command: Sink
    sync: Sink
    hold: Sink
    transitions: TransitionReport
    plan_to_joints: Callable[..., PlanToJointsResponse]
    remember: Callable[[str], None]
    expected: Sink | None = None


class PcaMonitorNode:
    """ROS around a Gate; `start` gives it parameters, topics and services.

    Args:
        behaviour: What the gate was given.
        names: Joint names.
        compares: Whether there is a physical arm.
        diagnostics: Counts what is refused.
        speed: The speed limit, which the gate knows nothing of.
        stopped_in: The session in which a monitor before this one was STOPPED: the gate stays so until the link tells of another
            session.
    """

    def __init__(
        self,
        gate: Gate,
        behaviour: Behaviour,
        names: tuple[str, ...],
        compares: bool,
        outputs: Outputs,
        diagnostics: NodeDiagnostics,
        speed: SpeedLimitService,
        stopped_in: str = "",
    ):
        self._gate = gate
        self._behaviour = behaviour
        self._names = names
        self._compares = compares
        self._outputs = outputs
        self._lock = threading.Lock()
        self._heard = 0
        self._session: str | None = None
        self._stopped = StopMemory(stopped_in, outputs.remember)
        if stopped_in:
            self._session = stopped_in
            gate.stay_stopped(Sentence("reason.gate.stopped_before", session=stopped_in), time.monotonic_ns())
        self._sync_period = round(NANOSECONDS / SYNC_RATE)
        self._sync_at = 0
        self._reported: tuple = ()
        #: As it was told last; empty: not yet.
        self._hold: tuple[Cause | None, ...] = ()
        self._goals = ReplanGoals()
        self._changes: deque[Transition] = deque()
        # each from making a message until it is out: several threads publish, and the newest state must be the last one heard
        self._syncing, self._reporting = threading.Lock(), threading.Lock()
        #: The executor's sentence while a plan is being executed, at rest or not; empty otherwise.
        self._executing = ""
        self._diagnostics = diagnostics
        self.speed = speed

    # -- the path; all times but those of stamps and reports are monotonic

    def on_next(self, stamp: int, theta_next: tuple[float, ...]) -> None:
        """Let a setpoint [rad] with its stamp [ns] pass, or hold."""
        now = time.monotonic_ns()
        with self._lock:
            command = self._gate.pass_next(stamp, theta_next, now)
            self._note_changes()
        if command is not None:
            self._outputs.command.publish(stamp, command)
        self._publish(now)

    def watch(self) -> None:
        """Notice what did not come, and do what may wait; to be called at `SYNC_RATE`."""
        now = time.monotonic_ns()
        with self._lock:
            self._gate.watch(now)
            self._note_changes()
            stopped = self._gate.state is SyncState.STOPPED
        self._publish(now)
        self._stopped.keep((self._session or "") if stopped else "", now)

    def write_transitions(self) -> None:
        """Write the transitions to their file, in a thread of its own: a disk that hangs must not silence `sync`."""
        self._outputs.transitions.flush()

    def on_twin(self, stamp: int, q: tuple[float, ...]) -> None:
        """Take the twin's pose [rad] with its stamp [ns]."""
        with self._lock:
            self._gate.on_twin(stamp, q)

    def on_feedback(self, received: int, q: tuple[float, ...], seq: int, command_stamp: int) -> None:
        """Take the arm's pose [rad], when the bridge received it, its number, and which command it answers [ns]."""
        now = time.monotonic_ns()
        # what waited in a queue is not fresh because it is read now. Both stamps are taken moments apart: a clock that is
        # set makes a single pose look old, never the ones before it
        self._heard = max(self._heard, now - max(now_ns() - received, 0))
        with self._lock:
            self._gate.on_physical(q, command_stamp, self._heard, received, seq)
            self._note_changes()
            servos = self._gate.watch_of_servos
            expected = servos.expected if servos is not None else ()
        if self._changes:
            self._publish(now)
        if expected and self._outputs.expected is not None:
            # with the stamp of the pose that it was compared with
            self._outputs.expected.publish(received, expected)

    def on_link(self, message: Link) -> None:
        """Take the link's state; a new session restarts the gate."""
        now = time.monotonic_ns()
        with self._lock:
            self._gate.mirror(message.state == Link.MIRROR, now)
            if message.session and message.session != self._session:
                if self._session is not None:
                    self._gate.restart(Sentence("reason.gate.new_session"), now)
                self._session = message.session
            self._note_changes()

    def on_configure(self, request: ConfigureGateRequest) -> str:
        """Change settings of the gate, at rest only."""
        now = time.monotonic_ns()
        try:
            with self._lock:
                if not request.operator.strip():
                    raise ConfigurationError("operator", request.operator, Sentence("expected.gate.person"))
                if self._executing:
                    raise ConfigurationError("the executor", self._executing, Sentence("expected.gate.no_plan"))
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
            raise RequestRefused(Sentence("view.refused.unchanged", problem=error.sentence)) from error
        self._publish(now)
        return f"changed {difference}" if difference else "nothing to change"

    # -- the re-plan

    def on_plan(self, message: Plan) -> None:
        """Note where a plan ends, for a re-plan."""
        if not message.trajectory.points:
            self._diagnostics.refuse("plan", Sentence("reason.refused.plan_points", plan=message.id))
            return
        if message.segments:
            # its rest is dropped: tool and scene may be in between, so that whoever gave the task plans it anew
            return
        goal = message.trajectory.points[-1].positions
        self._goals.on_plan(message.id, goal, message.velocity_use, message.acceleration_use)

    def on_execution(self, message: Execution) -> None:
        """Note which plan is played."""
        active = message.state not in (Execution.WAITING, Execution.IDLE)
        self._executing = f"plan {message.plan_id} is {message.text}" if active else ""
        self._goals.on_execution(message.plan_id, message.state == Execution.PLAYING, message.moment)

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
        asked = Sentence("reason.gate.replan_asked", plan=wanted.plan_id)
        if self._gate.on_replan(asked, change.at):
            request = self._gate.held, wanted, change.target.name, self._gate.violations
            threading.Thread(target=self._request_plan, args=request, daemon=True).start()

    def _request_plan(self, held: tuple[float, ...], wanted: ReplanGoal, cause: str, violation: int) -> None:
        try:
            answer = self._outputs.plan_to_joints(
                goal=wanted.goal,
                start=held,
                speed_scale=wanted.speed_scale,
                acceleration_scale=wanted.acceleration_scale,
                source=Sentence("reason.replan_source", state=cause),
                # not now: a person may have called `stop` since then, which this node has not heard of
                asked=wanted.seen,
            )
        except rospy.ServiceException as error:
            self._on_replan_failed(Sentence("reason.gate.planner_silent", problem=str(error)), violation)
            return
        if answer.success:
            rospy.logwarn("re-planned from the held pose: %s", answer.message)
        else:
            self._on_replan_failed(answer.message, violation)

    def _on_replan_failed(self, problem: str, violation: int) -> None:
        rospy.logerr("re-plan failed: %s", problem)
        now = time.monotonic_ns()
        with self._lock:
            # the answer may come late, in another hold
            if self._gate.violations == violation:
                self._gate.on_replan_failed(Sentence("reason.gate.replan_failed", problem=problem), now)
                self._note_changes()
        self._publish(now)

    # -- reports

    def _publish(self, now: int) -> None:
        # the executor waits for `sync`, and no node for the rest
        self._publish_sync(now)
        if self._changes:
            with self._reporting:
                while self._changes:
                    self._outputs.transitions.report(self._changes.popleft())

    def _publish_sync(self, now: int) -> None:
        with self._syncing:
            with self._lock:
                gate = self._gate
                state = (gate.state, gate.reason, gate.agreed(now))
                if state == self._reported and now - self._sync_at < self._pause_of_sync(now):
                    return
                self._reported, self._sync_at = state, now
                message, cause = self._sync_message(*state), gate.cause
            self._outputs.sync.publish(message)
            if (cause,) != self._hold:
                self._hold = (cause,)
                self._outputs.hold.publish(_hold_message(cause, now))

    def _pause_of_sync(self, now: int) -> int:
        """Return how long nothing is told while the state is the same [ns]; under the lock."""
        gate = self._gate
        resting = gate.state is SyncState.IN_SYNC and gate.rests(now) and not gate.mirrored
        return max(self._sync_period, RESTING_SYNC) if resting else self._sync_period

    def _sync_message(self, state: SyncState, reason: str, agreed: bool) -> Sync:
        gate = self._gate
        report = SyncReport(
            state=state.value,
            text=state.name,
            reason=reason,
            agreed=agreed,
            policy=gate.policy,
            violations=gate.violations,
            held_stamp=gate.held_stamp,
            stamp=now_ns(),
        )
        last = gate.comparison.last
        if last is not None:
            report = replace(
                report,
                comparison=last.mode,
                round_trip=last.round_trip,
                servo_lag=last.servo_lag,
                name=self._names,
                error=last.error,
                threshold=last.threshold,
            )
        return to_msg(report, Sync)

    def report(self) -> Report:
        """Return the state for `/diagnostics`."""
        gate, problem = self._gate, self._outputs.transitions.problem or self._stopped.problem
        last = gate.comparison.last
        values = {
            "policy": gate.policy,
            "comparison": last.mode if last else "none yet",
            "servo lag [s]": f"{last.servo_lag:.6f}" if last else "nan",
            "violations": gate.violations,
            "refused setpoints": gate.refused,
        }
        values |= _servo_values(gate.watch_of_servos)
        level = {SyncState.IN_SYNC: OK, SyncState.STOPPED: ERROR, SyncState.FAULT: ERROR}.get(gate.state, WARN)
        speed = self.speed.report()
        limited = speed.sentence if speed.level != OK else ""
        sentence = "; ".join(filter(None, (f"{gate.state.name}: {gate.reason}", problem, limited)))
        values = {**values, **speed.values, **self._outputs.transitions.values()}
        return Report(ERROR if problem else max(level, speed.level), sentence, values)


def make_gate(settings: Settings, robot: RobotModel, now: int) -> Gate:
    """Return the gate of a robot; ConfigurationError where the parameters do not fit it."""
    codec = JointStringCodec.of(robot, settings.decimals)
    servos = read_servos(settings.servo_model, robot.joint_names) if knows_servos(settings) else None
    return Gate(MotionLimits.of(robot), codec, settings.gate_settings(settings.arm != "none"), now, servos)


def knows_servos(settings: Settings) -> bool:
    """Return whether the arm is compared with a model of its servos: not without an arm."""
    return bool(settings.servo_model) and settings.arm != "none"


def check(settings: Settings, robot: RobotModel, shared: Shared) -> None:
    """Check what fits the model and yet cannot work; see `NodeShell`."""
    make_gate(settings, robot, 0)
    if knows_servos(settings):
        # servos of another cycle: the arm would never be judged
        known = read_servos(settings.servo_model, robot.joint_names).cycle_ns // 1_000_000
        cycle = (shared["gateway"] or {}).get("cycle", known)
        if known != cycle:
            raise ConfigurationError("cycle_ms", known, Sentence("expected.servo_cycle", cycle=cycle))
    check_writable(robot_file(settings.transition_file, robot.name).parent)


def start(settings: Settings, robot: RobotModel, ports: Ports) -> PcaMonitorNode:
    """Return the monitor with its parameters, topics and services."""
    names = robot.joint_names
    compares = has_arm(settings)
    # without an arm there is no broker, and nobody could raise what was set before
    kept = ros_home() / "construction_twin" / "speed_limits" / f"{robot.name}.json" if compares else None
    return PcaMonitorNode(
        make_gate(settings, robot, time.monotonic_ns()),
        Behaviour.model_validate(settings.model_dump(include=set(Behaviour.model_fields))),
        names,
        compares,
        Outputs(
            ports.publishers["command/joint_states"],
            ports.publishers["sync"],
            ports.publishers["hold"],
            TransitionReport(robot_file(settings.transition_file, robot.name), names, ports.publishers["transitions"]),
            rospy.ServiceProxy("plan_to_joints", PlanToJoints),
            ports.keeper(PARAMETER),
            ports.publishers.get("expected/joint_states"),
        ),
        ports.diagnostics,
        SpeedLimitService(kept, ports),
        ports.parameters[PARAMETER] if compares else "",
    )


def _servo_values(watch: ServoWatch | None) -> dict[str, str | int]:
    """Return what `/diagnostics` says of the model of the servos."""
    if watch is None:
        return {"servo model": "none: the arm is compared with the twin alone"}
    later = ", ".join(f"{1e3 * lag:+.2f}" for lag in watch.refinement.later)
    return {
        "servo model": "judges" if watch.judges else "waits until the arm has moved as commanded",
        "compared with it": watch.judged,
        "largest residual": f"{max(watch.largest):.6f}",
        "lag beyond the file [ms]": later,
    }


def _hold_message(cause: Cause | None, now: int) -> Hold:
    stamp = now_ns()
    # the gate's clock is the monotonic one
    held = HoldReport(stamp=stamp) if cause is None else HoldReport(cause.sentence, stamp - (now - cause.since), stamp)
    return to_msg(held, Hold)


INTERFACE = Interface(
    report=PcaMonitorNode.report,
    parameters=(
        SharedParameter(PARAMETER, "", kept=True),
        SharedParameter("executor", {}),
        SharedParameter("gateway"),
        SharedParameter(PROGRAM, "", kept=True),
    ),
    publishes=(
        PosePublication("command/joint_states"),
        PosePublication("expected/joint_states", when=knows_servos),
        Publication("sync", Sync, queue_size=50, latch=True, tcp_nodelay=True),
        Publication("hold", Hold, queue_size=5, latch=True),
        Publication("transitions", TransitionMsg, queue_size=50, latch=True),
        Publication("speed_limit_in_force", SpeedLimitInForce, queue_size=5, latch=True, tcp_nodelay=True),
        Publication("speed_change", SpeedChange, queue_size=50),
    ),
    hears=(
        PoseSubscription("twin/joint_states", PcaMonitorNode.on_twin),
        PoseSubscription("physical/feedback", PcaMonitorNode.on_feedback, FEEDBACK_KEPT, Feedback),
        PoseSubscription("next/joint_states", PcaMonitorNode.on_next, SETPOINTS_KEPT),
        Subscription("plan", Plan, PcaMonitorNode.on_plan, queue_size=5),
        Subscription("execution", Execution, PcaMonitorNode.on_execution, queue_size=5),
        Subscription("link", Link, PcaMonitorNode.on_link, queue_size=5),
        Subscription(
            "speed_limit", SpeedLimit, lambda node, said: node.speed.on_program(said), queue_size=5, tcp_nodelay=True
        ),
    ),
    serves=(
        Served("configure_gate", ConfigureGate, PcaMonitorNode.on_configure, reason="configure_gate"),
        Served("limit_speed", LimitSpeed, lambda node, asked: node.speed.on_limit_speed(asked)),
    ),
    every=(
        Every(lambda _settings: 1 / SYNC_RATE, lambda node, _ports: node.watch()),
        Every(lambda _settings: WRITE_PERIOD, lambda node, _ports: node.write_transitions()),
        Every(lambda _settings: PERIOD, lambda node, _ports: node.speed.repeat()),
        Every(lambda _settings: AGAIN, lambda node, _ports: node.speed.write()),
    ),
)
NODE = NodeShell("pca_monitor", Settings, start, INTERFACE, check, fast=True)


def main() -> None:
    """Run the node."""
    NODE.run()

"""pca_monitor: the gate between `next/joint_states` and `command/joint_states`; beside it the merge of speed limits."""

from __future__ import annotations

import threading
import time
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import pydantic
import rospy

from construction_twin import msg, srv
from construction_twin.core.errors import ConfigurationError, ExpiredError, PayloadError
from construction_twin.core.files import check_writable
from construction_twin.core.freshness import TOO_OLD, present_moment
from construction_twin.core.limits import MotionLimits
from construction_twin.core.reports import HoldReport, SpeedChange
from construction_twin.core.sentences import Sentence
from construction_twin.core.speed_limit import LimitState, SpeedLimit
from construction_twin.gateway.config import GatewayConfig
from construction_twin.link.speed_limits import NOBODY, UNKNOWN, SpeedLimits, read_people, write_people
from construction_twin.monitor.gate import Cause, Gate
from construction_twin.monitor.monitor import SYNC_RATE, Monitor, Replan, TransitionLog
from construction_twin.monitor.settings import GateSettings
from construction_twin.monitor.states import SyncState, Transition
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.robot.description import RobotModel
from construction_twin.ros.messages.records import to_msg
from construction_twin.ros.messages.services import Outcome
from construction_twin.ros.shared import node_shell as shell
from construction_twin.ros.shared.diagnostics import ERROR, OK, WARN, DeferredLog, Diagnosis
from construction_twin.ros.shared.params import NodeSettings, SavedParameter, robot_file, ros_home
from construction_twin.ros.transport.joint_stream import now_ns, to_time
from construction_twin.ros.transport.subscriber import caller_of
from construction_twin.servo.model import read_servos
from construction_twin.validation import StrictModel

#: Setpoints kept while the gate is busy, 0.1 s: what is older it does not let pass.
SETPOINTS_KEPT = 25
#: Poses of the arm kept while the gate is busy.
FEEDBACK_KEPT = 50
#: How long transitions wait for their file [s].
WRITE_PERIOD = 0.1
#: Parameters of the robot, which the launch file clears: the session that a violation has stopped; the limit while the program that
#: set one is silent, and its name.
STOPPED, PROGRAM = "stopped_session", "speed_limit_program"
#: Between two messages of the limit in force, well below `speed_limit_deadline`, and between two tries to write a file [s].
LIMIT_PERIOD, LIMIT_AGAIN = 0.05, 0.5
#: So long the answer to a lower limit, which acts already, waits for the disk [s]: one that hangs holds up no lower one.
PATIENCE = 0.5
#: Which states are worth a warning in the node's log, and which an error; the others are part of normal work.
_WARNED = (SyncState.HOLDING, SyncState.REPLANNING, SyncState.STALE)
_SERIOUS = (SyncState.STOPPED, SyncState.FAULT)


class Settings(NodeSettings, GateSettings):
    """Private parameters; see config/pca_monitor.yaml."""

    arm: Literal["mock", "real", "none"]
    decimals: int = pydantic.Field(ge=1, le=6)
    transition_file: Annotated[str, pydantic.Field(min_length=1)]
    servo_model: str

    @pydantic.model_validator(mode="before")
    @classmethod
    def _require_every_setting(cls, given: dict) -> dict:
        missing = [name for name in GateSettings.model_fields if name not in given and name != "thresholds"]
        # a mistyped key has its own sentence
        if missing and given.keys() <= cls.model_fields.keys():
            raise ConfigurationError(missing[0], None, "this key")
        return given


class SilenceRules(StrictModel, extra="ignore"):
    """Parameters of executor or gateway about a source that falls silent; see config/executor.yaml."""

    speed_limit_deadline: float = pydantic.Field(GatewayConfig.speed_limit_deadline, gt=0)
    speed_limit_silent: float = pydantic.Field(GatewayConfig.speed_limit_silent, ge=0, le=1)
    speed_limit_required: bool = False


class SpeedLimitService:
    """ROS around a SpeedLimits: of one program and of people; the lowest is published, and repeated. Not safety rated.

    Beside the gate, in threads of its own. A raise of people is on the disk, in `path`, before it acts; a lower limit acts at once.
    """

    def __init__(self, path: Path | None, node_io: shell.NodeIO):
        # the stricter of executor's and gateway's holds here; without an arm there is no gateway
        rule_parameters = {
            name: node_io.parameters[name] for name in ("executor", "gateway") if node_io.parameters[name] is not None
        }
        rules = [SilenceRules.read(given, rospy.resolve_name(name)) for name, given in rule_parameters.items()]
        deadline = min(each.speed_limit_deadline for each in rules)
        silent = min(each.speed_limit_silent for each in rules)
        program = SpeedLimit(deadline, silent, rules[0].speed_limit_required)
        fraction, _, name = node_io.parameters[PROGRAM].partition(" ")
        if name:
            # a process before this one had a limit of it: silent until it sends again
            program.record(float(fraction), name, time.monotonic_ns() - round(2e9 * deadline) - 1)
        self._saved_program = SavedParameter(node_io.parameters[PROGRAM], node_io.parameter_writer(PROGRAM), PROGRAM)
        people, problem = read_people(path) if path else (NOBODY, "")
        self._limits = SpeedLimits(program, people, present_moment(), problem)
        # what the file holds, and a lock that is held while the disk is waited for
        self._path, self._saved_people, self._file_problem, self._file_lock = path, people, "", threading.Lock()
        self._in_force, self._changes = (node_io.publishers[name] for name in ("speed_limit_in_force", "speed_change"))
        self._refuse = node_io.diagnostics.refuse
        # also orders what is published: the last message is what was decided last
        self._lock = threading.Lock()

    def on_program(self, message: msg.SpeedLimit) -> None:
        """Put a program's limit in force at once."""
        try:
            with self._lock:
                self._limits.program.accept(message.limit, caller_of(message), time.monotonic_ns(), message.reason)
                self._publish()
        except PayloadError as error:
            self._refuse(error.reason, str(error))

    def on_limit_speed(self, request: srv.LimitSpeedRequest) -> Outcome:
        """Set people's limit: a lower one is in force before anything is written, a higher one is written first."""
        given, limits = (request.limit, request.person, request.moment), self._limits
        try:
            if request.limit > limits.people.limit:
                with self._file_lock:
                    self._write(limits.requested_change(*given, present_moment(), now_ns()))
                    if self._file_problem:
                        raise PayloadError("file", f"the speed limit of people is not raised: {self._file_problem}")
            with self._lock:
                before, sentence = limits.people, limits.set(*given, present_moment(), now_ns())
                self._publish()
                if limits.people is not before:
                    self._changes.publish(to_msg(limits.people, msg.SpeedChange))
        except (PayloadError, ExpiredError) as error:
            self._refuse(error.reason if isinstance(error, PayloadError) else TOO_OLD, str(error))
            return Outcome(False, str(error), isinstance(error, ExpiredError), {"limit": limits.people.limit})
        writer = threading.Thread(target=self.write, name="speed limit", daemon=True)
        writer.start()
        writer.join(PATIENCE)
        return Outcome(True, sentence, fields={"limit": limits.people.limit})

    def write(self) -> None:
        """Save people's limit where the file differs (background thread only)."""
        with self._file_lock:
            # an unreadable file stays as it is until a person has set a limit
            if self._limits.people != self._saved_people:
                self._write(self._limits.people)

    def _write(self, people: SpeedChange) -> None:
        self._file_problem = write_people(self._path, people) if self._path else ""
        self._saved_people = UNKNOWN if self._file_problem else people

    def repeat(self) -> None:
        """Publish the limit in force again, and check the program for silence; to be called every `LIMIT_PERIOD`."""
        program = self._limits.program
        with self._lock:
            self._publish()
            # it changes seldom, however often the limit does
            program_text = f"{int(100 * program.fraction_when_silent) / 100:g} {program.name}" if program.name else ""
        self._saved_program.save(program_text, time.monotonic_ns())

    def _publish(self) -> None:
        if report := self._limits.state_report(time.monotonic_ns()):
            self._in_force.publish(to_msg(replace(report, stamp=now_ns()), msg.SpeedLimitInForce))

    def diagnose(self) -> Diagnosis:
        """Return the state for `/diagnostics`."""
        program = self._limits.program
        with self._lock:
            said = self._limits.state_report(time.monotonic_ns())
        limit, reason = (said.limit, said.reason) if said else (1.0, program.reason)
        values = {"speed limit": f"{limit:.3f}", "speed limit because": reason}
        slow = program.state in (LimitState.SILENT, LimitState.MISSING)
        problem = self._file_problem or self._saved_program.fault
        level = ERROR if problem or self._limits.fault else WARN if slow else OK
        return Diagnosis(level, problem or f"speed limit {limit:g}: {reason}", values)


class PcaMonitorNode:
    """ROS around a Monitor, and the speed limit beside it."""

    def __init__(self, settings: Settings, robot: RobotModel, node_io: shell.NodeIO):
        # without an arm there is no broker by which it could be raised again
        has = shell.has_arm(settings)
        limits_file = ros_home() / "construction_twin" / "speed_limits" / f"{robot.name}.json" if has else None
        stopped_in, now = node_io.parameters[STOPPED] if has else "", time.monotonic_ns()
        self._names, self._publishers, self._diagnostics = robot.joint_names, node_io.publishers, node_io.diagnostics
        self._command = node_io.publishers["command/joint_states"]
        # without a model of the arm's servos nothing is expected
        self._expected = node_io.publishers.get("expected/joint_states")
        self._gate = make_gate(settings, robot, now)
        self._monitor = Monitor(self._gate, robot.joint_names, stopped_in, now)
        transitions = robot_file(settings.transition_file, robot.name)
        rospy.loginfo("transitions are recorded in %s", transitions)
        self._transitions = TransitionLog(transitions, robot.joint_names)
        self._plan_to_joints = rospy.ServiceProxy("plan_to_joints", srv.PlanToJoints)
        self._saved_stop = SavedParameter(stopped_in, node_io.parameter_writer(STOPPED), STOPPED)
        self.speed = SpeedLimitService(limits_file, node_io)
        self._lock = threading.Lock()
        self._received_at = 0
        #: As published last; empty: not yet.
        self._hold: tuple[Cause | None, ...] = ()
        self._changes: deque[Transition] = deque()
        self._log_queue = DeferredLog()
        # each from making a message until it is out: several threads publish, and the newest state must come last
        self._syncing, self._reporting = threading.Lock(), threading.Lock()

    # -- the path; all times but those of stamps and reports are monotonic

    def on_next(self, stamp: int, theta_next: tuple[float, ...]) -> None:
        """Let a setpoint [rad] with its stamp [ns] pass, or hold."""
        now = time.monotonic_ns()
        with self._lock:
            command = self._gate.pass_next(stamp, theta_next, now)
            self._collect_changes()
        if command is not None:
            self._command.publish(stamp, command)
        self._publish(now)

    def watch(self) -> None:
        """Check for silence, and publish what is due; to be called at `SYNC_RATE`."""
        now = time.monotonic_ns()
        with self._lock:
            self._gate.watch(now)
            self._collect_changes()
            stopped_in = self._monitor.stopped_in
        self._publish(now)
        self._saved_stop.save(stopped_in, now)

    def write_transitions(self) -> None:
        """Write the transitions to their logs, in a background thread: `sync` waits for no disk."""
        self._log_queue.flush()
        self._transitions.flush()
        if self._transitions.fault:
            rospy.logerr_throttle(5.0, "%s", self._transitions.fault)

    def on_twin(self, stamp: int, q: tuple[float, ...]) -> None:
        """Store the twin's pose [rad] with its stamp [ns]."""
        with self._lock:
            self._gate.on_twin(stamp, q)

    def on_feedback(self, received: int, q: tuple[float, ...], seq: int, command_stamp: int) -> None:
        """Compare the arm's pose [rad]: when the bridge received it, its number, and which command it answers [ns]."""
        now = time.monotonic_ns()
        # what waited in a queue is not fresh because it is read now. Both stamps are taken moments apart: a clock that is
        # set makes a single pose look old, never the ones before it
        self._received_at = max(self._received_at, now - max(now_ns() - received, 0))
        with self._lock:
            self._gate.on_physical(q, command_stamp, self._received_at, received, seq)
            self._collect_changes()
            servos = self._gate.servo_watch
            expected = servos.expected if servos is not None else ()
        if self._changes:
            self._publish(now)
        if expected and self._expected is not None:
            # with the stamp of the pose that it was compared with
            self._expected.publish(received, expected)

    def on_link(self, message: msg.Link) -> None:
        """Store the link's state; a new session restarts the gate."""
        with self._lock:
            self._monitor.on_link(message.session, message.state == msg.Link.MIRROR, time.monotonic_ns())
            self._collect_changes()

    def on_configure(self, request: srv.ConfigureGateRequest) -> str:
        """Change settings of the gate, at rest only."""
        now = time.monotonic_ns()
        with self._lock:
            changed = self._monitor.configure(request.operator, request.settings, now)
            self._collect_changes()
        self._publish(now)
        return changed

    # -- the re-plan

    def on_plan(self, message: msg.Plan) -> None:
        """Store where a plan ends, for a re-plan."""
        if not message.trajectory.points:
            self._diagnostics.refuse("plan", f"plan {message.id} has no points; expected at least a start and a goal")
            return
        if message.segments:
            # its rest is dropped: tool and scene may be in between, so that the task is planned anew
            return
        goal = message.trajectory.points[-1].positions
        with self._lock:
            self._monitor.on_plan(message.id, goal, message.velocity_use, message.acceleration_use)

    def on_execution(self, message: msg.Execution) -> None:
        """Store which plan is played."""
        executing = message.text if message.state not in (msg.Execution.WAITING, msg.Execution.IDLE) else ""
        playing = message.state == msg.Execution.PLAYING
        with self._lock:
            self._monitor.on_execution(message.plan_id, executing, playing, message.moment)

    def _collect_changes(self) -> None:
        """Collect the gate's transitions, and ask for a plan beside the stream; under the lock, before a change is published."""
        if not self._gate.transitions:
            return
        changes, replan = self._monitor.pop_transitions()
        if replan is not None:
            threading.Thread(target=self._request_plan, args=(replan,), daemon=True).start()
        # the gate's clock is its own
        to_ros_time = now_ns() - time.monotonic_ns()
        self._changes.extend(replace(change, at=change.at + to_ros_time) for change in changes)

    def _request_plan(self, replan: Replan) -> None:
        wanted = replan.wanted
        try:
            answer = self._plan_to_joints(
                goal=wanted.goal,
                start=replan.held,
                speed_scale=wanted.speed_scale,
                acceleration_scale=wanted.acceleration_scale,
                source=Sentence("re-plan after a hold"),
                # not now: a person may have called `stop` since, unknown to this node
                asked=wanted.last_played,
            )
        except rospy.ServiceException as error:
            problem: str = Sentence("the planner did not answer: {problem}", problem=str(error))
        else:
            if answer.success:
                rospy.logwarn("re-planned from the held pose: %s", answer.message)
                return
            problem = Outcome.of(answer).message
        rospy.logerr("re-plan failed: %s", problem)
        now = time.monotonic_ns()
        with self._lock:
            self._monitor.on_replan_failed(replan, problem, now)
            self._collect_changes()
        self._publish(now)

    # -- reports

    def _publish(self, now: int) -> None:
        # the executor waits for `sync`, and no node for the rest
        with self._syncing:
            with self._lock:
                report, cause = self._monitor.pop_sync_report(now), self._gate.cause
            if report is not None:
                self._publishers["sync"].publish(to_msg(replace(report, stamp=now_ns()), msg.Sync))
                if (cause,) != self._hold:
                    self._hold = (cause,)
                    stamp, hold = now_ns(), HoldReport()
                    if cause is not None:
                        # the gate's clock is the monotonic one
                        hold = HoldReport(cause.sentence, stamp - (now - cause.since))
                    self._publishers["hold"].publish(to_msg(replace(hold, stamp=stamp), msg.Hold))
        if self._changes:
            with self._reporting:
                while self._changes:
                    self._publish_transition(self._changes.popleft())

    def _publish_transition(self, change: Transition) -> None:
        self._transitions.add(change)
        message = msg.Transition(
            from_text=change.source.name,
            to_text=change.target.name,
            event=change.event.value,
            reason=change.reason,
            name=self._names,
            held_stamp=to_time(change.held_stamp),
        )
        message.header.stamp = to_time(change.at)
        if change.comparison is not None:
            message.error, message.threshold = change.comparison.error, change.comparison.threshold
        self._publishers["transitions"].publish(message)
        warns = rospy.logwarn if change.target in _WARNED else rospy.loginfo
        self._log_queue.add(rospy.logerr if change.target in _SERIOUS else warns, "%s", change)

    def diagnose(self) -> Diagnosis:
        """Return the state for `/diagnostics`."""
        gate, speed, problem = self._gate, self.speed.diagnose(), self._transitions.fault or self._saved_stop.fault
        level = ERROR if gate.state in _SERIOUS else OK if gate.state is SyncState.IN_SYNC else WARN
        limited = speed.sentence if speed.level != OK else ""
        sentence = "; ".join(filter(None, (f"{gate.state.name}: {gate.reason}", problem, limited)))
        values = {**self._monitor.values(), **speed.values, **self._transitions.values()}
        return Diagnosis(ERROR if problem else max(level, speed.level), sentence, values)


def make_gate(settings: Settings, robot: RobotModel, now: int) -> Gate:
    """Return the gate of a robot; ConfigurationError where the parameters do not fit it."""
    codec = JointStringCodec.of(robot, settings.decimals)
    servos = read_servos(settings.servo_model, robot.joint_names) if shell.knows_servos(settings) else None
    given = GateSettings.model_validate(settings.model_dump(include=set(GateSettings.model_fields)))
    return Gate(MotionLimits.of(robot), codec, given, now, servos, settings.arm != "none")


def check(settings: Settings, robot: RobotModel, shared: shell.Shared) -> None:
    """Check the parameters against each other; see `NodeShell`."""
    make_gate(settings, robot, 0)
    if shell.knows_servos(settings):
        # servos of another cycle: the arm would never be judged
        known = read_servos(settings.servo_model, robot.joint_names).cycle_ns // 1_000_000
        cycle = (shared["gateway"] or {}).get("cycle", known)
        if known != cycle:
            raise ConfigurationError("cycle_ms", known, f"{cycle} as the controller has: identify at that cycle")
    check_writable(robot_file(settings.transition_file, robot.name).parent)


INTERFACE = shell.Interface(
    diagnose=PcaMonitorNode.diagnose,
    parameters=(
        shell.SharedParameter(STOPPED, "", written=True),
        shell.SharedParameter("executor", {}),
        shell.SharedParameter("gateway"),
        shell.SharedParameter(PROGRAM, "", written=True),
    ),
    publishes=(
        shell.PosePublication("command/joint_states"),
        shell.PosePublication("expected/joint_states", when=shell.knows_servos),
        shell.Publication("sync", msg.Sync, queue_size=50, latch=True, tcp_nodelay=True),
        shell.Publication("hold", msg.Hold, queue_size=5, latch=True),
        shell.Publication("transitions", msg.Transition, queue_size=50, latch=True),
        shell.Publication("speed_limit_in_force", msg.SpeedLimitInForce, queue_size=5, latch=True, tcp_nodelay=True),
        shell.Publication("speed_change", msg.SpeedChange, queue_size=50),
    ),
    subscribes=(
        shell.PoseSubscription("twin/joint_states", PcaMonitorNode.on_twin),
        shell.PoseSubscription("physical/feedback", PcaMonitorNode.on_feedback, FEEDBACK_KEPT, msg.Feedback),
        shell.PoseSubscription("next/joint_states", PcaMonitorNode.on_next, SETPOINTS_KEPT),
        shell.Subscription("plan", msg.Plan, PcaMonitorNode.on_plan, queue_size=5),
        shell.Subscription("execution", msg.Execution, PcaMonitorNode.on_execution, queue_size=5),
        shell.Subscription("link", msg.Link, PcaMonitorNode.on_link, queue_size=5),
        shell.Subscription(
            "speed_limit",
            msg.SpeedLimit,
            lambda node, message: node.speed.on_program(message),
            queue_size=5,
            tcp_nodelay=True,
        ),
    ),
    serves=(
        shell.Served("configure_gate", srv.ConfigureGate, PcaMonitorNode.on_configure, reason="configure_gate"),
        shell.Served("limit_speed", srv.LimitSpeed, lambda node, asked: node.speed.on_limit_speed(asked)),
    ),
    timers=(
        shell.NodeTimer(lambda _settings: 1 / SYNC_RATE, PcaMonitorNode.watch),
        shell.NodeTimer(lambda _settings: WRITE_PERIOD, PcaMonitorNode.write_transitions),
        shell.NodeTimer(lambda _settings: LIMIT_PERIOD, lambda node: node.speed.repeat()),
        shell.NodeTimer(lambda _settings: LIMIT_AGAIN, lambda node: node.speed.write()),
    ),
)
NODE = shell.NodeShell("pca_monitor", Settings, PcaMonitorNode, INTERFACE, check, fast=True)
main = NODE.run

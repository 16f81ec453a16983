"""mqtt_bridge: ROS <-> MQTT in the paper's joint string, and the person's `reset`. The decisions are in `link/bridge.py`."""

from __future__ import annotations

import math
import threading
import time
import uuid
from collections.abc import Callable
from typing import Annotated, Literal, TypeVar

import pydantic
import rospy
from std_srvs.srv import SetBool, Trigger

from construction_twin.broker.start import ACCOUNTS
from construction_twin.core.errors import ConfigurationError, PayloadError
from construction_twin.core.freshness import present_moment
from construction_twin.core.records import SPACED, to_json
from construction_twin.core.reports import SessionRequest
from construction_twin.core.sentences import Sentence, join_sentences
from construction_twin.core.side_effects import SideEffects
from construction_twin.gateway.config import GatewayConfig
from construction_twin.kinematics.arm_identity import ArmIdentity
from construction_twin.kinematics.chain import pendant_frame
from construction_twin.link.bridge import PLC_HALTED, Bridge, JointStrings, PendingRequest
from construction_twin.link.gateway_status import parse_answer, parse_status
from construction_twin.link.observations import ArmCheck, LinkState
from construction_twin.mqtt.client import Broker, make_client, unique_id
from construction_twin.mqtt.fast_client import FastClient
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import PLC, BridgeStatus, Control, Topics
from construction_twin.msg import Execution, Feedback, Link, SpeedLimitInForce, Sync, ToolCommand, ToolState
from construction_twin.msg import SessionRequest as SessionRequestMessage
from construction_twin.robot.description import RobotModel
from construction_twin.ros.messages.convert import tool_report_to_msg
from construction_twin.ros.messages.records import to_msg
from construction_twin.ros.messages.services import Outcome
from construction_twin.ros.nodes.rsi_gateway import config_of_link
from construction_twin.ros.shared import node_shell as shell
from construction_twin.ros.shared.diagnostics import OK, WARN, DeferredLog, Diagnosis
from construction_twin.ros.shared.mqtt_connection import MqttSettings, broker_of, connect, connection_log
from construction_twin.ros.shared.params import SavedParameter
from construction_twin.ros.transport.joint_stream import now_ns
from construction_twin.srv import ActAsSeen, ActAsSeenRequest

#: Period at which the link is polled, and at which the log is written [s].
POLL, LOG_PERIOD = 0.02, 0.05
#: Parameter in the robot's namespace, for the process after this one: why a person is waited for.
WAITS = "waits_for_person"

_Read = TypeVar("_Read")
_Finite = Annotated[float, pydantic.Field(allow_inf_nan=False)]
_Frame = Annotated[list[_Finite], pydantic.Field(min_length=6, max_length=6)]


class Settings(MqttSettings):
    """Private parameters; see config/mqtt_bridge.yaml."""

    arm: Literal["mock", "real"]
    gateway_kind: Literal["rsi", "plc"] = "rsi"
    anonymous_broker_is_meant: bool = False
    pose_mismatch_is_meant: bool = False
    reset_timeout: float = pydantic.Field(gt=0)
    max_state_age: float = pydantic.Field(gt=0)
    tool_frame: _Frame = [0.0] * 6
    base_frame: _Frame = [0.0] * 6
    most_pose_mm: float = pydantic.Field(5.0, gt=0)
    most_pose_deg: float = pydantic.Field(0.5, gt=0)


class MqttBridge:
    """ROS and MQTT around a `Bridge`, guarded by a lock that is never held while sending: a method for each topic and service."""

    def __init__(
        self,
        settings: Settings,
        topics: Topics,
        config: GatewayConfig,
        codec: JointStringCodec,
        broker: Broker,
        client: FastClient,
        node_io: shell.NodeIO,
        arm: ArmCheck | None = None,
    ):
        bare, new_id = settings.gateway_kind == PLC, lambda: uuid.uuid4().hex
        self._strings = JointStrings(codec, config.properties, bare, settings.max_state_age)
        # not a private parameter: those hold settings, and this came about while a bridge ran
        waits = str(node_io.parameters[WAITS])
        self._saved_waits = SavedParameter(waits, node_io.parameter_writer(WAITS), WAITS)
        self._bridge = Bridge(config, bare, settings.reset_timeout, self._strings, new_id, waits, arm)
        self._supervisor = self._bridge.supervisor
        self._lock = threading.Lock()
        # orders what is published on `tool`: it comes from several threads
        self._tool_lock = threading.Lock()
        self._topics, self._broker, self._client, self._connection = topics, broker, client, connection_log(broker)
        self._publishers, self._diagnostics = node_io.publishers, node_io.diagnostics
        self._physical, self._feedback = (self._publishers[f"physical/{name}"] for name in ("joint_states", "feedback"))
        self._side_effects, self._log = SideEffects(), DeferredLog()

    def connect(self) -> None:
        """Connect to the broker, and serve the connection in a thread of its own."""
        self._client.on_stream(self._topics.state, self.on_state)
        on_message = {
            self._topics.status: lambda message: self.on_status(bytes(message.payload)),
            self._topics.control_ack: lambda message: self.on_answer(bytes(message.payload)),
        }
        topics = [(self._topics.state, 0), *((topic, 1) for topic in on_message)]
        connect(
            self._client, self._broker, self._connection, topics, self.on_connect, on_message, lost=self.on_disconnect
        )

    @property
    def link(self) -> LinkState:
        """State of the link."""
        return self._supervisor.state

    def run(self) -> None:
        """Poll the link until shutdown."""
        while not rospy.is_shutdown():
            self.poll()
            time.sleep(POLL)
        ended = to_json(BridgeStatus("offline", "bridge stopped"), separators=SPACED)
        self._client.publish(self._topics.bridge_status, ended, 1, True)
        self._client.disconnect()
        self._client.loop_stop()

    def write_log(self) -> None:
        """Flush the log queue and the failures of side effects (timer thread only)."""
        self._side_effects.run("the log", self._log.flush)
        self._side_effects.write(rospy.logerr)

    def poll(self) -> None:
        """Update the link, and publish what follows from it."""
        now = time.monotonic_ns()
        with self._lock:
            control = self._bridge.poll(now, present_moment())
            waits = self._bridge.waits_for
        if control is not None:
            self._send(control)
        self._saved_waits.save(waits, now)
        self._publish_link(now)
        self._publish_tool()

    def _send(self, control: Control) -> bool:
        self._client.publish(self._topics.control, control.to_json(), qos=1)
        # a speed limit is repeated for as long as its source sends
        if control.verb != "speed_limit":
            line = "%s, session %s", control.verb, control.session
            self._side_effects.run("the log", self._log.add, rospy.loginfo, *line)
        return True

    def _decide(self, decide: Callable[..., Control | None], *arguments: object) -> None:
        with self._lock:
            control = decide(*arguments)
        if control is not None:
            self._send(control)

    # -- ROS to MQTT

    def on_command(self, stamp: int, q: tuple[float, ...]) -> None:
        """Send a command [rad] with its stamp [ns], if the link is armed."""
        with self._lock:
            session = self._supervisor.on_command(q, time.monotonic_ns())
        if not session:
            return
        try:
            payload, properties = self._strings.encode_command(q, session, stamp)
        except PayloadError as error:
            self._diagnostics.refuse(error.reason, str(error))
            return
        self._client.send_stream(self._topics.command, payload, properties)

    def on_speed_limit(self, message: SpeedLimitInForce) -> None:
        """Pass the speed limit in force on."""
        self._decide(self._bridge.on_speed_limit, message.limit, time.monotonic_ns())

    def on_tool_command(self, message: ToolCommand) -> None:
        """Arm a switch, or void those that are armed."""
        if message.verb == ToolCommand.VOID:
            self._decide(self._bridge.void_switches)
        elif message.verb == ToolCommand.ARM:
            switch = message.plan_id, message.id, message.output, bool(message.value), message.stamp.to_nsec()
            self._decide(self._bridge.switch, *switch)
        else:
            self._diagnostics.refuse("tool_command", f"tool_command with verb {message.verb}; expected ARM or VOID")
        self._publish_tool()

    def on_execution(self, message: Execution) -> None:
        """Store which plan is played."""
        with self._lock:
            self._bridge.played = message.plan_id

    def on_sync(self, message: Sync) -> None:
        """Void switches when the gate closes."""
        self._decide(self._bridge.on_gate, message.state == Sync.IN_SYNC)

    # -- MQTT to ROS

    def on_connect(self) -> tuple[str, bytes, bool]:
        """Return the first message of a connection, which says that the bridge is here."""
        with self._lock:
            self._supervisor.inputs.on_connection(True)
            return self._topics.bridge_status, self._bridge.status(), True

    def on_disconnect(self) -> None:
        """Store that the connection is lost."""
        with self._lock:
            self._supervisor.inputs.on_connection(False)

    def on_state(self, payload: bytes, pairs: list[tuple[str, str]], retained: bool) -> None:
        """Publish the arm's pose of a joint string with its user properties."""
        received, now = now_ns(), time.monotonic_ns()
        try:
            q, properties = self._strings.decode_state(payload, pairs, retained, now)
        except PayloadError as error:
            self._diagnostics.refuse(f"state_{error.reason}", str(error))
            return
        with self._lock:
            self._supervisor.inputs.on_pose(q, now)
        # the gate's first: each program that looks on at the other takes its time from what comes after
        self._feedback.publish(received, q, properties.seq, properties.command_stamp)
        self._physical.publish(received, q)

    def on_status(self, payload: bytes) -> None:
        """Handle the gateway's status, or a bare PLC's word; an unreadable one is refused as a whole."""
        self._handle_document(parse_status, payload, self._bridge.on_status)

    def on_answer(self, payload: bytes) -> None:
        """Handle the gateway's answer to a control message."""
        self._handle_document(parse_answer, payload, self._bridge.on_answer)

    def _handle_document(
        self, read: Callable[[bytes], _Read], payload: bytes, handle: Callable[[_Read, int], None]
    ) -> None:
        try:
            document = read(payload)
            with self._lock:
                handle(document, time.monotonic_ns())
        except PayloadError as error:
            self._diagnostics.refuse(error.reason, str(error))
            return
        self._publish_tool()

    # -- services

    def ask(self, verb: str, person: str = "", moment: str | None = None) -> Outcome:
        """Ask for a session as `Bridge.ask` does, and wait for its end."""
        with self._lock:
            asked = self._bridge.ask(verb, person, moment, time.monotonic_ns(), present_moment())
        request = SessionRequest(verb, person, asked.lifts, rospy.Time.now().to_nsec())
        self._publishers["session_request"].publish(to_msg(request, SessionRequestMessage))
        self._log.add(rospy.loginfo, "%s asked for by %s: %s", verb, person or "a service", asked.lifts)
        return Outcome(*self._wait(asked))

    def on_act_as_seen(self, request: ActAsSeenRequest) -> Outcome:
        """Reset or arm in a person's name; only to arm a PLC, at the robot's computers, needs no moment."""
        at_the_robot = request.act == "arm" and not request.moment
        return self.ask(request.act, request.person, None if at_the_robot else request.moment)

    def _wait(self, asked: PendingRequest) -> tuple[bool, str]:
        while True:
            ending = rospy.is_shutdown()
            with self._lock:
                answer = asked.answer(time.monotonic_ns(), ending)
            if answer is not None:
                return answer
            time.sleep(POLL)

    def on_halt(self, _request) -> Outcome:
        """Stop executor and gateway: the gateway brakes the arm within its limits, and the executor drops its plan."""
        with self._lock:
            stop = self._bridge.halt()
        if stop is None:
            return Outcome(True, PLC_HALTED)
        if not self._side_effects.run("the stop for the gateway", self._send, stop):
            problem = Sentence(
                "the stop could not be sent to the gateway, which brakes by itself, because no more commands "
                "come; the cause is on /diagnostics; call reset to go on"
            )
        elif not self._client.is_connected():
            problem = Sentence(
                "no connection to the broker: the gateway brakes by itself, because no more commands come; "
                "call reset to go on"
            )
        else:
            return Outcome(True, Sentence("stop sent to the gateway, plan dropped; call reset to go on"))
        return Outcome(False, problem)

    def on_mirror(self, request) -> str:
        """Begin or end mirror mode."""
        with self._lock:
            sentence, asked = self._bridge.mirror(request.data, time.monotonic_ns())
        armed, why = self._wait(asked) if asked is not None else (True, "")
        return sentence if armed else join_sentences(sentence, why)

    # -- reports

    def _publish_link(self, now: int) -> None:
        refused, connection = self._diagnostics.refused, self._connection.sentence
        with self._lock:
            is_due, has_changed = self._bridge.report_due(now, connection)
            if not is_due:
                return
            report = self._bridge.state_report(connection, refused, rospy.Time.now().to_nsec())
            status = self._bridge.status()
        self._publishers["link"].publish(to_msg(report, Link))
        if has_changed:
            self._client.publish(self._topics.bridge_status, status, qos=1, retain=True)
            self._log.add(rospy.loginfo, "%s: %s", report.text, report.reason)

    def _publish_tool(self) -> None:
        with self._tool_lock:
            with self._lock:
                report = self._bridge.changed_tool_report()
            if report is not None:
                self._publishers["tool"].publish(tool_report_to_msg(report, rospy.Time.now()))

    def diagnose(self) -> Diagnosis:
        """Return the state for `/diagnostics`."""
        with self._lock:
            state = self._supervisor.state
            sentence = f"{state.name}: {self._bridge.reason(self._connection.sentence)}"
            values = self._bridge.values() | self._side_effects.status_fields()
            another = self._supervisor.inputs.arm.problem
        # where it is not armed for that, the sentence says so already
        another = another if state is not LinkState.OTHER_ARM else ""
        if problem := self._saved_waits.fault or self._side_effects.sentence or another:
            return Diagnosis(WARN, f"{sentence}; {problem}", values)
        return Diagnosis(OK if state in (LinkState.ARMED, LinkState.MIRROR) else WARN, sentence, values)


def arm_check(settings: Settings, robot: RobotModel) -> ArmCheck:
    """Return what compares the arm with its model."""
    external = [axis.name for axis in robot.axes if axis.name.startswith("E")]
    if external:
        skipped = Sentence(
            "not compared: whether the controller's tool moves with {axis} depends on its kinematic chain ($ROBROOT)",
            axis=external[0],
        )
        return ArmCheck(skipped=skipped)
    most = settings.most_pose_mm / 1e3, math.radians(settings.most_pose_deg)
    model = ArmIdentity(robot, pendant_frame(settings.tool_frame), pendant_frame(settings.base_frame), *most)
    return ArmCheck(model.compare, refuses=not settings.pose_mismatch_is_meant)


def start(settings: Settings, robot: RobotModel, node_io: shell.NodeIO) -> MqttBridge:
    """Return the bridge, connecting to the broker."""
    config = config_of_link(robot, node_io.parameters["gateway"], settings.gateway_kind != PLC)
    broker, topics = broker_of(settings), Topics(settings.prefix, robot.name)
    client = make_client(broker, unique_id(robot.name, "bridge"), topics.bridge_status, direct=True)
    codec, arm = JointStringCodec.of(robot, config.decimals), arm_check(settings, robot)
    bridge = MqttBridge(settings, topics, config, codec, broker, client, node_io, arm)
    bridge.connect()
    return bridge


INTERFACE = shell.Interface(
    diagnose=MqttBridge.diagnose,
    parameters=(
        shell.SharedParameter(WAITS, "", written=True),
        shell.SharedParameter("gateway"),
    ),
    publishes=(
        shell.PosePublication("physical/joint_states"),
        shell.PosePublication("physical/feedback", Feedback),
        shell.Publication("link", Link, queue_size=10, latch=True),
        shell.Publication("tool", ToolState, queue_size=50, latch=True),
        shell.Publication("session_request", SessionRequestMessage, queue_size=10),
    ),
    subscribes=(
        shell.PoseSubscription("command/joint_states", MqttBridge.on_command),
        shell.Subscription("speed_limit_in_force", SpeedLimitInForce, MqttBridge.on_speed_limit, queue_size=5),
        shell.Subscription("tool_command", ToolCommand, MqttBridge.on_tool_command, queue_size=50, tcp_nodelay=True),
        # what makes a switch void must not wait behind others
        shell.Subscription("sync", Sync, MqttBridge.on_sync, queue_size=50, tcp_nodelay=True),
        shell.Subscription("execution", Execution, MqttBridge.on_execution, queue_size=10, tcp_nodelay=True),
    ),
    serves=(
        shell.Served("reset", Trigger, lambda node, _: node.ask("reset")),
        shell.Served("~act_as_seen", ActAsSeen, MqttBridge.on_act_as_seen),
        shell.Served("halt", Trigger, MqttBridge.on_halt),
        shell.Served("mirror", SetBool, MqttBridge.on_mirror),
    ),
    timers=(shell.NodeTimer(lambda _settings: LOG_PERIOD, MqttBridge.write_log),),
)


def check(settings: Settings, robot: RobotModel, shared: shell.Shared) -> None:
    """Check configuration and account, and that a real arm takes commands from accounts alone; see `NodeShell`."""
    config_of_link(robot, shared["gateway"], settings.gateway_kind != PLC)
    broker_of(settings)
    if settings.arm == "real" and not settings.account and not settings.anonymous_broker_is_meant:
        raise ConfigurationError("accounts", "", ACCOUNTS)


NODE = shell.NodeShell("mqtt_bridge", Settings, start, INTERFACE, check, fast=True)
main = NODE.run

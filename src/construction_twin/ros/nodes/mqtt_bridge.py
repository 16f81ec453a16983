"""mqtt_bridge: ROS <-> MQTT in the paper's joint string, and the person's `reset`."""

from __future__ import annotations

import http.client
import threading
import time
import uuid
import xmlrpc.client
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Literal

import pydantic
import rospy
from std_srvs.srv import SetBool, Trigger

from construction_twin.broker.start import ACCOUNTS
from construction_twin.core.errors import ConfigurationError, ExpiredError, PayloadError
from construction_twin.core.freshness import TOO_OLD, parse_moment, staleness
from construction_twin.core.records import SPACED, dumped
from construction_twin.core.reports import LinkReport, SessionRequest, ToolReport
from construction_twin.core.sentences import Sentence, both
from construction_twin.core.side_effects import SideEffects
from construction_twin.core.travel_time import StateCheck
from construction_twin.gateway.config import GatewayConfig
from construction_twin.link.bare_supervisor import BareSupervisor
from construction_twin.link.gateway_status import (
    clock_sentence,
    controller_sentence,
    parse_presence,
    parse_status,
    status_values,
    without_counts,
)
from construction_twin.link.observations import SeenStops
from construction_twin.link.speed_limits import SpeedForwarder
from construction_twin.link.states import LinkState
from construction_twin.link.supervisor import LinkSupervisor
from construction_twin.link.tool_link import ToolLink
from construction_twin.mqtt.client import Broker, make_client, subscriptions, unique_id
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import (
    PLC,
    PROTOCOL,
    BridgeStatus,
    CommandProperties,
    Control,
    StateProperties,
    Topics,
    no_properties,
    read_state_properties,
)
from construction_twin.mqtt.plain_client import PlainClient
from construction_twin.msg import (
    Execution,
    Feedback,
    Link,
    SpeedLimitInForce,
    Sync,
    ToolCommand,
    ToolState,
)
from construction_twin.msg import SessionRequest as SessionRequestMessage
from construction_twin.robot.description import RobotModel
from construction_twin.ros.messages.records import to_msg
from construction_twin.ros.messages.tool import tool_report_to_msg
from construction_twin.ros.shared.deferred_log import DeferredLog
from construction_twin.ros.shared.diagnostics import OK, WARN, NodeDiagnostics, Report
from construction_twin.ros.shared.gateway_config import config_of_link
from construction_twin.ros.shared.mqtt_connection import MqttSettings, broker_of, connect, report_of
from construction_twin.ros.shared.node_shell import NodeShell
from construction_twin.ros.shared.outcome import Outcome
from construction_twin.ros.shared.ports import (
    Interface,
    Ports,
    PosePublication,
    PoseSubscription,
    Publication,
    Served,
    Shared,
    SharedParameter,
    Subscription,
)
from construction_twin.ros.shared.robot_clock import present
from construction_twin.ros.shared.stop_memory import StopMemory
from construction_twin.ros.transport.joint_stream import now_ns
from construction_twin.ros.transport.publisher import Sink
from construction_twin.ros.transport.subscriber import caller_of
from construction_twin.srv import ActAsSeen, ActAsSeenRequest, TakeResponsibility

#: Period at which the link is polled [s].
POLL = 0.02
#: So long a failed request waits for the gateway's word that nothing of it is in force [s].
WITHDRAWAL = 1.0
#: Parameter in the robot's namespace: whether the arm leads. A node that is started again goes on with it.
MIRROR_MODE = "mirror_mode"
#: The same: why a person is waited for, a sentence; empty: nobody is. The launch file clears it.
WAITS = "waits_for_person"
#: Between two writings of the log [s].
LOG_PERIOD = 0.05


class Settings(MqttSettings):
    """Private parameters; see config/mqtt_bridge.yaml."""

    arm: Literal["mock", "real"]
    gateway_kind: Literal["rsi", "plc"] = "rsi"
    anonymous_broker_is_meant: bool = False
    reset_timeout: float = pydantic.Field(gt=0)
    max_state_age: float = pydantic.Field(gt=0)


@dataclass(frozen=True)
class Outputs:
    """Where the bridge publishes in ROS.

    Attributes:
        physical, feedback: The arm's pose for tf and people; the same with its sequence number and command stamp for the gate.
        tool, session_request: None: nobody is told of the tool, or who asked for a session.
    """

    physical: Sink
    feedback: Sink
    link: Sink
    tool: Sink | None = None
    session_request: Sink | None = None


class MqttBridge:
    """ROS and MQTT around a LinkSupervisor; `start` gives it topics, services and a connection.

    `_lock` guards the supervisor and the counters; nothing is sent while it is held. paho has locks of its own for the connection.
    The supervisor gets monotonic times: a wall clock that is set must not make a gateway look alive, or an arm at rest.

    Args:
        robot: Name in the MQTT topics.
        config: As the gateway should run it.
        client: Not connected yet.
        diagnostics: Counts what is refused.
        mirrors: Whether the arm leads from the start.
        waits: Why the bridge before this one waited for a person, in a sentence; empty: it did not.
        remember, remember_mirror: Keep such a sentence, and whether the arm leads, for the bridge after this one; they may take as
            long as the master does.
    """

    def __init__(
        self,
        settings: Settings,
        robot: str,
        config: GatewayConfig,
        codec: JointStringCodec,
        broker: Broker,
        client: PlainClient,
        outputs: Outputs,
        diagnostics: NodeDiagnostics,
        mirrors: bool = False,
        waits: str = "",
        remember: Callable[[str], object] = lambda waits: None,
        remember_mirror: Callable[[bool], object] = lambda mirrors: None,
    ):
        self._settings = settings
        self._codec = codec
        self._outputs = outputs
        bare = settings.gateway_kind == PLC
        # a bare PLC's strings travel alone
        self._properties = config.properties and settings.protocol == "5" and not bare
        self._read_beside = no_properties if bare else read_state_properties
        self._lock = threading.Lock()
        kind = BareSupervisor if bare else LinkSupervisor
        self._supervisor: LinkSupervisor = kind.of(config, lambda: uuid.uuid4().hex, mirrors, waits)
        self._speed = SpeedForwarder(config.speed_limit_deadline)
        self._tool = ToolLink(lambda: uuid.uuid4().hex)
        # orders what is published on `tool`: it comes from several threads
        self._tool_lock = threading.Lock()
        self._mirror_lock, self._put_mirror = threading.Lock(), remember_mirror
        self._tool_told: ToolReport | None = None
        #: Id of the plan that the executor plays, or has played last.
        self._played = ""
        self._sequence = 0
        self._stops = SeenStops()
        self._state_check = StateCheck(settings.max_state_age)
        self._states = 0
        # what the gateway's last status says beside its counters; changed together with the supervisor's status
        self._gateway_values: dict[str, str] = {}
        self._reported: tuple[LinkState, str, str] | None = None
        self._reported_at = 0.0
        self._topics = Topics(settings.prefix, robot)
        self._broker = broker
        self._client = client
        # what tells of a halt, and cannot fail it
        self._side_effects, self._log_queue = SideEffects(), DeferredLog()
        self._connection = report_of(broker)
        # why only a person leads on, for the bridge after this one
        self._waits = waits
        self._memory = StopMemory(waits, remember, WAITS)
        self._diagnostics = diagnostics

    def connect(self) -> None:
        """Connect to the broker, and serve the connection in a thread of its own."""
        self._client.on_stream(self._topics.state, self.on_state)
        on_message = {
            self._topics.status: lambda message: self.on_status(bytes(message.payload)),
            self._topics.control_ack: lambda message: self.on_answer(bytes(message.payload)),
        }
        connect(self._client, self._broker, self._connection, self.on_connect, self.on_disconnect, on_message)

    @property
    def link(self) -> LinkState:
        """State of the link."""
        return self._supervisor.state

    def run(self) -> None:
        """Poll the link until shutdown."""
        threading.Thread(target=self._write_logs, name="log", daemon=True).start()
        while not rospy.is_shutdown():
            self.poll()
            time.sleep(POLL)
        self.end()

    def _write_logs(self) -> None:
        while not rospy.is_shutdown():
            self.write_log()
            time.sleep(LOG_PERIOD)

    def end(self) -> None:
        """Say that the bridge ends, and leave the broker."""
        ended = dumped(BridgeStatus("offline", "bridge stopped"), marks=SPACED)
        self._client.publish(self._topics.bridge_status, ended, 1, True)
        self._client.disconnect()
        self._client.loop_stop()

    def poll(self) -> None:
        """Update the link, and publish what follows from it."""
        with self._lock:
            now = time.monotonic_ns()
            control = self._supervisor.poll(now)
            self._note_stops()
            listens = self._supervisor.state is LinkState.ARMED and self._supervisor.sends_control
            armed = self._supervisor.session if listens else ""
            limit = self._speed.poll(armed, now)
            waits = self._supervisor.waits_for
        if control is not None:
            self._send_control(control)
        if limit is not None:
            # repeated for as long as its source sends: no line in the log
            self._publish_control(Control(str(self._speed.number), armed, "speed_limit", limit))
        # the first sentence stays until nobody is waited for: figures may waver in those that follow
        self._waits = waits and (self._waits or waits)
        self._memory.keep(self._waits, now)
        self._publish_link()
        self._publish_tool()

    def write_log(self) -> None:
        """Write what is to be said, and what has failed: not for the poll, which waits for no disk and no terminal."""
        self._side_effects.run("the log", self._log_queue.flush)
        self._side_effects.write(rospy.logerr)

    # -- ROS to MQTT

    def on_command(self, stamp: int, q: tuple[float, ...]) -> None:
        """Send a command [rad] with its stamp [ns], if the link is armed."""
        with self._lock:
            send = self._supervisor.on_command(q, time.monotonic_ns())
            session = self._supervisor.session
        if not send:
            return
        try:
            payload = self._codec.encode(q)
        except PayloadError as error:
            self._diagnostics.refuse(error.reason, str(error))
            return
        self._sequence += 1
        beside = CommandProperties(session, self._sequence, stamp).pairs() if self._properties else None
        self._client.send_stream(self._topics.command, payload, beside)

    def _send_control(self, control: Control) -> None:
        # the log may wait for a disk or for rosout; what is to stop the arm does not
        self._publish_control(control)
        self._log_queue.add(rospy.loginfo, "%s, session %s", control.verb, control.session)

    def on_speed_limit(self, message: SpeedLimitInForce) -> None:
        """Take the speed limit in force; it is sent with the next poll."""
        source = caller_of(message)
        try:
            with self._lock:
                self._speed.accept(message.limit, source, time.monotonic_ns())
        except PayloadError as error:
            self._diagnostics.refuse(error.reason, str(error))

    def on_tool_command(self, message: ToolCommand) -> None:
        """Take a switch, or the request that none of those that are armed fires."""
        if message.verb not in (ToolCommand.ARM, ToolCommand.VOID):
            self._diagnostics.refuse("tool_command", Sentence("link.tool.verb", verb=message.verb))
            return
        with self._lock:
            supervisor, control = self._supervisor, None
            session = supervisor.session
            if message.verb == ToolCommand.VOID:
                control = self._tool.void(session) if supervisor.sends_control else None
            else:
                armed = supervisor.state is LinkState.ARMED and supervisor.sends_control
                obstacle = "" if armed else self._link_sentence
                if armed and (not message.plan_id or message.plan_id != self._played):
                    plans = {"plan": repr(message.plan_id), "present": repr(self._played)}
                    obstacle = Sentence("link.tool.other_plan", **plans)
                stamp = message.stamp.to_nsec()
                control = self._tool.switch(message.id, message.output, bool(message.value), stamp, session, obstacle)
        if control is not None:
            self._publish_control(control)
        self._publish_tool()
        told = "void" if message.verb == ToolCommand.VOID else f"{message.id} {message.output}"
        self._log_queue.add(rospy.loginfo, "tool: %s", told)

    def on_execution(self, message: Execution) -> None:
        """Take which plan is played: only its switches are armed."""
        with self._lock:
            self._played = message.plan_id

    def on_sync(self, message: Sync) -> None:
        """Take what the monitor says of its gate: nothing that is armed fires while it holds, whatever the executor does."""
        with self._lock:
            supervisor = self._supervisor
            session = supervisor.session
            control = self._tool.on_gate(message.state == Sync.IN_SYNC, session) if supervisor.sends_control else None
        if control is not None:
            self._publish_control(control)
            self._log_queue.add(rospy.loginfo, "tool: void, the monitor's gate is closed")

    def _publish_tool(self) -> None:
        """Tell what is known of the tool, when it has changed."""
        if self._outputs.tool is None:
            return
        with self._tool_lock:
            with self._lock:
                report = self._tool.report(self._tool_obstacle())
            if report == self._tool_told:
                return
            self._tool_told = report
            self._outputs.tool.publish(tool_report_to_msg(report, rospy.Time.now()))

    def _tool_obstacle(self) -> str:
        """Return why the gateway's last word on the tool is not one on the present; "" when it is."""
        if not self._supervisor.sends_control:
            return Sentence("link.tool.plc")
        state = self._supervisor.state
        if state in (LinkState.DISCONNECTED, LinkState.GATEWAY_OFFLINE, LinkState.MISMATCH):
            return self._link_sentence
        return ""

    @property
    def _link_sentence(self) -> Sentence:
        return Sentence("link.is_in", state=self._supervisor.state.name, reason=self._supervisor.reason)

    def _publish_control(self, control: Control) -> bool:
        self._client.publish(self._topics.control, control.to_json(), qos=1)
        return True

    # -- MQTT to ROS

    def on_connect(self, client, userdata, flags, reason_code, properties) -> None:
        """Subscribe, and say that the bridge is here."""
        if reason_code.is_failure:
            self._connection.refused(reason_code)
            return
        self._connection.connected(client, properties)
        client.subscribe(
            subscriptions(
                client,
                [
                    (self._topics.state, 0),
                    (self._topics.status, 1),
                    (self._topics.control_ack, 1),
                ],
            )
        )
        # the broker answers it, and so shows whether this is the account of a bridge
        info = client.publish(self._topics.bridge_status, self._status_report(), qos=1, retain=True)
        self._connection.watch_publish(client, self._topics.bridge_status, info.mid)
        with self._lock:
            self._supervisor.on_connection(True)

    def on_disconnect(self, client, userdata, flags, reason_code, properties) -> None:
        """Report the end of the connection."""
        self._connection.lost(reason_code)
        with self._lock:
            self._supervisor.on_connection(False)

    def on_state(self, payload: bytes, pairs: list[tuple[str, str]], retained: bool) -> None:
        """Take the arm's pose, as a joint string with its user properties."""
        received, now = now_ns(), time.monotonic_ns()
        try:
            if retained:
                raise PayloadError("retained", Sentence("link.payload.retained_state"))
            q = self._codec.decode(payload)
            # where the link carries properties, a pose without them is not the gateway's
            properties = self._read_beside(pairs) if pairs or self._properties else None
            if properties is not None:
                self._state_check.accept(properties.seq, properties.stamp, now)
        except PayloadError as error:
            self._diagnostics.refuse(f"state_{error.reason}", str(error))
            with self._lock:
                self._supervisor.inputs.on_pose_refused(str(error), now)
            return
        with self._lock:
            self._supervisor.on_pose(q, now)
            self._states += 1
        self._publish_physical(q, received, properties)

    def _publish_physical(self, q: tuple[float, ...], received: int, properties: StateProperties | None) -> None:
        seq, command_stamp = (properties.seq, properties.command_stamp) if properties is not None else (0, 0)
        # the gate's first: each program that looks on at the other takes its time from what comes after
        self._outputs.feedback.publish(received, q, seq, command_stamp)
        self._outputs.physical.publish(received, q)

    def on_status(self, payload: bytes) -> None:
        """Take the gateway's status, or a bare PLC's word; one that cannot be read is refused as a whole."""
        try:
            status = parse_presence(payload)
        except PayloadError as error:
            self._diagnostics.refuse(error.reason, str(error))
            return
        with self._lock:
            now = time.monotonic_ns()
            problem = self._supervisor.on_status(status, now)
            if not problem:
                self._tool.on_status(status)
                self._gateway_values = status_values(status)
        if problem:
            self._diagnostics.refuse("status", problem)
        elif status.get("state") == "offline":
            self._state_check.restart()
        self._publish_tool()

    def on_answer(self, payload: bytes) -> None:
        """Take the gateway's answer to a control message."""
        try:
            answer = parse_status(payload)
        except PayloadError as error:
            self._diagnostics.refuse(error.reason, str(error))
            return
        if answer.get("verb") == "speed_limit" and not answer.get("ok"):
            reason = str(answer.get("reason"))[:200]
            self._diagnostics.refuse("speed_limit", Sentence("link.speed_limit_refused", reason=reason))
        with self._lock:
            self._supervisor.on_answer(answer, time.monotonic_ns())
            self._tool.on_answer(answer)
        self._publish_tool()

    # -- services

    def on_reset(self, _request) -> Outcome:
        """Start over from the arm's pose."""
        return self._begin_session("reset", self._supervisor.request_reset)

    def on_arm(self, _request) -> Outcome:
        """Begin a session where nothing needs to move for it."""
        return self._begin_session("arm", self._supervisor.request_arm)

    def on_act_as_seen(self, request: ActAsSeenRequest) -> Outcome:
        """Reset or arm, unless what the person's screen had shown is too old, or older than the last stop.

        A bare PLC is armed in the name of the account.
        """
        acts = {"reset": self._supervisor.request_reset, "arm": self._supervisor.request_arm}
        try:
            if request.act not in acts:
                raise PayloadError("act", Sentence("executor.void.act", act=repr(request.act)))
            seen = parse_moment(request.moment)

            def demand_seen() -> None:
                if problem := staleness(seen, present()):
                    raise ExpiredError(Sentence("link.void.session", problem=problem))
                if not self._stops.was_seen(seen):
                    raise ExpiredError(Sentence("link.void.session_since"))

            if request.act == "arm" and not self._supervisor.sends_control:
                return self._take_responsibility(request.person, demand_seen)
            return self._begin_session(request.act, acts[request.act], request.person, demand_seen)
        except ExpiredError as error:
            self._diagnostics.refuse(TOO_OLD, str(error))
            return Outcome(False, str(error), expired=True)

    def on_responsible(self, request) -> Outcome:
        """Arm a bare PLC in a person's name; when that does not succeed in time it is not tried any longer."""
        return self._take_responsibility(request.responsible)

    def _take_responsibility(self, name: str, demand: Callable[[], None] = lambda: None) -> Outcome:
        supervisor = self._supervisor
        with self._lock:
            self._note_stops()
            demand()
            lifts = supervisor.reason
            supervisor.take_responsibility(name, time.monotonic_ns())
            session, halts = supervisor.session, supervisor.halts
        self._tell_request("arm", name, lifts)

        def withdraw(because: str) -> None:
            # meanwhile a person may have halted, and another one begun
            if supervisor.session == session and supervisor.state is LinkState.RESYNC:
                supervisor.withdraw_responsibility(because)

        return Outcome(*self._wait_for_arming(halts, lambda: supervisor.session == session, withdraw))

    def _begin_session(
        self, verb: str, ask: Callable[[int], None], person: str = "", demand: Callable[[], None] = lambda: None
    ) -> Outcome:
        """Begin a session that a person asked for, and wait until it is armed.

        Args:
            demand: Called first, under the lock: raises what stands against it.
        """
        with self._lock:
            self._note_stops()
            demand()
            before, halts, lifts = self._supervisor.session, self._supervisor.halts, self._supervisor.reason
            ask(time.monotonic_ns())
            number = self._supervisor.requests
        self._tell_request(verb, person, lifts)
        armed, sentence = self._wait_for_request(number, halts, before)
        return Outcome(armed, Sentence("link.armed", reason=sentence) if armed else sentence)

    def _note_stops(self) -> None:
        """Take note of a stop or halt that was not known yet: no screen has shown it."""
        supervisor = self._supervisor
        self._stops.note((*supervisor.known_stop, supervisor.halts), present())

    def _tell_request(self, verb: str, person: str, lifts: str) -> None:
        """Tell who asked for a session, for the record."""
        request = SessionRequest(verb, person, lifts, rospy.Time.now().to_nsec())
        if self._outputs.session_request is not None:
            self._outputs.session_request.publish(to_msg(request, SessionRequestMessage))
        self._log_queue.add(rospy.loginfo, "%s asked for by %s: %s", verb, person or "a service", lifts)

    def _wait_for_request(self, number: int, halts: int, before: str) -> tuple[bool, str]:
        """Wait as `_wait_for_arming` for the session that a person asked for; what fails is withdrawn, also at the gateway."""
        supervisor = self._supervisor
        armed, sentence = self._wait_for_arming(
            halts, lambda: supervisor.session != before, partial(supervisor.withdraw, number)
        )
        # who asks again at once must know of the stop with which it is withdrawn
        deadline = time.monotonic() + WITHDRAWAL
        while not armed and time.monotonic() < deadline and not rospy.is_shutdown():
            with self._lock:
                if not supervisor.withdraws or supervisor.state is not LinkState.NEEDS_RESET:
                    break
            time.sleep(POLL)
        return armed, sentence

    def _wait_for_arming(
        self, halts: int, is_asked_for: Callable[[], bool], give_up: Callable[[str], None]
    ) -> tuple[bool, str]:
        """Return whether the session that was asked for is armed in time, and one sentence; else give up, told the sentence.

        A halt ends it at once, and so does whatever else ends the session, such as a stop. The last look and the giving up are one
        hold of the lock: what is answered is what is the case.
        """
        supervisor, timeout = self._supervisor, self._settings.reset_timeout
        deadline = time.monotonic() + timeout
        while True:
            late = time.monotonic() >= deadline or rospy.is_shutdown()
            with self._lock:
                if supervisor.state is LinkState.ARMED and is_asked_for() and not supervisor.inputs.fault:
                    return True, supervisor.reason
                if supervisor.halts != halts:
                    return False, Sentence("link.not_armed.halted", why=supervisor.sentence)
                if supervisor.state is LinkState.NEEDS_RESET and is_asked_for():
                    sentence = Sentence("link.not_armed.ended", why=supervisor.sentence)
                    give_up(sentence)
                    return False, sentence
                if late:
                    why, refused = supervisor.sentence, supervisor.inputs.why_no_pose(time.monotonic_ns())
                    if refused and refused not in why:
                        why = Sentence("executor.both", first=why, second=refused)
                    sentence = Sentence("link.not_armed.late", timeout=timeout, why=why)
                    give_up(sentence)
                    return False, sentence
            time.sleep(POLL)

    def on_halt(self, _request) -> Outcome:
        """Stop executor and gateway: the gateway brakes the arm within its limits, and the executor drops its plan."""
        with self._lock:
            session, mirrored = self._supervisor.session, self._supervisor.mirrors
            tells = self._supervisor.sends_control
            # the link is not armed from here on: the executor drops its plan, no command is sent, and the gateway brakes on silence
            self._supervisor.halt(Sentence("link.halt.asked" if tells else "link.halt.plc"))
        sent = tells and self._side_effects.run("the stop for the gateway", self._send_stop, session)
        if mirrored:
            # in a thread of its own: a master that hangs must not hold up the answer
            remember = partial(self._side_effects.run, "what outlasts this node", self._remember_mirror)
            threading.Thread(target=remember, daemon=True).start()
        if not tells:
            return Outcome(True, Sentence("link.halt.plc"))
        if not sent:
            return Outcome(False, Sentence("link.halt.unsent"))
        if not self._client.is_connected():
            return Outcome(False, Sentence("link.halt.no_broker"))
        return Outcome(True, Sentence("link.halt.sent"))

    def _send_stop(self, session: str) -> bool:
        control = Control(uuid.uuid4().hex, session, "stop")
        sent = self._publish_control(control)
        # after the answer: it waits for a disk, or for rosout
        self._side_effects.run(
            "the log", self._log_queue.add, rospy.loginfo, "%s, session %s", control.verb, control.session
        )
        return sent

    def on_mirror(self, request) -> str:
        """Begin or end mirror mode."""
        with self._lock:
            supervisor, now = self._supervisor, time.monotonic_ns()
            before, halts, requests = supervisor.session, supervisor.halts, supervisor.requests
            sentence = supervisor.begin_mirror(now) if request.data else supervisor.end_mirror(now)
            number = supervisor.requests
        problem = self._remember_mirror()
        if problem:
            sentence = Sentence("link.mirror.not_kept", sentence=sentence, problem=problem)
        if number != requests:
            armed, why = self._wait_for_request(number, halts, before)
            if not armed:
                sentence = both(sentence, why)
        return sentence

    def _remember_mirror(self) -> str:
        """Keep the mode beyond this process; return why the master does not take it, "" when it does."""
        try:
            # one after the other, and each what is the case then: several threads write
            with self._mirror_lock:
                self._put_mirror(self._supervisor.mirrors)
        except (OSError, rospy.ROSException, xmlrpc.client.Error, http.client.HTTPException) as error:
            rospy.logwarn("mirror mode would not outlast this node: %s was not written (%s)", MIRROR_MODE, error)
            return str(error) or type(error).__name__
        return ""

    # -- reports

    def _status_report(self) -> bytes:
        with self._lock:
            supervisor = self._supervisor
            status = BridgeStatus(
                supervisor.state.name.lower(),
                supervisor.reason,
                supervisor.session,
                PROTOCOL,
                supervisor.responsible if supervisor.not_checked else None,
                supervisor.not_checked or None,
            )
        return dumped(status, marks=SPACED)

    def _publish_link(self) -> None:
        with self._lock:
            supervisor = self._supervisor
            state = (supervisor.state, self._reason(), supervisor.session)
            # neither is ever changed, only replaced
            status, values = supervisor.status, self._gateway_values
        now = time.monotonic()
        news = (state[0], without_counts(state[1]), state[2])
        changed = news != self._reported
        if not changed and now - self._reported_at < 1.0:
            return
        self._reported, self._reported_at = news, now
        self._outputs.link.publish(to_msg(self._link_report(*state, status, values), Link))
        if changed:
            self._client.publish(self._topics.bridge_status, self._status_report(), qos=1, retain=True)
            self._log_queue.add(rospy.loginfo, "%s: %s", state[0].name, state[1])

    def _reason(self) -> str:
        """Return the supervisor's sentence; without a connection also why there is none, else why the arm may not move."""
        reason, why = self._supervisor.reason, self._connection.sentence
        state = self._supervisor.state
        if state is LinkState.DISCONNECTED:
            return Sentence("executor.link", state=reason, reason=why) if why else reason
        # a status of a gateway that is gone says nothing of now
        if state is LinkState.GATEWAY_OFFLINE:
            return reason
        status = self._supervisor.status
        return both(reason, controller_sentence(status), clock_sentence(status))

    def _link_report(
        self, state: LinkState, reason: str, session: str, status: Mapping, values: Mapping[str, str]
    ) -> LinkReport:
        # a copy: other threads go on counting
        refused = self._diagnostics.refused
        states_refused = sum(count for name, count in refused.items() if name.startswith("stat"))
        reply = status.get("reply_us", {})
        counters = status.get("counters", {}) | values
        counters["decimals"] = status.get("decimals", "")
        counters["reply_us_max"] = reply.get("max", 0)
        counters["states_lost"] = self._state_check.lost
        return LinkReport(
            state.name,
            reason,
            gateway_state=str(status.get("state", "offline")),
            gateway_counters={key: str(value) for key, value in sorted(counters.items())},
            commands_refused=sum(refused.values()) - states_refused,
            states_refused=states_refused,
            responsible=self._supervisor.responsible,
            not_checked=tuple(self._supervisor.not_checked),
            gateway_kind=self._supervisor.kind,
            session=session,
            state=state.value,
            stamp=rospy.Time.now().to_nsec(),
            commands_sent=self._sequence,
            reply_us_bins=tuple(reply.get("bins", ())),
            reply_us_counts=tuple(reply.get("counts", ())),
        )

    def report(self) -> Report:
        """Return the state for `/diagnostics`."""
        with self._lock:
            state, session, reason = self._supervisor.state, self._supervisor.session, self._reason()
            gateway = self._supervisor.status.get("counters", {}) | self._gateway_values
        values = {"session": session, "commands sent": self._sequence, "states received": self._states}
        values |= {f"gateway {key}": value for key, value in sorted(gateway.items())}
        if self._supervisor.not_checked:
            values["responsible"] = self._supervisor.responsible or "no person: not armed"
            parts = [sentence.partition(": ") for sentence in self._supervisor.not_checked]
            values |= {f"not checked: {topic}": what for topic, _, what in parts}
        if not self._properties:
            values["comparison"] = "instant: the link carries no MQTT 5 properties"
        values |= self._side_effects.report()
        if self._memory.problem:
            return Report(WARN, f"{state.name}: {reason}; {self._memory.problem}", values)
        if failed := self._side_effects.sentence:
            return Report(WARN, f"{state.name}: {reason}; {failed}", values)
        level = OK if state in (LinkState.ARMED, LinkState.MIRROR) else WARN
        return Report(level, f"{state.name}: {reason}", values)


def start(settings: Settings, robot: RobotModel, ports: Ports) -> MqttBridge:
    """Return the bridge with its parameters, topics and services, connecting to the broker."""
    config = config_of_link(robot, ports.parameters["gateway"], settings.gateway_kind != PLC)
    broker = broker_of(settings)
    topics = Topics(settings.prefix, robot.name)
    bridge = MqttBridge(
        settings,
        robot.name,
        config,
        JointStringCodec.of(robot, config.decimals),
        broker,
        make_client(broker, unique_id(robot.name, "bridge"), topics.bridge_status, direct=True),
        Outputs(
            physical=ports.publishers["physical/joint_states"],
            feedback=ports.publishers["physical/feedback"],
            link=ports.publishers["link"],
            tool=ports.publishers["tool"],
            session_request=ports.publishers["session_request"],
        ),
        ports.diagnostics,
        # not a private parameter: those hold settings, and this was asked for while the bridge ran
        mirrors=ports.parameters[MIRROR_MODE] is True,
        waits=str(ports.parameters[WAITS]),
        remember=ports.keeper(WAITS),
        remember_mirror=ports.keeper(MIRROR_MODE),
    )
    bridge.connect()
    return bridge


INTERFACE = Interface(
    report=MqttBridge.report,
    parameters=(
        SharedParameter(MIRROR_MODE, False, kept=True),
        SharedParameter(WAITS, "", kept=True),
        SharedParameter("gateway"),
    ),
    publishes=(
        PosePublication("physical/joint_states"),
        PosePublication("physical/feedback", Feedback),
        Publication("link", Link, queue_size=10, latch=True),
        Publication("tool", ToolState, queue_size=50, latch=True),
        Publication("session_request", SessionRequestMessage, queue_size=10),
    ),
    hears=(
        PoseSubscription("command/joint_states", MqttBridge.on_command),
        Subscription("speed_limit_in_force", SpeedLimitInForce, MqttBridge.on_speed_limit, queue_size=5),
        Subscription("tool_command", ToolCommand, MqttBridge.on_tool_command, queue_size=50, tcp_nodelay=True),
        # what makes a switch void must not wait behind others
        Subscription("sync", Sync, MqttBridge.on_sync, queue_size=50, tcp_nodelay=True),
        Subscription("execution", Execution, MqttBridge.on_execution, queue_size=10, tcp_nodelay=True),
    ),
    serves=(
        Served("reset", Trigger, MqttBridge.on_reset),
        Served("~arm", Trigger, MqttBridge.on_arm),
        Served("~act_as_seen", ActAsSeen, MqttBridge.on_act_as_seen),
        Served("arm", TakeResponsibility, MqttBridge.on_responsible),
        Served("halt", Trigger, MqttBridge.on_halt),
        Served("mirror", SetBool, MqttBridge.on_mirror),
    ),
)


def check(settings: Settings, robot: RobotModel, shared: Shared) -> None:
    """Check configuration and account, and that a real arm takes commands from accounts alone; see `NodeShell`."""
    config_of_link(robot, shared["gateway"], settings.gateway_kind != PLC)
    broker_of(settings)
    if settings.arm == "real" and not settings.account and not settings.anonymous_broker_is_meant:
        raise ConfigurationError("bridge_account", "", ACCOUNTS)


NODE = NodeShell("mqtt_bridge", Settings, start, INTERFACE, check, fast=True)


def main() -> None:
    """Run the node."""
    NODE.run()

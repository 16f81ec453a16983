"""The bridge's inputs about broker, gateway, arm and command stream, and the obstacle to a link.

Pure: time is an argument [ns]. Angles in rad (axis space).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import Enum

from construction_twin.core.limits import outside_tolerance
from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.config import GatewayConfig
from construction_twin.link.gateway_status import NO_STATUS, GatewayStatus, ToolPose
from construction_twin.mqtt.messages import OFFLINE, PLC, PROTOCOL, protocol_mismatch

#: A pose or command older than this is not used for a decision [ns].
FRESH = NANOSECONDS // 4
#: The arm is at rest when its pose has not moved for this long [ns].
REST = NANOSECONDS // 5
#: A retained status is believed this long without a newer one; the gateway repeats its status every second [ns].
STATUS_TIMEOUT = 3 * NANOSECONDS
#: States of a gateway without a controller that it answers, and of one whose arm can be followed but not commanded.
_NO_SESSION = ("no_controller", "joined_running")
_ONLY_POSES = ("read_only", "measuring", "other_cycle")
#: From the moment when a stop is known to the moment of the first `view` that surely shows it [ns]: the bridge's poll and `link`.
SHOWN_AFTER = NANOSECONDS // 4


class LinkState(Enum):
    """State of the link; values are those of `Link.msg`."""

    DISCONNECTED = 0
    GATEWAY_OFFLINE = 1
    NO_CONTROLLER = 2
    MISMATCH = 3
    RESYNC = 4
    ARMED = 5
    NEEDS_RESET = 6
    MIRROR = 7
    OTHER_ARM = 8


#: States without broker, gateway or arm.
ABSENT = (LinkState.DISCONNECTED, LinkState.GATEWAY_OFFLINE, LinkState.NO_CONTROLLER, LinkState.MISMATCH)


class ArmAndStream:
    """The newest pose of the arm and the newest command, and whether they rest and meet."""

    def __init__(self, config: GatewayConfig):
        self._tolerances = tuple(config.start_tolerances)
        # an arm that rests between two values of the wire flickers by one digit
        digits = config.limits.last_digits(config.decimals)
        self._rest_bands = tuple(max(most / 50, 1.5 * digit) for most, digit in zip(self._tolerances, digits))
        self._pose: tuple[float, ...] = ()
        self._rest_pose: tuple[float, ...] = ()
        self._pose_at, self._moved_at = -FRESH, 0
        self._command: tuple[float, ...] = ()
        self._command_at, self._command_rests_since = -FRESH, 0

    def on_pose(self, q: tuple[float, ...], now: int) -> None:
        """Store the arm's pose [rad]."""
        if not self._pose or outside_tolerance(q, self._rest_pose, self._rest_bands) is not None:
            self._rest_pose, self._moved_at = q, now
        self._pose, self._pose_at = q, now

    def on_command(self, q: tuple[float, ...], now: int) -> None:
        """Store a command to be sent [rad]."""
        # before the first one, and after a pause, it is not known how it moved
        if q != self._command or now - self._command_at >= FRESH:
            self._command_rests_since = now
        self._command, self._command_at = q, now

    def forget_command(self) -> None:
        """Wait for the next command: the last one belongs to another session."""
        self._command = ()

    def pose_is_fresh(self, now: int) -> bool:
        """Return whether the arm's pose is known."""
        return now - self._pose_at < FRESH

    def at_rest(self, now: int) -> bool:
        """Return whether the arm's pose is known, and has not changed for `REST`."""
        return self.pose_is_fresh(now) and now - self._moved_at >= REST

    def why_not_at_rest(self, now: int) -> str:
        """Return why the arm is not at rest, or unknown to be; "" when it is."""
        return "" if self.at_rest(now) else Sentence("the arm's pose is unknown or still changing; wait until it rests")

    def stream_rests(self, now: int) -> bool:
        """Return whether commands come, and have been the same for `REST`."""
        return self._command_is_fresh(now) and self._command_at - self._command_rests_since >= REST

    def _command_is_fresh(self, now: int) -> bool:
        return bool(self._command) and now - self._command_at < FRESH

    def within_tolerance(self, now: int) -> bool:
        """Return whether command and pose are fresh and within the start tolerance of each other."""
        if not self._command_is_fresh(now) or not self.pose_is_fresh(now):
            return False
        return outside_tolerance(self._command, self._pose, self._tolerances) is None


#: At axes that differ by so much the tool is elsewhere, to the last digit that is sent [rad], [m].
_ELSEWHERE = 0.01
#: From axes, the tool that is reported there, and whether there is time to look for a cause, to how far the tool is off [m], [rad],
#: and why that is too far ("": it is not).
Compare = Callable[[Sequence[float], Sequence[float], bool], tuple[float, float, str]]


class ArmCheck:
    """Whether the arm is its model's: the tool that the controller reports, compared at rest.

    Args:
        compare: None: nothing is compared, because `skipped`.
        refuses: False: another arm than the model's is armed all the same.

    Attributes:
        text: The comparison for people; "" before the first.
        problem: Why it is another arm; "": nothing is known against it.
        difference: The tool's [m], [rad]; () before the first comparison.
    """

    def __init__(self, compare: Compare | None = None, skipped: str = "", refuses: bool = True):
        self._do, self._refuses = compare, refuses
        self.text, self.problem = skipped, ""
        self.difference: tuple[float, ...] = ()
        self._compared: ToolPose | None = None

    @property
    def refusal(self) -> str:
        """Why the arm must not be armed; "": it may."""
        return self.problem if self._refuses else ""

    def compare(self, status: GatewayStatus, at_rest: bool, explains: bool) -> None:
        """Compare what a status has of the tool, once; `explains`: no commands flow, so there is time to look for a cause."""
        pose = status.tool_pose
        if self._do is None or status.state == OFFLINE:
            return
        if pose is None:
            self.problem, self.difference = "", ()
            known = status.state not in _NO_SESSION
            self.text = Sentence("not compared: the controller does not send where its tool is") if known else ""
        elif at_rest and self._is_constant(pose):
            self.problem, self.difference = "", ()
            self.text = Sentence("not compared: the controller sends one tool pose whatever its axes are")
        elif at_rest and pose is not self._compared:
            self._compared = pose
            distance, angle, problem = self._do(pose.axes, (*pose.position, *pose.abc), explains)
            # a cause that was found is kept while commands flow
            if explains or not problem or not self.problem:
                self.problem = problem
            self.difference = distance, angle
            values = {"distance": Quantity(distance, "m"), "angle": Quantity(angle, "rad")}
            self.text = self.problem or Sentence("{distance:.3} and {angle:.3} off the model's", **values)

    def _is_constant(self, pose: ToolPose) -> bool:
        """Return whether a controller fills the tool's pose in, as simulators do: with zeros, or the same at other axes."""
        if not any((*pose.position, *pose.abc)):
            return True
        before = self._compared
        if before is None or (before.position, before.abc) != (pose.position, pose.abc):
            return False
        return max(abs(one - other) for one, other in zip(before.axes, pose.axes)) > _ELSEWHERE


class LinkObservations(ArmAndStream):
    """The newest inputs of the link's decisions.

    Attributes:
        arm: Whether the arm is its model's.
        status: The gateway's last one; `NO_STATUS` while there is no connection.
        offline_received: Whether `offline` came since this was set to False: a bare PLC has stopped, however soon `ready` follows.
    """

    def __init__(self, config: GatewayConfig, bare: bool = False, arm: ArmCheck | None = None):
        super().__init__(config)
        self.arm = arm or ArmCheck()
        self._hash, self._bare = config.hash, bare
        self.status, self._status_at = NO_STATUS, 0
        self.offline_received = self._connected = False
        # another gateway that answers beside the one whose status counts: its run, and when it spoke last
        self._other_run, self._other_at = "", -STATUS_TIMEOUT
        # the number in the last status without a fault, in its run; and what was stopped since, in the newest run that showed it
        self._clear: tuple[str, int] = ("", 0)
        self._stopped_in, self._stop_reason = "", ""

    # -- what comes in

    def on_connection(self, connected: bool) -> None:
        """Store whether there is a connection to the broker."""
        self._connected = connected
        if not connected:
            self.status, self._other_at = NO_STATUS, -STATUS_TIMEOUT

    def on_status(self, status: GatewayStatus, now: int) -> str:
        """Store a status; return why it is ignored, "" when it counts."""
        problem = "" if self._bare else self._reason_to_ignore(status, now)
        if status.kind != PLC and status.run != self.status.run:
            if problem and status.state != OFFLINE:
                self._other_run, self._other_at = status.run, now
            elif status.run == self._other_run:
                self._other_at = -STATUS_TIMEOUT
        if not problem:
            self.status, self._status_at = status, now
            self.offline_received |= status.state == OFFLINE
            self._record_stop()
        return problem

    def _reason_to_ignore(self, status: GatewayStatus, now: int) -> str:
        """Return why a status is ignored: while a gateway answers, only its own run may end a motion."""
        known = self.status
        if known.state == OFFLINE or now - self._status_at > STATUS_TIMEOUT:
            return ""
        if known.run and status.run != known.run:
            runs = {"run": repr(status.run), "present": repr(known.run)}
            return Sentence("status of run {run}, while run {present} answers: it changes nothing", **runs)
        if status.state == OFFLINE and _is_before(status.connection, known.connection):
            found = {"run": repr(known.run)}
            return Sentence("the last will of a former connection of run {run}: it changes nothing", **found)
        if _is_before(status.fault_number, known.fault_number):
            # a client sends again what was not acknowledged, behind what is newer
            numbers = {"number": str(status.fault_number), "known": str(known.fault_number)}
            return Sentence("an old status, of stop {number} after stop {known}", **numbers)
        return ""

    def _record_stop(self) -> None:
        status = self.status
        run, number = status.run, status.fault_number
        if not run or number is None or status.state == OFFLINE:
            return
        if not status.fault:
            self._clear = run, number
            if self._stopped_in == run:
                self._stopped_in = ""
        elif status.has_failed or (number and (run, number) != self._clear):
            # a program that ends stops too, which gets no number; one that has failed may not have got as far as one
            self._stopped_in, self._stop_reason = run, status.reason

    def forget_stop(self) -> None:
        """Forget earlier stops: the link is armed, at a person's request."""
        self._stopped_in = ""

    @property
    def stop_reason(self) -> str:
        """Reason of the stop in the newest run that showed one, until a reset; "" for none."""
        return self._stop_reason if self._stopped_in else ""

    @property
    def stopped_before(self) -> str:
        """Reason of a stop that a former run of the gateway showed; "" for none."""
        return self._stop_reason if self._stopped_in not in ("", self.status.run) else ""

    @property
    def could_go_on(self) -> bool:
        """True when the gateway is ready, armed for a stream that never began, or holds and its last stop was for silence."""
        by_silence = self.status.stop.get("cause") == "silence"
        return self.status.state in ("ready", "armed") or (self.status.state == "holding" and by_silence)

    def follows(self, session: str) -> bool:
        """Return whether the gateway is armed for a session or follows it."""
        return self.status.is_armed and self.status.session == session

    def follows_another(self, session: str) -> bool:
        """Return whether the gateway is armed for another session than this one, or follows it."""
        return self.status.is_armed and self.status.session != session

    def compare_arm(self, now: int, explains: bool) -> None:
        """Compare the controller's tool pose with the model's at rest; `explains`: there is time to look for a cause."""
        pose = self.status.tool_pose
        # a gateway of another arm is another configuration
        if pose is None or len(pose.axes) == len(self._tolerances):
            self.arm.compare(self.status, self.at_rest(now), explains)

    # -- what is missing

    def obstacle(self, now: int, mirrors: bool) -> tuple[LinkState, str] | None:
        """Return what is missing for a link that commands, or in mirror mode for one that follows, and one sentence."""
        if not self._connected:
            return LinkState.DISCONNECTED, Sentence("not connected to the broker")
        if self._bare:
            return self._plc_obstacle(now)
        status = self.status
        if status.kind == PLC and status.state != OFFLINE:
            return LinkState.MISMATCH, Sentence(
                "a bare PLC answers on the broker, no rsi_gateway: start with gateway_kind:=plc (docs/broker.md)"
            )
        if status.state == OFFLINE or now - self._status_at > STATUS_TIMEOUT:
            return LinkState.GATEWAY_OFFLINE, Sentence(
                "no gateway answers on the broker; start rsi_gateway on the cell PC"
            )
        if mismatch := self._mismatch(now):
            return LinkState.MISMATCH, mismatch
        if status.state in _NO_SESSION or (status.state in _ONLY_POSES and not mirrors):
            return LinkState.NO_CONTROLLER, Sentence(
                "gateway has no RSI session to command: {reason}", reason=status.reason
            )
        return None

    def _mismatch(self, now: int) -> str:
        status = self.status
        if now - self._other_at < STATUS_TIMEOUT:
            return Sentence(
                "more than one gateway answers on the broker: {runs} (each logs its run when it starts): end all but one",
                runs=f"run {status.run} and run {self._other_run or 'without a name'}",
            )
        if sentence := protocol_mismatch(status.protocol, PROTOCOL):
            return sentence
        if status.hash != self._hash:
            return Sentence(
                "gateway runs another configuration (its hash differs); export it by `twin gateway`, then restart the gateway"
            )
        if not status.run or status.fault_number is None:
            return Sentence(
                "gateway names no run, or no fault_number, in its status; install the same version on both sides"
            )
        return ""

    def _plc_obstacle(self, now: int) -> tuple[LinkState, str] | None:
        if self.status.kind != PLC and self.status.state != OFFLINE:
            return LinkState.MISMATCH, Sentence(
                "rsi_gateway answers on the broker, no bare PLC: start with gateway_kind:=rsi, or stop that gateway"
            )
        if self.status is NO_STATUS:
            return LinkState.GATEWAY_OFFLINE, Sentence("no PLC has said `ready` on its `status` topic, retained")
        if self.offline_received or self.status.state == OFFLINE:
            return LinkState.GATEWAY_OFFLINE, Sentence("the PLC says `offline`: it takes no strings; see to the PLC")
        if not self.pose_is_fresh(now):
            return LinkState.NO_CONTROLLER, Sentence(
                "the PLC says `ready`, but no valid joint string comes on its `state` topic: see /diagnostics"
            )
        return None


def _is_before(number: int | None, other: int | None) -> bool:
    return number is not None and other is not None and number < other

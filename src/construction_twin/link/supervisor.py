"""Who may command, and when: the bridge's side of arming and resetting the gateway.

Pure: events in, control messages out; time is an argument [ns]. Angles in rad (axis space).

A session is one continuous right to command. Its change makes the twin take over the arm's pose and executor and gate start over;
only then, with a command stream within the start tolerance of the arm, is the gateway armed (design, law 5).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import Enum

from construction_twin.core.errors import ReviewError
from construction_twin.core.limits import outside_tolerance
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.config import GatewayConfig
from construction_twin.mqtt.messages import Control, arm_value

#: A pose or command older than this is not used for a decision [ns].
FRESH = NANOSECONDS // 4
#: The arm is at rest when its pose has not moved for this long [ns].
REST = NANOSECONDS // 5
#: Pause before an unanswered control message is sent again [ns].
RETRY = NANOSECONDS // 2
#: A retained "I am here" is believed this long without a newer status; the gateway repeats its status every second [ns].
STATUS_TIMEOUT = 3 * NANOSECONDS


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


class LinkSupervisor:
    """Decides when to start a session, arm, and resume.

    Parameters
    ----------
    config_hash : str
        Hash of the configuration that this side would give the gateway.
    decimals : int
    start_tolerances : tuple of float, shape (n,)
        Per joint [rad], [m], as `GatewayConfig.start_tolerances`.
    last_digits : tuple of float, shape (n,)
        What the last decimal on the wire is worth [rad], [m], as `MotionLimits.last_digits`.
    new_id : callable
        Returns a new unique id.
    mirrors : bool, optional
        Whether the arm leads from the start: it did when the process before this one ended, and only a person ends that.
    """

    def __init__(
        self,
        config_hash: str,
        decimals: int,
        start_tolerances: Sequence[float],
        last_digits: Sequence[float],
        new_id: Callable[[], str],
        mirrors: bool = False,
    ):
        self._hash = config_hash
        self._decimals = decimals
        self._tolerances = tuple(start_tolerances)
        # an arm that rests between two values of the wire flickers by one digit
        self._rest_bands = tuple(
            max(tolerance / 50, 1.5 * digit) for tolerance, digit in zip(start_tolerances, last_digits)
        )
        self._new_id = new_id
        self.state = LinkState.DISCONNECTED
        self.reason = "not connected to the broker yet"
        self.session = new_id() if mirrors else ""
        self.status: dict = {}
        self._status_at = 0
        self._connected = False
        self._pose: tuple[float, ...] | None = None
        self._pose_at = 0
        self._rest_pose: tuple[float, ...] = ()
        self._moved_at = 0
        self._command: tuple[float, ...] | None = None
        self._command_at = 0
        self._command_moved_at = 0
        self._mirror = mirrors
        self._ended_session = ""
        self._was_armed = False
        self._reset_wanted = False
        self._asked_for = False
        self._arm_refused = False
        self._stopped: str | None = None
        self._pending: Control | None = None
        self._sent_at = 0

    @classmethod
    def of(cls, config: GatewayConfig, new_id: Callable[[], str], mirrors: bool = False) -> LinkSupervisor:
        """Return the supervisor of a robot whose gateway runs `config`."""
        digits = config.limits.last_digits(config.decimals)
        return cls(config.hash, config.decimals, config.start_tolerances, digits, new_id, mirrors)

    # -- events

    def on_connection(self, connected: bool) -> None:
        """Take the state of the connection to the broker."""
        self._connected = connected
        if not connected:
            self.status = {}

    def on_status(self, status: dict, now: int) -> None:
        """Take the gateway's status."""
        self.status, self._status_at = status, now

    def on_pose(self, q: tuple[float, ...], now: int) -> None:
        """Take the arm's pose [rad]."""
        if self._pose is None or outside_tolerance(q, self._rest_pose, self._rest_bands) is not None:
            self._rest_pose, self._moved_at = q, now
        self._pose, self._pose_at = q, now

    def on_command(self, q: tuple[float, ...], now: int) -> bool:
        """Take a command that wants to be sent [rad]; return whether it may be."""
        if self._command is not None and q != self._command:
            self._command_moved_at = now
        self._command, self._command_at = q, now
        return self.state is LinkState.ARMED

    def on_answer(self, answer: dict, now: int) -> None:
        """Take the gateway's answer to a control message."""
        if self._pending is None or answer.get("id") != self._pending.id:
            return
        verb = self._pending.verb
        if not answer.get("ok"):
            # stays pending: asked again after the usual pause, not with every poll
            self.reason = f"gateway refused {verb}: {answer.get('reason')}"
            self._arm_refused = verb == "arm"
            return
        self._pending = None
        if verb == "arm":
            self._was_armed = True
            # commissioning: the link is armed, and yet the arm stands still
            mode = "; gateway is in commissioning mode" if self.status.get("mode") == "commissioning" else ""
            self._enter(LinkState.ARMED, f"session {self.session}{mode}")

    def request_reset(self, now: int) -> None:
        """Start over from the arm's pose, on a person's request.

        Raises
        ------
        ReviewError
            When there is no arm to start from, it moves, or it leads.
        """
        if self._mirror:
            raise ReviewError(
                "cannot reset: the arm leads (mirror mode); call mirror with false, which ends in the same"
            )
        if self.state in (
            LinkState.DISCONNECTED,
            LinkState.GATEWAY_OFFLINE,
            LinkState.NO_CONTROLLER,
            LinkState.MISMATCH,
        ):
            raise ReviewError(f"cannot reset: {self.reason}")
        if not self._at_rest(now):
            raise ReviewError(
                "cannot reset: the arm's pose is unknown or still changing; stop it and wait until it is at rest"
            )
        self._reset_wanted = True

    def request_arm(self, now: int) -> None:
        """Begin a session on a person's request where nothing needs to move for it.

        Raises
        ------
        ReviewError
            When it is armed already, there is no arm, or twin and arm are not at rest within the start tolerance.
        """
        if self.state is not LinkState.NEEDS_RESET:
            raise ReviewError(f"nothing to arm: {self.state.name}, {self.reason}")
        if not (self._within_tolerance(now) and self._at_rest(now)):
            raise ReviewError(
                "twin and arm are not at rest within the start tolerance of each other; call reset instead"
            )
        self._reset_wanted = True

    def begin_mirror(self, now: int) -> str:
        """Let the arm lead, on a person's request: nothing is commanded until `end_mirror`. Return one sentence.

        Raises
        ------
        ReviewError
            When there is no arm to follow, or arm or command stream move.
        """
        if self._mirror:
            return "the arm leads already"
        obstacle = self._obstacle(now)
        if obstacle is not None and not self._reads_only:
            raise ReviewError(f"cannot mirror: {obstacle[1]}")
        if not self._at_rest(now):
            raise ReviewError("cannot mirror: the arm's pose is unknown or still changing; wait until it is at rest")
        if self._command is not None and now - self._command_moved_at < REST and now - self._command_at < FRESH:
            raise ReviewError(
                "cannot mirror: the command stream still moves; stop or pause the plan and wait until it is at rest"
            )
        # a new session without a right to command: executor and gate start over, and what was recorded of the old one is void
        self._ended_session, self.session = self.session, self._new_id()
        self._mirror = True
        self._pending, self._stopped, self._reset_wanted, self._asked_for = None, None, False, False
        self._enter(LinkState.MIRROR, "the arm leads, the twin follows; nothing is commanded")
        return self.reason

    def end_mirror(self, now: int) -> str:
        """Stop following the arm, on a person's request, and start over as after `reset`. Return one sentence.

        Raises
        ------
        ReviewError
            When the arm does not lead, there is none, or it moves.
        """
        if not self._mirror:
            raise ReviewError(f"the arm does not lead: {self.state.name}, {self.reason}")
        obstacle = self._obstacle(now)
        if obstacle is not None:
            raise ReviewError(f"cannot leave mirror mode: {obstacle[1]}")
        if not self._at_rest(now):
            raise ReviewError(
                "cannot leave mirror mode: the arm's pose is unknown or still changing; wait until it is at rest"
            )
        self._mirror = False
        if self._reads_only:
            return (
                "mirror mode has ended; the gateway is read-only, so nothing can be commanded: give the controller an Ethernet XML "
                "with ONLYSEND FALSE"
            )
        self._reset_wanted = True
        return "mirror mode has ended; twin and gateway start over from the arm's pose"

    @property
    def mirrors(self) -> bool:
        """True from `begin_mirror` to its end, also while the arm is not to be seen."""
        return self._mirror

    def drop(self, reason: str) -> None:
        """Stop forwarding commands until a person calls `reset`; used after a stop was sent to the gateway."""
        self._mirror = False
        self._stopped = reason
        self._pending = None
        # what was asked for before the stop is not asked for any more
        self._reset_wanted = self._asked_for = False
        self._enter(LinkState.NEEDS_RESET, reason)

    # -- decisions

    def poll(self, now: int) -> Control | None:
        """Update the state; return a control message to send now, or None."""
        obstacle = self._obstacle(now)
        if obstacle is not None:
            self._enter(*obstacle)
            self._pending, self._reset_wanted = None, False
            return None
        if self._reset_wanted:
            self._reset_wanted = False
            self._begin_session("reset asked for")
            self._asked_for = True
        gateway = self.status["state"]
        if self._mirror:
            return self._stay_mirrored(gateway, now)
        if self.state is LinkState.ARMED and not self._still_armed(gateway, now):
            self._enter(LinkState.NEEDS_RESET, f"gateway is {gateway}: {self.status.get('reason')}")
        elif self.state is LinkState.RESYNC and self._fault and not self._asked_for:
            self._enter(LinkState.NEEDS_RESET, self._stop_report())
        elif self.state not in (LinkState.ARMED, LinkState.RESYNC):
            self._leave_waiting(gateway, now)
        return self._next_control(gateway, now) if self.state is LinkState.RESYNC else None

    def _obstacle(self, now: int) -> tuple[LinkState, str] | None:
        if not self._connected:
            return LinkState.DISCONNECTED, "not connected to the broker"
        gateway = self.status.get("state", "offline")
        if gateway == "offline" or now - self._status_at > STATUS_TIMEOUT:
            return LinkState.GATEWAY_OFFLINE, "no gateway answers on the broker; start rsi_gateway on the cell PC"
        if self.status.get("decimals") != self._decimals:
            return (
                LinkState.MISMATCH,
                f"gateway uses {self.status.get('decimals')} decimals, the bridge {self._decimals}: give both the same number",
            )
        if self.status.get("hash") != self._hash:
            return (
                LinkState.MISMATCH,
                "gateway runs another configuration (its hash differs); export it again with `rosrun construction_twin "
                "export_gateway_config` and restart the gateway",
            )
        if not self.status.get("run"):
            return (
                LinkState.MISMATCH,
                "gateway names no run in its status: it is older than the bridge; install the same version on both sides",
            )
        if gateway in ("no_controller", "joined_running") or (self._reads_only and not self._mirror):
            return LinkState.NO_CONTROLLER, f"gateway has no RSI session to command: {self.status.get('reason')}"
        return None

    @property
    def _reads_only(self) -> bool:
        return self.status.get("state") == "read_only"

    def _stay_mirrored(self, gateway: str, now: int) -> Control | None:
        """Command nothing; end the session of before at the gateway, at rest and so without a fault."""
        notes = ["the arm leads, the twin follows; nothing is commanded"]
        if self._reads_only:
            notes.append("the gateway is read-only")
        elif self._fault:
            notes.append(f"the gateway was stopped and is {gateway}")
        self._enter(LinkState.MIRROR, "; ".join(notes))
        commands = gateway in ("armed", "following") and self.status.get("session") == self._ended_session
        if not commands or (self._pending is not None and now - self._sent_at < RETRY):
            return None
        return self._send("reset", now, session=self._ended_session)

    def _leave_waiting(self, gateway: str, now: int) -> None:
        """First start, return after an interruption: begin by itself only where nothing could jump."""
        if self._stopped is not None:
            self._enter(LinkState.NEEDS_RESET, self._stopped)
        elif self._fault:
            self._enter(LinkState.NEEDS_RESET, self._stop_report())
        elif not self._was_armed and gateway == "ready":
            self._begin_session("first session")
        elif self._without_fault(gateway) and self._within_tolerance(now) and self._at_rest(now):
            self._begin_session("the link is back and the poses agree within the start tolerance")
        elif self.state is not LinkState.NEEDS_RESET:
            self._enter(LinkState.NEEDS_RESET, f"gateway is {gateway}: {self.status.get('reason')}; call reset")

    @property
    def _fault(self) -> bool:
        """True when the gateway was stopped by anything but silence since its last reset, whoever was there to see it."""
        return bool(self.status.get("fault", False))

    def _stop_report(self) -> str:
        return f"gateway was stopped and is {self.status['state']}: {self.status.get('reason')}; call reset"

    def _without_fault(self, gateway: str) -> bool:
        """True when nothing but an interrupted link keeps the gateway from following; "armed" is a stream that never began."""
        stopped_by = str(self.status.get("reason", "")).split(":")[0]
        return gateway in ("ready", "armed") or (gateway == "holding" and stopped_by == "silence")

    def _still_armed(self, gateway: str, now: int) -> bool:
        # a status sent before the arming was answered still says ready
        recently = now - self._sent_at < RETRY
        return recently or (gateway in ("armed", "following") and self.status.get("session") == self.session)

    def _next_control(self, gateway: str, now: int) -> Control | None:
        if self._pending is not None and now - self._sent_at < RETRY:
            return None
        if gateway != "ready" or self._fault:
            return self._send("reset", now) if gateway != "braking" else None
        if not self._within_tolerance(now) or not (self._was_armed or self._at_rest(now)):
            # nobody has seen the arm before the first session: a program of the controller may move it
            return None
        if self._arm_refused:
            # a session that was armed and whose answer was lost has had its turn: the next attempt is another one's
            asked_for = self._asked_for
            self._begin_session(f"another session, because {self.reason}")
            self._asked_for = asked_for
            return None
        return self._send("arm", now, arm_value(self._hash, self.status["run"]))

    def _send(self, verb: str, now: int, value: object = None, session: str | None = None) -> Control:
        self._pending = Control(self._new_id(), self.session if session is None else session, verb, value)
        self._sent_at = now
        return self._pending

    def _begin_session(self, reason: str) -> None:
        self.session = self._new_id()
        self._pending, self._stopped, self._asked_for = None, None, False
        self._arm_refused = False
        self._command = None
        self._enter(LinkState.RESYNC, reason)

    def _at_rest(self, now: int) -> bool:
        return self._pose is not None and now - self._pose_at < FRESH and now - self._moved_at >= REST

    def _within_tolerance(self, now: int) -> bool:
        fresh = self._command is not None and now - self._command_at < FRESH and now - self._pose_at < FRESH
        return fresh and outside_tolerance(self._command, self._pose, self._tolerances) is None

    def _enter(self, state: LinkState, reason: str) -> None:
        self.state, self.reason = state, reason

"""Who may command, and when: the bridge's side of arming and resetting the gateway, or of arming a bare PLC.

Pure: events in, control messages out; time is an argument [ns]. Angles in rad (axis space). A session is one continuous right to
command. Its change makes the twin take over the arm's pose and executor and gate start over; only then, with a command stream
within the start tolerance of the arm, is the gateway armed (law 5). What leads from state to state is read from `poll` downwards.
"""

from __future__ import annotations

from collections.abc import Callable

from construction_twin.core.errors import ReviewError
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.config import GatewayConfig
from construction_twin.link.gateway_status import GatewayAnswer
from construction_twin.link.observations import ABSENT, ArmCheck, LinkObservations, LinkState
from construction_twin.mqtt.messages import PLC, RSI, Control, arm_value, reset_value

#: Pause before an unanswered control message is sent again [ns].
RETRY = NANOSECONDS // 2
#: How a sentence ends after which only a person leads on.
_CALL_RESET = "call reset"
_ARM_LEADS = Sentence("the arm leads, the twin follows; nothing is commanded")


class LinkSupervisor:
    """Decides when to start a session, arm, and resume.

    Args:
        waits: `waits_for` of the process before this one: then nothing is armed before a person resets.
        arm: Compares the arm with its model.

    Attributes:
        session: "" before the first.
        mirrors: True from `begin_mirror` to its end, also while the arm's pose is not known.
        responsible: Who has armed a bare PLC.
        halts, requests: How often `halt` was called, and a session asked for: what was asked for before a halt is void.
        withdraws: True until the gateway has answered that nothing of a failed request is in force.
    """

    kind, sends_control = RSI, True
    not_checked: tuple[str, ...] = ()

    def __init__(self, config: GatewayConfig, new_id: Callable[[], str], waits: str = "", arm: ArmCheck | None = None):
        self._hash = config.hash
        self._new_id = new_id
        self.inputs = LinkObservations(config, self.kind == PLC, arm)
        self.state = LinkState.DISCONNECTED
        self.reason: str = Sentence("not connected to the broker yet")
        self.session = self.responsible = ""
        self.mirrors = False
        # the session that commanded before mirror mode; it is ended at the gateway too
        self._ended_session = ""
        self._was_armed = False
        # a person asked for a session: it has not begun; it is the present one
        self._reset_wanted = self._session_requested = False
        # run and number of the gateway's last stop, as they were known when a person asked: nothing newer is cleared
        self._stop_at_request: tuple[str, int | None] = ("", None)
        self._arm_refused = False
        # why only a person leads on: `halt` was called, what a person asked for has failed, or the process before waited
        self._halt_reason: str | None = waits or None
        self._waited_before, self._under_way = bool(waits), ""
        self.halts = self.requests = 0
        # what a failed request has sent may still arrive at the gateway; the session of that request
        self.withdraws, self._withdrawn_session = False, ""
        # the control message that waits for its answer, or was refused and is sent again; the one to send next
        self._pending: Control | None = None
        self._unanswered, self._sent_at = False, 0
        self._outgoing: Control | None = None

    @property
    def sentence(self) -> Sentence:
        """State and reason, as the rest of a refusal."""
        return Sentence("{state}, {reason}", state=self.state.name, reason=self.reason)

    @property
    def waits_for(self) -> str:
        """Why a person has to act, saved for a restarted bridge; "": arming is free.

        A request counts until the link is armed: should this process end before, it has failed for the person who made it.
        """
        if not self.sends_control:
            return ""
        if self.mirrors:
            return Sentence("the arm led before this bridge was started again; call mirror or reset")
        if self._halt_reason or not self.inputs.stop_reason:
            return self._halt_reason or self._under_way
        return Sentence(
            "gateway was stopped before this bridge was started again ({reason}); call reset",
            reason=self.inputs.stop_reason,
        )

    @property
    def known_stop(self) -> tuple[str, int | None]:
        """Run and number of the gateway's last stop or fault, as far as it is known."""
        return self.inputs.status.run, self.inputs.status.fault_number

    # -- what comes in

    def on_command(self, q: tuple[float, ...], now: int) -> str:
        """Store a command to be sent [rad]; return the session that may send it, "" for none."""
        self.inputs.on_command(q, now)
        return self.session if self.state is LinkState.ARMED else ""

    def on_answer(self, answer: GatewayAnswer, now: int) -> None:
        """Act on the gateway's answer to a control message."""
        if self._pending is None or answer.id != self._pending.id:
            return
        verb, self._unanswered = self._pending.verb, False
        if not answer.ok:
            # stays pending: asked again after the usual pause, not with every poll
            self.reason = Sentence("gateway refused {verb}: {reason}", verb=verb, reason=answer.reason)
            self._arm_refused = verb == "arm"
            return
        self._pending = None
        if verb == "arm" and self.state is LinkState.RESYNC:
            self._was_armed, self._under_way = True, ""
            self.inputs.forget_stop()
            armed = Sentence("session {session}", session=self.session)
            if self.inputs.status.mode == "commissioning":
                # the link is armed, and yet the arm stands still
                armed = Sentence("session {session}; gateway is in commissioning mode", session=self.session)
            self._enter(LinkState.ARMED, armed)
        elif verb == "stop":
            self.withdraws = False

    # -- what a person asks for

    def request_reset(self, now: int) -> None:
        """Start over from the arm's pose, for a person: clear the stops known now, no later one; ReviewError where it cannot."""
        if self.mirrors:
            raise ReviewError(Sentence("cannot reset: the arm leads; call mirror with false, which ends in the same"))
        if why := self._session_obstacle(now):
            raise ReviewError(Sentence("cannot reset: {why}", why=why))
        self._want_session()

    def request_arm(self, now: int, person: str = "") -> None:
        """Refuse to arm on request (ReviewError): this link arms by itself, after `request_reset`; `BareSupervisor` does arm."""
        if self.state is not LinkState.NEEDS_RESET:
            raise ReviewError(Sentence("nothing to arm: {why}", why=self.sentence))
        raise ReviewError(Sentence("cannot arm: {why}", why=self.reason))

    def _want_session(self) -> None:
        self._reset_wanted, self._stop_at_request = True, self.known_stop
        self.requests += 1

    def _session_obstacle(self, now: int, mirrors: bool = False) -> str:
        """Return the obstacle to a session, or in mirror mode to following; "" for none."""
        if missing := self._obstacle(now, mirrors):
            return missing[1]
        if self.inputs.status.has_failed:
            return _gateway_sentence(self.inputs)
        return self.inputs.why_not_at_rest(now)

    def withdraw(self, request: int, reason: str) -> None:
        """Withdraw a person's failed request, unless there is a newer one: arming waits for the next.

        The gateway gets a stop: an `arm` that is still under way arms nothing then, and a bridge that is started again waits
        for a person too. Where mirror mode began since, it goes on, and has ended the request's session at the gateway.
        """
        if request != self.requests:
            return
        self._reset_wanted = self._session_requested = False
        # what it waits for a person for already is the better reason
        if self._halt_reason is not None:
            return
        self._halt_reason = reason if reason.endswith(_CALL_RESET) else Sentence("{reason}; call reset", reason=reason)
        if not self.mirrors:
            # a fault at the gateway outlasts this process, and its reason is the better one
            self._give_up(self._halt_reason, self._unanswered or not self.inputs.status.fault)

    def _give_up(self, reason: str, withdraws: bool) -> None:
        self.withdraws, self._withdrawn_session = withdraws, self.session
        self._halt_reason, self._pending, self._session_requested = reason, None, False
        self._enter(LinkState.NEEDS_RESET, reason)

    def begin_mirror(self, now: int) -> str:
        """Let the arm lead until `end_mirror`, for a person. Return a sentence, or raise ReviewError."""
        if not self.mirrors:
            if why := self._session_obstacle(now, mirrors=True):
                raise ReviewError(Sentence("cannot mirror: {why}", why=why))
            # a new session without a right to command: executor and gate start over; what failed before still waits for a person
            self.mirrors, self._ended_session, self.session = True, self.session, self._new_id()
            self._pending, self._reset_wanted, self._session_requested = None, False, False
            self._enter(LinkState.MIRROR, _ARM_LEADS)
        return self.reason

    def end_mirror(self, now: int) -> str:
        """Stop following the arm, for a person, and start over as after `reset`. Return a sentence, or raise ReviewError."""
        if not self.mirrors:
            raise ReviewError(Sentence("the arm does not lead: {why}", why=self.sentence))
        if why := self._session_obstacle(now, mirrors=True):
            raise ReviewError(Sentence("cannot leave mirror mode: {why}", why=why))
        self.mirrors = False
        self._want_session()
        return Sentence("mirror mode has ended")

    def halt(self, reason: str) -> None:
        """Stop forwarding commands until a person calls `reset`; used after a stop was sent to the gateway."""
        self.halts += 1
        self.mirrors = False
        self._halt_reason, self._pending = reason, None
        self._reset_wanted = self._session_requested = False
        self._enter(LinkState.NEEDS_RESET, reason)

    # -- decisions

    def poll(self, now: int) -> Control | None:
        """Update the state; return a control message to send now, or None."""
        commands = self.state is LinkState.ARMED
        self.inputs.compare_arm(now, not commands)
        if missing := self.inputs.obstacle(now, self.mirrors) if commands else self._obstacle(now, self.mirrors):
            self._pending, self._reset_wanted = None, False
            self._enter(*missing)
            return None
        self._outgoing = None
        if self._reset_wanted:
            self._reset_wanted = False
            self._begin_session(Sentence("reset asked for"))
            self._session_requested = True
            self._under_way = Sentence("the bridge was started again while a reset was under way; call reset")
        self._update_state(now)
        self._choose_message(now)
        return self._outgoing

    def _enter(self, state: LinkState, reason: str) -> None:
        self.state, self.reason = state, reason

    def _obstacle(self, now: int, mirrors: bool) -> tuple[LinkState, str] | None:
        """Return what stands against arming: what is missing, or that this is another arm."""
        another = not mirrors and self.inputs.arm.refusal
        return self.inputs.obstacle(now, mirrors) or ((LinkState.OTHER_ARM, another) if another else None)

    def _update_state(self, now: int) -> None:
        """Choose the side that commands, with broker, gateway and arm there."""
        known, status = self.inputs, self.inputs.status
        if self.mirrors:
            self._enter(LinkState.MIRROR, _ARM_LEADS)
        elif self.state is LinkState.RESYNC and self._session_requested:
            if self._stop_at_request != self.known_stop:
                self._void_request()
        elif self._halt_reason is not None and self.state not in (LinkState.ARMED, LinkState.RESYNC):
            # what the gateway still knows it says better than the process before this one
            reason = _stop_sentence(known) if self._waited_before and status.fault else self._halt_reason
            self._enter(LinkState.NEEDS_RESET, reason)
        elif status.fault:
            self._enter(LinkState.NEEDS_RESET, _stop_sentence(known))
        elif self.state is LinkState.ARMED:
            # a status sent before the arming was answered still says ready
            if now - self._sent_at >= RETRY and not known.follows(self.session):
                self._enter(LinkState.NEEDS_RESET, _gateway_sentence(known))
        elif self.state is LinkState.RESYNC:
            pass
        elif known.stopped_before:
            values = {"reason": known.stopped_before, "state": status.state}
            stopped = Sentence("gateway was stopped before it was started again ({reason}), and is {state}", **values)
            self._enter(LinkState.NEEDS_RESET, _with_remedy(known, stopped))
        elif not self._was_armed and status.state == "ready":
            self._begin_session(Sentence("first session"))
        elif known.could_go_on and known.within_tolerance(now) and known.at_rest(now):
            # nothing could jump
            self._begin_session(Sentence("the link is back and the poses agree within the start tolerance"))
        elif self.state is not LinkState.NEEDS_RESET:
            self._enter(LinkState.NEEDS_RESET, Sentence("{reason}; call reset", reason=_gateway_sentence(known)))

    def _choose_message(self, now: int) -> None:
        """Choose the next control message."""
        known = self.inputs
        if self._pending is not None and now - self._sent_at < RETRY:
            return
        if self.state in (LinkState.NEEDS_RESET, LinkState.MIRROR):
            # what a failed request has sent and arrives late arms nothing, unless another session commands by now
            if self.withdraws and not known.follows_another(self._withdrawn_session):
                self._send("stop", self._withdrawn_session, now)
            elif self.state is LinkState.MIRROR and known.follows(self._ended_session):
                self._send_reset(self._ended_session, now)
        elif self.state is LinkState.RESYNC and known.status.state != "braking":
            if known.status.state != "ready" or known.status.fault:
                self._send_reset(self.session, now)
            elif not known.within_tolerance(now) or not (self._was_armed or known.at_rest(now)):
                # before the first session it is unknown whether a program of the controller moves the arm
                return
            elif self._arm_refused:
                # a session that was armed and whose answer was lost cannot be armed again
                asked_for = self._session_requested
                self._begin_session(Sentence("another session, because {reason}", reason=self.reason))
                self._session_requested = asked_for
            else:
                self._send("arm", self.session, now, arm_value(self._hash, self.inputs.status.run))

    def _begin_session(self, reason: str) -> None:
        self.session = self._new_id()
        self._pending, self._halt_reason, self._session_requested, self._waited_before = None, None, False, False
        self._arm_refused = self.withdraws = False
        self.inputs.forget_command()
        self._enter(LinkState.RESYNC, reason)

    def _void_request(self) -> None:
        status = self.inputs.status
        if self._stop_at_request[0] != status.run:
            reason = Sentence("gateway was started again since the call; call reset")
        else:
            values = {"number": str(status.fault_number), "reason": status.reason}
            stopped = Sentence("gateway was stopped since the call (stop {number}): {reason}", **values)
            reason = _with_remedy(self.inputs, stopped)
        self._give_up(reason, self._unanswered and not status.fault)

    def _send_reset(self, session: str, now: int) -> None:
        # without a request there is no fault in the newest status, and so none that its number would clear
        run, number = self._stop_at_request if self._session_requested else self.known_stop
        assert number is not None  # without a number the link is a mismatch
        self._send("reset", session, now, reset_value(run, number))

    def _send(self, verb: str, session: str, now: int, value: object = None) -> None:
        self._pending = self._outgoing = Control(self._new_id(), session, verb, value)
        self._sent_at, self._unanswered = now, True


def _gateway_sentence(known: LinkObservations) -> Sentence:
    sentence = Sentence("gateway is {state}: {reason}", state=known.status.state, reason=known.status.reason)
    return _with_remedy(known, sentence) if known.status.has_failed else sentence


def _stop_sentence(known: LinkObservations) -> Sentence:
    values = {"number": str(known.status.fault_number), "state": known.status.state, "reason": known.status.reason}
    return _with_remedy(known, Sentence("gateway was stopped (stop {number}) and is {state}: {reason}", **values))


def _with_remedy(known: LinkObservations, reason: str) -> Sentence:
    # a gateway whose program has failed takes no control message any more
    if known.status.has_failed:
        return Sentence("{reason}; restart rsi_gateway, then call reset", reason=reason)
    return Sentence("{reason}; call reset", reason=reason)


# -- bare mode

#: What is not checked with a bare PLC, one sentence each; `docs/broker.md` says what follows from it.
NOT_CHECKED = (
    Sentence("configuration: whether the PLC has the same joint ranges, speeds and accelerations, is not compared"),
    Sentence("session: the PLC takes strings from every client that may write on `command`"),
    Sentence("sequence: strings that are lost, doubled or reordered are not noticed, in neither direction"),
    Sentence("age: a string that travelled too long counts as new, in both directions"),
    Sentence("answers: a stop is not confirmed; why the PLC stopped, and how far the arm goes on, is not known"),
    Sentence("speed limit: it is not sent to the PLC; the executor alone obeys it"),
    Sentence("controller: what stands behind the PLC (RSI, servo, brakes) is not known"),
    Sentence("comparison: the gate compares at the present moment, so the whole round trip counts as lag"),
)
#: How a person arms; with --robot where the robot is not the command's default.
ARM_COMMAND = "rosrun construction_twin twin arm --responsible NAME"
#: Longest name of a person.
_LONGEST_NAME = 64


class BareSupervisor(LinkSupervisor):
    """Arms a PLC that knows only the joint string, `ready` and `offline`: in the name of a responsible person alone."""

    kind, sends_control, not_checked = PLC, False, NOT_CHECKED

    def __init__(self, config: GatewayConfig, new_id: Callable[[], str]):
        super().__init__(config, new_id)
        # the first one that is armed must be another, so that twin and gate start over with it
        self.session = new_id()

    def poll(self, now: int) -> None:
        """Update the state; there is never anything to send."""
        super().poll(now)
        self.inputs.offline_received = False

    def _enter(self, state: LinkState, reason: str) -> None:
        super()._enter(state, reason)
        # it ends with the session
        if state not in (LinkState.RESYNC, LinkState.ARMED):
            self.responsible = ""

    def _update_state(self, now: int) -> None:
        if self.mirrors:
            super()._update_state(now)
        elif self.state in (*ABSENT, LinkState.MIRROR):
            arm = Sentence("a bare PLC is armed by a person, by name: {command}", command=ARM_COMMAND)
            self._enter(LinkState.NEEDS_RESET, arm)

    def _choose_message(self, now: int) -> None:
        # a stream in motion may pass the arm's pose; no gateway would refuse what begins at speed
        known = self.inputs
        together = known.within_tolerance(now) and known.at_rest(now) and known.stream_rests(now)
        if self.state is LinkState.RESYNC and together:
            armed = Sentence(
                "bare PLC, session {session}; {name} is responsible for what is not checked: {topics}",
                session=self.session,
                name=self.responsible,
                topics=", ".join(sentence.partition(":")[0] for sentence in self.not_checked),
            )
            self._enter(LinkState.ARMED, armed)

    def request_arm(self, now: int, person: str = "") -> None:
        """Begin a session in the name of the person who is responsible for what is not checked; ReviewError where it cannot."""
        name = person.strip()
        if not name or len(name) > _LONGEST_NAME or not name.isprintable():
            values = {"name": repr(name[:_LONGEST_NAME]), "command": ARM_COMMAND}
            raise ReviewError(Sentence("a bare PLC is armed in a person's name, {name} is none: {command}", **values))
        if self.state is not LinkState.NEEDS_RESET:
            raise ReviewError(Sentence("cannot arm: {why}", why=self.sentence))
        if unrest := self.inputs.why_not_at_rest(now):
            raise ReviewError(Sentence("cannot arm: {why}", why=unrest))
        self.responsible = name
        self.requests += 1
        self._begin_session(Sentence("{name} has taken the responsibility; twin and arm take the same pose", name=name))

    def withdraw(self, request: int, reason: str) -> None:
        """Withdraw an arming whose poses did not meet in time: later the person may be gone."""
        if request == self.requests and self.state is LinkState.RESYNC:
            self.halt(reason)

    def _want_session(self) -> None:
        """Leave arming to a person, by name."""

    def request_reset(self, now: int) -> None:
        """Raise ReviewError: a person's name is needed."""
        raise ReviewError(Sentence("cannot reset a bare PLC without a name: {command}", command=ARM_COMMAND))

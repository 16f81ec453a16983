"""Who may command, and when: the bridge's side of arming and resetting the gateway.

Pure: events in, control messages out; time is an argument [ns]. Angles in rad (axis space).

A session is one continuous right to command. Its change makes the twin take over the arm's pose and executor and gate start over;
only then, with a command stream within the start tolerance of the arm, is the gateway armed (docs/architecture.md, law 5).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from construction_twin.core.errors import ReviewError
from construction_twin.core.sentences import Sentence
from construction_twin.core.state_table import Machine, Occasion, conditions
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.config import GatewayConfig
from construction_twin.link.observations import LinkObservations
from construction_twin.link.states import ROWS, Action, Guard, LinkEvent, LinkState, Row
from construction_twin.mqtt.messages import RSI, Control, arm_value, reset_value

#: Pause before an unanswered control message is sent again [ns].
RETRY = NANOSECONDS // 2

#: How a sentence ends after which only a person leads on.
_CALL_RESET = "call reset"
_NO_ARM = (LinkState.DISCONNECTED, LinkState.GATEWAY_OFFLINE, LinkState.NO_CONTROLLER, LinkState.MISMATCH)


class LinkSupervisor:
    """Decides when to start a session, arm, and resume: finds the events, guards and actions of `states.TABLE`.

    Args:
        new_id: Returns a new unique id.
        mirrors: Whether the arm leads from the start: it did when the process before this one ended, and only a person ends that.
        waits: What `waits_for` said when the process before this one ended: then nothing is armed before a person resets.

    Attributes:
        session: "" before the first.
        inputs: What is known of gateway, arm and command stream.
        responsible: Who has armed a bare PLC; empty for a gateway, which checks by itself.
        not_checked: What is not checked with a bare PLC.
        sends_control: Whether control messages are understood.
    """

    #: What takes the commands, of `messages.GATEWAY_KINDS`.
    kind = RSI
    sends_control = True
    not_checked: tuple[str, ...] = ()
    _observations: type[LinkObservations] = LinkObservations
    _rows: Mapping[tuple[LinkState, LinkEvent], tuple[Row, ...]] = ROWS

    def __init__(self, config: GatewayConfig, new_id: Callable[[], str], mirrors: bool = False, waits: str = ""):
        self._hash = config.hash
        self._new_id = new_id
        self.inputs = self._observations(config)
        self.session = new_id() if mirrors else ""
        self.responsible = ""
        #: True from `begin_mirror` to its end, also while the arm's pose is not known.
        self.mirrors = mirrors
        # the session that commanded before mirror mode; it is ended at the gateway too
        self._ended_session = ""
        self._was_armed = False
        # a person asked for a session: it has not begun; it is the present one
        self._reset_wanted = False
        self._asked_for = False
        # run and number of the gateway's last stop, as they were known when a person asked: nothing newer is cleared
        self._shown: tuple[str, int | None] = ("", None)
        self._arm_refused = False
        # why only a person leads on: `halt` was called, or what a person asked for has failed
        self._halted: str | None = waits or None
        # the same of the process before this one; and that a person's request was under way
        self._found, self._under_way = bool(waits), ""
        #: How often `halt` was called: what was asked for before a halt is not asked for any more.
        self.halts = 0
        #: How often a person asked for a session.
        self.requests = 0
        # a request failed, and what it sent may still arrive at the gateway; the session of that request
        self._owes_stop = False
        self._withdrawn_session = ""
        # the control message that waits for its answer, or was refused and is sent again; the one to send next
        self._pending: Control | None = None
        self._unanswered = False
        self._sent_at = 0
        self._outgoing: Control | None = None
        self.machine = Machine(
            self._rows,
            LinkState.DISCONNECTED,
            Sentence("not connected to the broker yet"),
            conditions(self._guards()),
            self._actions(),
        )

    @property
    def state(self) -> LinkState:
        """The link's."""
        return self.machine.state

    @property
    def reason(self) -> str:
        """Why, in one sentence."""
        return self.machine.reason

    @property
    def sentence(self) -> Sentence:
        """State and reason, as the rest of a refusal."""
        return Sentence("{state}, {reason}", state=self.state.name, reason=self.reason)

    @property
    def status(self) -> dict:
        """The gateway's last status; empty while there is none."""
        return self.inputs.status

    @property
    def waits_for(self) -> str:
        """Why only a person leads on, in a sentence for the process after this one; "" when nothing stands against arming.

        A request counts until the link is armed: should this process end before, it has failed for the person who made it.
        """
        if not self.sends_control:
            return ""
        if self._halted or not self.inputs.stop_told:
            return self._halted or self._under_way
        return Sentence(
            "gateway was stopped before this bridge was started again ({reason}); call reset",
            reason=self.inputs.stop_told,
        )

    # -- what comes in

    @property
    def withdraws(self) -> bool:
        """True while a failed request is being withdrawn: the gateway has not answered yet that nothing of it is in force."""
        return self._owes_stop

    @property
    def known_stop(self) -> tuple[str, int | None]:
        """Run and number of the gateway's last stop or fault, as far as it is known."""
        return self.inputs.run, self.inputs.fault_number

    def on_command(self, q: tuple[float, ...], now: int) -> str:
        """Take a command that wants to be sent [rad]; return the session that may send it, "" for none."""
        self.inputs.on_command(q, now)
        return self.session if self.machine.state is LinkState.ARMED else ""

    def on_answer(self, answer: dict, now: int) -> None:
        """Take the gateway's answer to a control message."""
        if self._pending is None or answer.get("id") != self._pending.id:
            return
        verb, self._unanswered = self._pending.verb, False
        if not answer.get("ok"):
            # stays pending: asked again after the usual pause, not with every poll
            self.machine.reason = Sentence(
                "gateway refused {verb}: {reason}", verb=verb, reason=answer.get("reason", "")
            )
            self._arm_refused = verb == "arm"
            return
        self._pending = None
        if verb == "arm":
            self.take(LinkEvent.ARM_ACCEPTED, now)
        elif verb == "stop":
            self._owes_stop = False

    # -- what a person asks for

    def request_reset(self, now: int) -> None:
        """Start over from the arm's pose, for a person: clear the stops known now, no later one; ReviewError where it cannot."""
        if self.mirrors:
            raise ReviewError(Sentence("cannot reset: the arm leads; call mirror with false, which ends in the same"))
        if self.state in _NO_ARM or self.inputs.gateway_failed:
            raise ReviewError(Sentence("cannot reset: {why}", why=self.reason))
        if unrest := self.inputs.why_not_at_rest(now):
            raise ReviewError(Sentence("cannot reset: {why}", why=unrest))
        self._want_session()

    def request_arm(self, now: int, person: str = "") -> None:
        """Raise ReviewError: by itself the link arms where nothing stands against it; what does, `request_reset` alone lifts.

        A bare PLC is armed in the person's name.
        """
        if self.state is not LinkState.NEEDS_RESET:
            raise ReviewError(Sentence("nothing to arm: {why}", why=self.sentence))
        raise ReviewError(Sentence("cannot arm: {why}", why=self.reason))

    def _want_session(self) -> None:
        self._reset_wanted, self._shown = True, self.known_stop
        self.requests += 1

    def withdraw(self, request: int, reason: str) -> None:
        """Give up a person's request that was answered as failed: nothing is armed until a person asks again.

        The gateway is told to stop: an `arm` that is still under way arms nothing then, and a bridge that is started again waits
        for a person too. Where mirror mode began since, it goes on, and has ended the request's session at the gateway.

        Args:
            request: `requests` after it was asked for; nothing happens when a person has asked again since.
        """
        if request != self.requests:
            return
        self._reset_wanted = self._asked_for = False
        # what it waits for a person for already is the better reason
        if self._halted is None:
            if not reason.endswith(_CALL_RESET):
                reason = Sentence("{reason}; call reset", reason=reason)
            self.take(LinkEvent.WITHDRAWN, 0, reason)

    def begin_mirror(self, now: int) -> str:
        """Let the arm lead, for a person: nothing is commanded until `end_mirror`. Return a sentence, or raise ReviewError."""
        if self.mirrors:
            return Sentence("the arm leads already")
        if why := self._why_no_mirror(now):
            raise ReviewError(Sentence("cannot mirror: {why}", why=why))
        if self.inputs.stream_may_move(now):
            raise ReviewError(
                Sentence("cannot mirror: the command stream moves, or has just begun; stop the plan first")
            )
        self.mirrors, self._ended_session = True, self.session
        self.take(LinkEvent.MIRROR_ASKED, now)
        return self.reason

    def end_mirror(self, now: int) -> str:
        """Stop following the arm, for a person, and start over as after `reset`. Return a sentence, or raise ReviewError."""
        if not self.mirrors:
            raise ReviewError(Sentence("the arm does not lead: {why}", why=self.sentence))
        if self.inputs.gateway_failed:
            raise ReviewError(self._with_remedy(Sentence("mirror mode stays on: {reason}", reason=self.reason)))
        if why := self._why_no_mirror(now):
            raise ReviewError(Sentence("cannot leave mirror mode: {why}", why=why))
        self.mirrors = False
        return self._after_mirror()

    def _after_mirror(self) -> str:
        if self.inputs.reads_only:
            return Sentence("mirror mode has ended; the gateway is read-only: its Ethernet XML needs ONLYSEND FALSE")
        self._want_session()
        return Sentence("mirror mode has ended; twin and gateway start over from the arm's pose")

    def _why_no_mirror(self, now: int) -> str:
        # a gateway that only reads is enough
        obstacle = self.inputs.obstacle(now, mirrors=True)
        return obstacle[1] if obstacle is not None else self.inputs.why_not_at_rest(now)

    def halt(self, reason: str) -> None:
        """Stop forwarding commands until a person calls `reset`; used after a stop was sent to the gateway."""
        self.halts += 1
        self.take(LinkEvent.HALTED, 0, reason)

    # -- decisions

    def poll(self, now: int) -> Control | None:
        """Update the state; return a control message to send now, or None."""
        obstacle = self.inputs.obstacle(now, self.mirrors)
        if obstacle is not None:
            self.take(obstacle[0], now, obstacle[1])
            return None
        self._outgoing = None
        if self._reset_wanted:
            self.take(LinkEvent.RESET_ASKED, now)
        self.take(LinkEvent.PRESENT, now)
        self.take(LinkEvent.TURN, now)
        return self._outgoing

    def take(self, event: LinkEvent, now: int, reason: str = "") -> None:
        """Carry out the first row of the table whose guard holds; `reason` is the event's own sentence."""
        self.machine.on(event, Occasion(reason, now))

    # -- guards

    def _guards(self) -> dict[Guard, Callable[[Occasion], bool]]:
        return {
            Guard.ARM_LEADS: lambda at: self.mirrors,
            Guard.SESSION_ENDED: self._session_ended,
            Guard.FAULT: lambda at: self.inputs.fault,
            Guard.FAULT_UNASKED: lambda at: self.inputs.fault and not self._asked_for,
            Guard.STOPPED_SINCE: lambda at: self._asked_for and self._shown != self.known_stop,
            Guard.STOPPED_BEFORE: lambda at: bool(self.inputs.stopped_before),
            Guard.HALTED_HERE: lambda at: self._halted is not None,
            Guard.FIRST_SESSION: lambda at: not self._was_armed and self.inputs.gateway == "ready",
            Guard.NOTHING_COULD_JUMP: self._nothing_could_jump,
            Guard.ANSWER_AWAITED: lambda at: self._pending is not None and at.now - self._sent_at < RETRY,
            Guard.BRAKING: lambda at: self.inputs.gateway == "braking",
            Guard.NOT_READY: lambda at: self.inputs.gateway != "ready" or self.inputs.fault,
            Guard.POSES_DIFFER: self._poses_differ,
            Guard.ARM_REFUSED: lambda at: self._arm_refused,
            Guard.WITHDRAWAL_UNTOLD: lambda at: (
                self._owes_stop and not self.inputs.follows_another(self._withdrawn_session)
            ),
            Guard.OLD_SESSION_COMMANDS: lambda at: self.inputs.follows(self._ended_session),
            Guard.NOT_TOGETHER: self._not_together,
        }

    def _session_ended(self, at: Occasion) -> bool:
        # a status sent before the arming was answered still says ready
        recently = at.now - self._sent_at < RETRY
        return not recently and not self.inputs.follows(self.session)

    def _nothing_could_jump(self, at: Occasion) -> bool:
        # "armed" is a stream that never began
        no_fault = self.inputs.gateway in ("ready", "armed") or self.inputs.holds_after_silence
        return no_fault and self.inputs.within_tolerance(at.now) and self.inputs.at_rest(at.now)

    def _poses_differ(self, at: Occasion) -> bool:
        # before the first session it is unknown whether a program of the controller moves the arm
        return not self.inputs.within_tolerance(at.now) or not (self._was_armed or self.inputs.at_rest(at.now))

    def _not_together(self, at: Occasion) -> bool:
        # a stream in motion may pass the arm's pose; no gateway would refuse what begins at speed
        known = self.inputs
        return not (known.within_tolerance(at.now) and known.at_rest(at.now) and known.stream_rests(at.now))

    # -- actions: each returns the sentence for the state

    def _actions(self) -> dict[Action, Callable[[Row, Occasion], str]]:
        return {
            Action.NOTHING: lambda row, at: self.reason,
            Action.FORGET_REQUESTS: self._forget_requests,
            Action.NOTE_HALT: self._note_halt,
            Action.NOTE_WITHDRAWAL: self._note_withdrawal,
            Action.NOTE_WITHDRAWAL_IN_MIRROR: self._note_withdrawal_in_mirror,
            Action.BEGIN_MIRROR: self._begin_mirror,
            Action.BEGIN_ASKED_SESSION: self._begin_asked_session,
            Action.BEGIN_FIRST_SESSION: lambda row, at: self._begin_session(Sentence("first session")),
            Action.BEGIN_NEXT_SESSION: lambda row, at: self._begin_session(
                Sentence("the link is back and the poses agree within the start tolerance")
            ),
            Action.BEGIN_SESSION_AFTER_REFUSAL: self._begin_session_after_refusal,
            Action.NOTE_ARMED: self._note_armed,
            Action.TELL_MIRROR: lambda row, at: self._mirror_sentence,
            Action.TELL_GATEWAY: lambda row, at: self._gateway_sentence,
            Action.TELL_STOP: self._tell_stop,
            Action.VOID_REQUEST: self._void_request,
            Action.TELL_FORMER_STOP: lambda row, at: self._with_remedy(
                Sentence(
                    "gateway was stopped before it was started again ({reason}), and is {state}",
                    reason=self.inputs.stopped_before,
                    state=self.inputs.gateway,
                )
            ),
            Action.TELL_HALT: self._tell_halt,
            Action.TELL_RESET: lambda row, at: Sentence("{reason}; call reset", reason=self._gateway_sentence),
            Action.SEND_RESET: lambda row, at: self._send_reset(self.session, at.now),
            Action.SEND_STOP: lambda row, at: self._send("stop", self._withdrawn_session, at.now),
            Action.SEND_ARM: self._send_arm,
            Action.RESET_OLD_SESSION: lambda row, at: self._send_reset(self._ended_session, at.now),
        }

    def _forget_requests(self, row: Row, at: Occasion) -> str:
        self._pending, self._reset_wanted = None, False
        return at.reason

    def _note_halt(self, row: Row, at: Occasion) -> str:
        self.mirrors = False
        self._halted = at.reason
        self._pending = None
        # what was asked for before the halt is not asked for any more
        self._reset_wanted = self._asked_for = False
        return at.reason

    def _note_withdrawal(self, row: Row, at: Occasion) -> str:
        # a fault at the gateway outlasts this process, and the reason that it tells is the better one
        self._owes_stop = self._unanswered or not self.inputs.fault
        self._withdrawn_session = self.session
        self._halted, self._pending = at.reason, None
        return at.reason

    def _note_withdrawal_in_mirror(self, row: Row, at: Occasion) -> str:
        # the request itself, and what it had under way, were given up when mirror mode began
        self._halted = at.reason
        return self.reason

    def _void_request(self, row: Row, at: Occasion) -> str:
        self._owes_stop = self._unanswered and not self.inputs.fault
        self._withdrawn_session = self.session
        self._pending, self._asked_for = None, False
        run, _ = self._shown
        if run != self.inputs.run:
            self._halted = Sentence("gateway was started again since the call; call reset")
        else:
            number, reason = str(self.inputs.fault_number), self.inputs.gateway_reason
            self._halted = self._with_remedy(
                Sentence("gateway was stopped since the call (stop {number}): {reason}", number=number, reason=reason)
            )
        return self._halted

    def _begin_mirror(self, row: Row, at: Occasion) -> str:
        # a new session without a right to command: executor and gate start over, and what was recorded of the old one is void; it
        # neither tells the gateway of a request that failed, nor ends the waiting for a person
        self.session = self._new_id()
        self._pending, self._reset_wanted, self._asked_for = None, False, False
        return self._mirror_sentence

    @property
    def _mirror_sentence(self) -> Sentence:
        leads = Sentence("the arm leads, the twin follows; nothing is commanded")
        if self.inputs.reads_only:
            return Sentence("{leads}; the gateway is read-only", leads=leads)
        if self.inputs.fault:
            return Sentence("{leads}; the gateway was stopped and is {state}", leads=leads, state=self.inputs.gateway)
        return leads

    def _begin_session(self, reason: str) -> str:
        self.session = self._new_id()
        self._pending, self._halted, self._asked_for, self._found = None, None, False, False
        self._arm_refused = self._owes_stop = False
        self.inputs.forget_command()
        return reason

    def _begin_asked_session(self, row: Row, at: Occasion) -> str:
        self._reset_wanted = False
        self._begin_session("")
        self._asked_for = True
        self._under_way = Sentence("the bridge was started again while a reset was under way; call reset")
        return Sentence("reset asked for")

    def _begin_session_after_refusal(self, row: Row, at: Occasion) -> str:
        # a session that was armed and whose answer was lost cannot be armed again
        asked_for = self._asked_for
        self._begin_session("")
        self._asked_for = asked_for
        return Sentence("another session, because {reason}", reason=self.reason)

    def _note_armed(self, row: Row, at: Occasion) -> str:
        self._was_armed, self._under_way = True, ""
        self.inputs.forget_stop()
        # in commissioning mode the link is armed, and yet the arm stands still
        if self.status.get("mode") == "commissioning":
            return Sentence("session {session}; gateway is in commissioning mode", session=self.session)
        return Sentence("session {session}", session=self.session)

    @property
    def _gateway_sentence(self) -> Sentence:
        sentence = Sentence(
            "gateway is {state}: {reason}", state=self.inputs.gateway, reason=self.inputs.gateway_reason
        )
        return self._with_remedy(sentence) if self.inputs.gateway_failed else sentence

    def _tell_stop(self, row: Row, at: Occasion) -> str:
        known = self.inputs
        values = {"number": str(known.fault_number), "state": known.gateway, "reason": known.gateway_reason}
        return self._with_remedy(Sentence("gateway was stopped (stop {number}) and is {state}: {reason}", **values))

    def _tell_halt(self, row: Row, at: Occasion) -> str:
        # what the gateway still knows it tells better than the process before this one
        return self._tell_stop(row, at) if self._found and self.inputs.fault else self._halted or ""

    def _with_remedy(self, reason: str) -> Sentence:
        # a gateway whose program has failed takes no control message any more
        if self.inputs.gateway_failed:
            return Sentence("{reason}; restart rsi_gateway, then call reset", reason=reason)
        return Sentence("{reason}; call reset", reason=reason)

    def _send_arm(self, row: Row, at: Occasion) -> str:
        return self._send("arm", self.session, at.now, arm_value(self._hash, self.status["run"]))

    def _send_reset(self, session: str, now: int) -> str:
        # without a request there is no fault in the newest status, and so none that its number would clear
        run, number = self._shown if self._asked_for else self.known_stop
        assert number is not None  # without a number the link is a mismatch
        return self._send("reset", session, now, reset_value(run, number))

    def _send(self, verb: str, session: str, now: int, value: object = None) -> str:
        self._pending = self._outgoing = Control(self._new_id(), session, verb, value)
        self._sent_at, self._unanswered = now, True
        return self.reason

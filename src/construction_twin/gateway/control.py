"""The command side of the gateway: who may command, and what each message does, or why it is refused. ns, rad."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from construction_twin.core import speed_limit
from construction_twin.core.errors import MotionRefused, PayloadError
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.arm_control import ArmControl
from construction_twin.gateway.command_intake import StreamBroken
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.states import Event, Mode, Occasion, Row, State
from construction_twin.gateway.tool_switches import stamp_of
from construction_twin.mqtt.messages import (
    PROTOCOL,
    CommandProperties,
    Control,
    Intervention,
    is_session,
    message_number,
    protocol_mismatch,
    protocol_of,
)
from construction_twin.mqtt.requests import answer_limits

#: An arm may begin a session this many start tolerances away from the held pose: its first command may be one away from either.
DISPLACED = 2.0
#: Ended sessions and answered control messages that are remembered.
MEMORY = 1000
#: Limits that are remembered inside the grace; with more of them the oldest, which are the higher ones, count no longer.
REMEMBERED = 64
#: Verbs that act again when their message comes again: a stop always acts, and the other two count for themselves.
_AGAIN = ("stop", "speed_limit", "void")
#: Why no switch is armed, and armed ones are void.
_SPEED_0 = Sentence("the speed limit is 0")


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to a `control` message or a person's stop; `reason` in one sentence, "" when none is due."""

    ok: bool
    reason: str


class Ownership:
    """The right to command: one session at a time, none twice; control messages act once."""

    def __init__(self) -> None:
        self._past_sessions: dict[object, None] = {}
        self._answered: dict[object, None] = {}
        #: The last session that was refused because another owns the arm, and the count of such refusals.
        self.intruder = ""
        self.intrusions = 0

    def begin(self, session: str) -> None:
        """Record a session that begins to command."""
        _remember(self._past_sessions, session)

    def has_commanded(self, session: str) -> bool:
        """Return whether a session commands or has commanded."""
        return session in self._past_sessions

    def record_intruder(self, session: str) -> None:
        """Count a second session that asked to command."""
        self.intruder = session
        self.intrusions += 1

    def is_repeated(self, control: Control) -> bool:
        """Return whether a control message is a repetition (QoS 1, replayed recordings)."""
        key = (control.session, control.id, control.verb)
        if key in self._answered:
            return True
        _remember(self._answered, key)
        return False


def _remember(known: dict[object, None], thing: object) -> None:
    known.setdefault(thing)
    if len(known) > MEMORY:
        del known[next(iter(known))]


class EnforcedSpeedLimit:
    """The fraction of the velocity limits at which the arm may move, once one was given.

    Silence for longer than the deadline counts as the fraction for silence, or as the last limit where that was lower. A lowered
    limit is enforced a grace after it came, a raised one at once. Messages of a session are numbered: a recording raises nothing.
    """

    def __init__(self, config: GatewayConfig):
        self._limit = speed_limit.SpeedLimit(config.speed_limit_deadline, config.speed_limit_silent)
        self._grace = round(config.speed_limit_grace * NANOSECONDS)
        #: The fraction requested last, that for silence included.
        self.requested = 1.0
        #: "none", a session id, or "silence".
        self.source = "none"
        #: The fraction in force.
        self.fraction = 1.0
        # session and number of the last message
        self._numbered: tuple[str, int] = ("", -1)
        # since when [ns] which fraction was given; they fall from left to right, so the first is the highest
        self._recent: deque[tuple[int, float]] = deque(maxlen=REMEMBERED)

    @staticmethod
    def refusal(control: Control, session: str) -> str:
        """Return why a `speed_limit` message is ignored while `session` is armed; "" when it counts."""
        fraction = control.value
        # bool is a number to Python; a number as large as JSON allows is none that a float holds
        if isinstance(fraction, bool) or not isinstance(fraction, (int, float)) or not 0 <= fraction <= 1:
            return f"speed limit {str(fraction)[:32]!r}: expected a number from 0 to 1"
        if not session or control.session != session:
            return f"session {control.session!r} is not armed" + f", {session!r} is" * bool(session)
        if message_number(control.id) is None:
            return (
                f"speed limit with the id {control.id!r}: expected a whole number, higher than that of the one before"
            )
        return ""

    def is_repeated(self, control: Control) -> bool:
        """Return whether this message (without a `refusal`) or a later one of its session came before."""
        number = message_number(control.id)
        session, last = self._numbered
        if number is None or (control.session == session and number <= last):
            return True
        self._numbered = control.session, number
        return False

    def on_limit(self, fraction: float, session: str, now: int) -> bool:
        """Store a limit, 0 to 1, of a session; return whether limit or session changed."""
        self._limit.record(fraction, session, now)
        changed = (fraction, session) != (self.requested, self.source)
        self.source = session
        self._store(fraction, now)
        return changed

    def poll(self, now: int) -> bool:
        """Update the limit in force; return whether its source has just fallen silent."""
        recent = self._recent
        if not recent:
            return False
        silent = self.source != "silence" and self._limit.is_silent(now)
        if silent:
            self.source = "silence"
            self._store(self._limit.fraction_when_silent, now)
        while len(recent) > 1 and now - recent[1][0] >= self._grace:
            recent.popleft()
        self.fraction = recent[0][1]
        return silent

    def _store(self, fraction: float, now: int) -> None:
        self.requested = fraction
        recent = self._recent
        if not recent:
            # before the first one there was none
            recent.append((now, 1.0))
        if fraction == recent[-1][1]:
            return
        since = now
        while recent and recent[-1][1] <= fraction:
            # what was lower is no higher than this: the grace began there
            since, _ = recent.pop()
        recent.append((since, fraction))

    def status_fields(self) -> dict:
        """Return the fields of the status."""
        return {"share": self.fraction, "given": self.requested, "source": self.source}


class CommandHandler:
    """Handles commands, control messages and people's stops of one `Gateway`."""

    def __init__(self, gateway: ArmControl):
        self._gateway = gateway
        self.owners = Ownership()
        self.speed = EnforcedSpeedLimit(gateway.config)
        self._stop_pace = answer_limits()
        self._verbs = {
            "arm": self._arm,
            "stop": self._stop,
            "reset": self._reset,
            "end": self._end,
            "switch": self._switch,
            "void": self._void,
            "speed_limit": self._limit_speed,
        }

    # -- commands

    def on_command(self, payload: bytes, properties: CommandProperties | PayloadError | None, now: int) -> None:
        """Read and play a joint string of `command`; `properties` are None without any, the error when they cannot be read."""
        gateway, machine = self._gateway, self._gateway.machine
        state = machine.state
        try:
            if state is not State.FOLLOWING and state is not State.ARMED:
                raise PayloadError("not_armed", f"gateway is {state.value}")
            stamp, q, lost = self._gateway.intake.stream.read(payload, properties, now)
        except PayloadError as error:
            gateway.refusals.count_message(error.reason, error, follows=error.reason == "not_armed")
            if error.reason in ("session", "not_armed"):
                self._on_other_session(properties.session if isinstance(properties, CommandProperties) else None, now)
            return
        try:
            if state is State.ARMED:
                why = Sentence("stream of session {session} began", session=gateway.command_session)
                machine.on(Event.STREAM_BEGAN, Occasion(why, now, stamp=stamp, q=q))
            else:
                if lost:
                    gateway.counters["commands_lost"] += lost
                self._gateway.intake.on_command(stamp, q, now - gateway.controller.received_at)
            gateway.counters["commands_received"] += 1
        except MotionRefused as refusal:
            gateway.refusals.count_message(refusal.reason, refusal)
            if machine.state is State.FOLLOWING:
                gateway.refusals.on_stop()
            gateway.brake(Event.COMMAND_REFUSED, str(refusal))
        except StreamBroken as broken:
            gateway.brake(broken.event, broken.args[0])

    def _on_other_session(self, session: str | None, now: int) -> None:
        gateway = self._gateway
        if session is not None and gateway.command_session and not self.owners.has_commanded(session):
            self.owners.record_intruder(session)
        else:
            gateway.player.learn_from_stall(session, now)

    def on_stream_began(self, row: Row, occasion: Occasion) -> None:
        """Check and play the first command of a stream."""
        gateway, now = self._gateway, occasion.now
        assert gateway.player.follower is not None  # an armed gateway has one
        held = gateway.player.follower.position
        self._gateway.intake.begin_stream(held, occasion.stamp, occasion.q, now - gateway.controller.received_at, now)

    # -- control

    def on_control(self, control: Control, now: int) -> Answer:
        """Carry out a `control` message that came at `now` [ns]."""
        carry_out = self._verbs.get(control.verb)
        if carry_out is None:
            return self._refuse("verb", f"unknown verb {control.verb!r}")
        if control.verb not in _AGAIN and self.owners.is_repeated(control):
            return self._refuse(
                "repeated", f"message {control.id!r} of session {control.session!r} was answered before"
            )
        return carry_out(control, now)

    def _refuse(self, reason: str, why: str) -> Answer:
        self._gateway.refusals.count_message(reason, why)
        return Answer(False, why)

    def _answer(self, control: Control, refusal: str, done: str) -> Answer:
        return self._refuse(control.verb, refusal) if refusal else Answer(True, done)

    def _limit_speed(self, control: Control, now: int) -> Answer:
        gateway, speed = self._gateway, self.speed
        if refusal := speed.refusal(control, gateway.command_session):
            # one that only lacks an armed session may have been under way when a stop came
            follows = not gateway.command_session and not speed.refusal(control, control.session)
            gateway.refusals.count_message("speed_limit", refusal, follows)
            return Answer(False, refusal)
        fraction = float(control.value)  # type: ignore[arg-type]  # `refusal` has found a number
        # a lower limit counts even with an old number: its source may count anew, and a recording of it can only slow the arm
        if speed.is_repeated(control) and fraction >= speed.requested:
            what = f"speed limit {control.id} of session {control.session!r}"
            self._refuse("repeated", f"{what}, or a later one, came before")
            return Answer(False, "")
        if speed.on_limit(fraction, control.session, now):
            gateway.machine.changed = True
        self.poll(now)
        return Answer(True, Sentence("speed at most {fraction:g} of the limits", fraction=fraction))

    def poll(self, now: int) -> None:
        """Update the speed limit in force, and report the silence of its source."""
        gateway, speed = self._gateway, self.speed
        if speed.poll(now):
            gateway.counters["speed_limit_silent"] += 1
            gateway.machine.changed = True
        if speed.fraction != gateway.player.fraction:
            gateway.player.limit(speed.fraction)
        if gateway.tool is not None and not speed.requested:
            # at once: the grace is for motion that has begun
            gateway.tool.void(_SPEED_0)

    def _arm(self, control: Control, now: int) -> Answer:
        gateway, session = self._gateway, control.session
        refusal = _refusal_of_value(control.value, gateway.config.hash, gateway.run)
        if gateway.state in (State.ARMED, State.FOLLOWING) and not refusal:
            refusal = gateway.machine.on(Event.ARM, Occasion(session=session))
            if refusal:
                self.owners.record_intruder(session)
            return self._answer(control, refusal, Sentence("already armed for this session"))
        why = gateway.with_mode(Sentence("armed for session {session}", session=session))
        refusal = refusal or self._refusal_of_session(session)
        refusal = refusal or gateway.machine.on(Event.ARM, Occasion(why, session=session))
        return self._answer(control, refusal, gateway.with_mode(Sentence("armed")))

    def _refusal_of_session(self, session: str) -> str:
        if not is_session(session):
            return f"session {session!r} cannot be armed; expected 1 to 64 letters, digits, - and _"
        if self._gateway.fault and self._gateway.state is not State.FAILED:
            return Sentence("stopped since the last reset; reset first")
        return ""

    def refusal_of_arm(self, occasion: Occasion) -> str:
        """Return the obstacle to arming a session; "" for none."""
        gateway = self._gateway
        if refusal := self._refusal_of_session(occasion.session):
            return refusal
        if gateway.player.follower is None:
            return gateway.sentence
        if gateway.clock.changed:
            return gateway.clock.changed
        measured, follower = gateway.controller.measured, gateway.player.follower
        distance = measured and follower and gateway.controller.distance_off(measured, follower.position, DISPLACED)
        if distance:
            return Sentence(
                "{distance} off the held pose: the arm was moved, or still moves; reset, or start the controller's program again",
                distance=distance,
            )
        if self.owners.has_commanded(occasion.session):
            return Sentence("session {session} has had its turn; begin another", session=occasion.session)
        return ""

    def refusal_of_second_session(self, occasion: Occasion) -> str:
        """Return the refusal while another session is armed; "" for none."""
        session = self._gateway.command_session
        refusal = Sentence("armed for session {session}; stop and reset first", session=session)
        return "" if occasion.session == session else refusal

    def on_armed(self, row: Row, occasion: Occasion) -> None:
        """Let a session command."""
        self.owners.begin(occasion.session)
        self._gateway.intake.stream.begin(occasion.session)
        self._gateway.refusals.clear_cause()

    def _switch(self, control: Control, now: int) -> Answer:
        gateway = self._gateway
        if gateway.tool is None:
            return self._refuse(control.verb, Sentence("tool: the configuration has none: no switch is possible"))
        stamp, waited = stamp_of(control.value), now - gateway.controller.received_at
        lead = None if stamp is None else (gateway.player.playout.lead_time(stamp) - waited) / NANOSECONDS
        refusal = gateway.tool.arm(control.value, lead, self._obstacle_of_switch(control.session))
        return self._answer(control, refusal, Sentence("armed"))

    def _obstacle_of_switch(self, session: str) -> str:
        """Return the obstacle to a switch now; "" for none."""
        gateway = self._gateway
        if gateway.state is not State.FOLLOWING:
            return Sentence("no stream is followed, {present}", present=gateway.sentence)
        if session != gateway.command_session:
            return f"session {session} does not command, session {gateway.command_session} does"
        if gateway.mode is Mode.COMMISSIONING:
            return Sentence("commissioning mode: nothing is switched, as nothing moves")
        return "" if self.speed.requested else _SPEED_0

    def _void(self, control: Control, now: int) -> Answer:
        tool = self._gateway.tool
        count = tool.void(_asked(control)) if tool else 0
        return Answer(True, f"{count} armed {'switch is' if count == 1 else 'switches are'} void")

    def _end(self, control: Control, now: int) -> Answer:
        gateway, terms = self._gateway, self._gateway.config.make.terms
        if not gateway.config.layout.stop:
            return self._refuse(control.verb, terms.no_stop)
        if gateway.player.follower is None or gateway.state is State.FAILED:
            return self._refuse(control.verb, gateway.sentence)
        gateway.end(Sentence("end {asked}", asked=_asked(control)))
        return Answer(True, terms.ends)

    def _reset(self, control: Control, now: int) -> Answer:
        gateway, done = self._gateway, Sentence("reset")
        occasion = Occasion(gateway.with_mode(done), session=control.session, value=control.value)
        return self._answer(control, gateway.machine.on(Event.RESET, occasion), done)

    def refusal_of_reset(self, occasion: Occasion) -> str:
        """Return the obstacle to a reset; "" for none."""
        gateway, value = self._gateway, occasion.value
        follower = gateway.player.follower
        if follower is None:
            return gateway.sentence
        if refusal := protocol_mismatch(PROTOCOL, protocol_of(value)):
            return refusal
        if not isinstance(value, dict) or set(value) != {"run", "fault_number", "protocol"}:
            return "reset must name run, fault_number and protocol of the gateway's status, and nothing else"
        number = value["fault_number"]
        if refusal := _refusal_of_run(value["run"], gateway.run):
            return refusal
        if type(number) is not int or number != gateway.fault_number:
            return Sentence(
                "reset names fault_number {found}, the last stop is number {number}: look at it, and reset again",
                found=repr(number),
                number=gateway.fault_number,
            )
        return "" if follower.at_rest else Sentence("the arm is still moving; stop it first")

    def refusal_of_owner_reset(self, occasion: Occasion) -> str:
        """Return the refusal of a reset by another session than the one that commands; "" for none."""
        session = self._gateway.command_session
        if occasion.session != session:
            # also the owner's own next session asks too early sometimes: no intruder yet
            return Sentence("session {session} commands; stop it, or wait until its stream has ended", session=session)
        return self.refusal_of_reset(occasion)

    # -- stops

    def _stop(self, control: Control, now: int) -> Answer:
        self._gateway.stop(_asked(control))
        return Answer(True, Sentence("gateway is {state}", state=self._gateway.state.value))

    def on_stop(self, stop: Intervention, now: int) -> Answer:
        """Carry out a person's stop that came at `now` [ns], in any state and session.

        One that can change nothing, because the arm is stopped and the account was just answered several times, is only counted.
        """
        gateway = self._gateway
        # what cannot tell how often an account was answered must not refuse its stop
        answered = gateway.side_effects.run("the pace of answers", self._stop_pace.admit, stop.account, now)
        if answered is False and gateway.stopped:
            gateway.counters["stops_repeated"] += 1
            # it changes nothing now, and yet a reset that is under way does not know of it
            gateway.fault_number += 1
            return Answer(True, "")
        gateway.stop(Sentence("asked for by account {account}", account=stop.account), stop.account)
        return Answer(True, Sentence("gateway is {state}", state=gateway.state.value))

    def refuse_stop(self, account: str, error: PayloadError, now: int) -> Answer:
        """Count an unreadable message on `stop/<account>`; the answer's reason is limited in rate."""
        self._gateway.refusals.count_message(error.reason, error)
        return Answer(False, str(error) if self._stop_pace.admit(account, now) else "")


def _asked(control: Control) -> Sentence:
    return Sentence("asked for by {who}", who=control.session or Sentence("somebody without a session"))


def _refusal_of_value(value: object, present: str, run: str) -> str:
    """Return how the value of an `arm` differs from the present configuration's hash and run; "" for none."""
    if refusal := protocol_mismatch(PROTOCOL, protocol_of(value)):
        return refusal
    named = value if isinstance(value, dict) else {"hash": value}
    if named.get("hash") != present:
        found = repr(named.get("hash"))
        return Sentence("configuration hash {found} is not the gateway's {present}", found=found, present=present)
    if set(named) != {"hash", "run", "protocol"}:
        return "arm must name hash, run and protocol of the gateway's status, and nothing else"
    return _refusal_of_run(named["run"], run)


def _refusal_of_run(run: object, present: str) -> str:
    if run == present:
        return ""
    return Sentence(
        "run {run} is not the gateway's present one: it was started again, or this is a recording", run=repr(run)
    )

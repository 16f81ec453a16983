"""The gateway as a pure object: commands, controls and telegrams in; corrections, states and status out.

It knows no socket and no clock: `now` is an argument, in ns on the gateway's monotonic clock. Every telegram is answered from what
is already here (docs/architecture.md, law 1). What may follow what is the table in `states`; here is what its guards ask and its
actions do. Standard library only; rad and ns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

from construction_twin.controller.port import ControllerStatus
from construction_twin.controller.telegram import Telegram
from construction_twin.core.errors import MotionRefused, PayloadError
from construction_twin.core.follower import Follower
from construction_twin.core.records import document
from construction_twin.core.sentences import Sentence, both
from construction_twin.core.side_effects import SideEffects
from construction_twin.core.state_table import Machine
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.command_intake import CommandIntake, StreamBroken
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.controller_clock import ControllerClock
from construction_twin.gateway.controller_session import ControllerSession
from construction_twin.gateway.ownership import Ownership
from construction_twin.gateway.part_steps import PartSteps
from construction_twin.gateway.player import Player
from construction_twin.gateway.refusals import Refusals
from construction_twin.gateway.replies import Replies, moved
from construction_twin.gateway.speed_limit import EnforcedSpeedLimit
from construction_twin.gateway.states import CAUSES, ROWS, Action, Event, Guard, Mode, Occasion, Row, State
from construction_twin.gateway.status import StateReport, Status
from construction_twin.gateway.stop_report import StopReport
from construction_twin.gateway.tool_switches import ToolSwitches, stamp_of
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import (
    PROTOCOL,
    CommandProperties,
    Control,
    Intervention,
    StateProperties,
    is_session,
    other_protocol,
    protocol_of,
)
from construction_twin.mqtt.requests import answer_limits

#: States in which nothing is commanded, and the held pose follows what a program of the controller does.
HELD = (State.MEASURING, State.OTHER_CYCLE, State.READY, State.ARMED)
#: An arm may begin a session this many start tolerances away from the held pose: its first command may be one away from either.
DISPLACED = 2.0
#: Why no switch is armed, and armed ones are void.
_SPEED_0 = Sentence("the speed limit is 0")


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer to a `control` message, or to a person's stop; goes into `control/ack` or `stop/ack`.

    Attributes:
        ok: It was carried out.
        reason: Why, in one sentence; "" when there is nothing to answer: it was answered before.
    """

    ok: bool
    reason: str


def _not_reset(reason: str) -> str:
    return Sentence("stopped before, and not reset ({reason})", reason=reason) if reason else ""


def _asked(control: Control) -> Sentence:
    return Sentence("asked for by {who}", who=control.session or Sentence("somebody without a session"))


class Gateway:
    """One robot's gateway between the command stream and the controller session.

    Args:
        run: An id that no other run of the gateway has had; an `arm` must name it.
        commissioning: True: everything runs and is reported as usual, but every correction that leaves is zero.
        measures: Whether a session can be commanded only after its controller's cycle was measured, from what `clock` is told of
            arrivals. False: telegrams come on a simulated clock.
    """

    def __init__(self, config: GatewayConfig, run: str, commissioning: bool = False, measures: bool = False):
        self.config = config
        self.run = run
        self.mode = Mode.of(config, commissioning)
        self._words = config.make.words
        self._absolute = config.make.absolute
        self._replies = Replies(self._absolute, self.mode is not Mode.NORMAL)
        self.codec = JointStringCodec.of_config(config)
        self.counters: Counter[str] = Counter()
        #: What was refused, and why; inbox and service, which stand before the gateway, count here too.
        self.refusals = Refusals(self.counters)
        #: True after any stop but one by silence, until a `reset`; outlives the controller session.
        self.fault = False
        #: Number of the last stop or fault of this run, but of one by silence; 0 before the first. A `reset` must name it.
        self.fault_number = 0
        #: Why it was stopped, "" once somebody has reset that; the end of the program is no stop.
        self.stopped = ""
        #: What tells of a stop, and cannot fail it.
        self.side_effects = SideEffects()
        #: Called with every answered telegram: its stamp, number of the session, state, stamp of the target [ns] (0: none),
        #: position [rad], which is origin plus correction, whether the reply before this one did not arrive. None costs nothing.
        self.trace: Callable[[int, int, State, int, tuple[float, ...], bool], None] | None = None
        #: Is told of every telegram that is read, by what reads them.
        self.clock = ControllerClock(config.make, config.cycle)
        self._measures = measures
        self._began = ""
        self._controller = ControllerSession(config, self.counters)
        self._owners = Ownership()
        self._stop_pace = answer_limits()
        self._player = Player(config, self.counters)
        self._intake = CommandIntake(config, self.codec, self._player)
        #: How fast the arm may move, as the source of `speed_limit` asks.
        self.speed = EnforcedSpeedLimit(config)
        self._stopping = StopReport(config.limits.linear)
        #: The tool's outputs; None without a tool.
        self.tool = ToolSwitches(config.tool, config.layout, config.cycle_ns, self.counters) if config.tool else None
        self._states = StateReport(self.codec, self.counters, config.properties)
        self._silence = round(config.silence * NANOSECONDS)
        self._cycle = config.cycle_ns
        self._parts = PartSteps(config.cycle_ns)
        self._command_stamp = 0
        self._ending = False
        #: What the controller says of itself, where its telegrams tell.
        self._status: ControllerStatus = config.make.no_status
        self._machine = Machine(
            ROWS,
            State.NO_CONTROLLER,
            Sentence("no telegram yet"),
            {
                Guard.ANSWERS: lambda occasion: "read-only" if self.mode is Mode.READ_ONLY else "",
                Guard.READS_ONLY: lambda occasion: "" if self.mode is Mode.READ_ONLY else "answered",
                Guard.HAS_ORIGIN: self._refusal_without_origin,
                Guard.MAY_ARM: self._refusal_of_arm,
                Guard.SAME_SESSION: self._refusal_of_second_session,
                Guard.MAY_RESET: self._refusal_of_reset,
                Guard.OWNER_MAY_RESET: self._refusal_of_owner_reset,
            },
            {
                Action.BEGIN_SESSION: self._on_session_began,
                Action.END_SESSION: self._on_session_ended,
                Action.OWN: self._on_armed,
                Action.START_STREAM: self._on_stream_began,
                Action.BRAKE: self._on_brake,
                Action.BRAKE_TO_FAULT: self._on_brake_to_fault,
                Action.FAULT: self._on_fault,
                Action.RESET: self._on_reset,
                Action.LAST_RESORT: self._on_fault,
            },
            refusal=lambda: self._sentence,
        )

    @property
    def state(self) -> State:
        """What the gateway is doing."""
        return self._machine.state

    @property
    def reason(self) -> str:
        """Why, in one sentence."""
        return self._machine.reason

    @property
    def _sentence(self) -> Sentence:
        return Sentence("gateway is {state}: {reason}", state=self.state.value, reason=self.reason)

    def noted(self, sentence: str) -> str:
        """Return a sentence with what the mode means for the arm, so that one at rest is not taken for a fault."""
        if self.mode is Mode.NORMAL:
            return sentence
        if self.mode is Mode.COMMISSIONING:
            return Sentence(
                "{what}; commissioning: every correction is sent as zero, the arm does not move", what=sentence
            )
        why = self._words.read_only
        return Sentence("{what}; {why}, so nothing is answered and no motion can be commanded", what=sentence, why=why)

    @property
    def session(self) -> str:
        """Id of the session that may command; "" for none."""
        return "" if self._machine.state is State.FAILED else self._intake.stream.session

    # -- the controller's side

    def accepts(self, source: object, now: int) -> bool:
        """Return whether a datagram from `source` may be read: no other sender may disturb a controller that is alive."""
        return self._controller.accepts(source, now)

    def on_telegram(self, telegram: Telegram, source: object, now: int) -> tuple[float, ...] | None:
        """Take a telegram and return what its answer carries; another source is another session.

        Returns:
            Shape (n,). Position, or position minus origin, as the make takes it [rad]; None when it must not be answered.
        """
        controller, machine, player, replies = self._controller, self._machine, self._player, self._replies
        moving = machine.state is State.FOLLOWING or machine.state is State.BRAKING
        taken = controller.take(telegram, source, now, replies.sent, moving)
        if taken is None:
            self.counters["telegrams_repeated"] += 1
            return None
        if taken.begins:
            self._begin_session(telegram)
        if taken.refusal:
            machine.on(Event.ORIGIN_REFUSED, Occasion(taken.refusal))
        state, elapsed = machine.state, taken.elapsed
        if self.tool is not None:
            why = ""
            if state is State.JOINED:
                why = Sentence("this session is not answered: {reason}", reason=machine.reason)
            self.tool.hear(why, taken.missed)
        if state is State.JOINED or state is State.READ_ONLY or state is State.FAILED:
            self.counters["telegrams_unanswered"] += 1
            return None
        if not controller.origin:
            # the only target that is known is the correction of none
            self.counters["telegrams_unanswered" if self._absolute else "telegrams"] += 1
            return None if self._absolute else (0.0,) * len(self.config.axes)
        follower = player.follower or player.place(controller.origin)
        if taken.drifted_to:
            follower = self._note_drift(follower, taken.drifted_to)
        lost = taken.lost
        replies.note(lost, elapsed)
        if lost or elapsed > self._cycle:
            # HOLDON kept the arm where it was: going on at the speed of before would be a step from standstill
            follower, elapsed = self._stand(follower, elapsed, lost)
        # where nothing has arrived for so long, nothing is played: the gate is to compare with the present
        self._command_stamp = player.stamp if replies.lost_for <= self._silence else 0
        self.counters["telegrams"] += 1
        if elapsed < self._cycle or self._parts.interpolated:
            position = self._move_in_parts(follower, elapsed)
        else:
            position = self._move(follower, elapsed)
        if self.tool is not None and machine.state is State.FOLLOWING and player.braking is None:
            self.tool.play(player.stamp)
        if self.trace is not None:
            self.trace(
                telegram.controller_ms, self.counters["rsi_sessions"], machine.state, player.stamp, position, lost
            )
        return replies.answer(position, controller.origin)

    def note_status(self, status: ControllerStatus, unreadable: int) -> None:
        """Take what a telegram says on its optional channels, and how many of these cannot be read; it changes no answer."""
        self._status = status
        if unreadable:
            self.counters["status_channels_unreadable"] += unreadable

    @property
    def kept(self) -> tuple[float, ...]:
        """The target that the controller has until the last answer arrives, as it was sent [rad], [m]; () before the first."""
        return self._replies.carried(self._replies.kept, self._controller.origin)

    @property
    def correction(self) -> tuple[float, ...]:
        """The last correction, as it would be without commissioning mode [rad], [m]; () before the first."""
        return self._replies.correction

    def observe(self, telegram: Telegram, target: tuple[float, ...], lost: bool) -> None:
        """Take note of a telegram that the last resort answered with `target` [rad]: the arm's pose is still reported.

        `lost` says whether the reply before it did not arrive.
        """
        self._controller.take_measured(telegram)
        self._command_stamp = 0
        if self.trace is not None:
            position = target if self._absolute else moved(self._controller.origin, target)
            self.trace(telegram.controller_ms, self.counters["rsi_sessions"], self.state, 0, position, lost)

    def poll(self, now: int) -> None:
        """Notice silence, of the controller or of a speed limit's source, and what its clock shows; call it at least every 0.1 s.

        While a controller sends, call it in the pause behind an answer.
        """
        self._poll_speed_limit(now)
        if self._measures and self.clock.measure_rate():
            self._machine.changed = True
        if self._controller.is_silent(now):
            said, why = self._status.sentence, Sentence("no telegram for {seconds:g} s", seconds=self.config.timeout)
            why = Sentence("{silence}; the last one said: {said}", silence=why, said=said) if said else why
            self._machine.on(Event.CONTROLLER_SILENT, Occasion(why))
        state = self._machine.state
        if state is State.MEASURING or state is State.OTHER_CYCLE:
            self._judge_clock()
        elif state is State.READY and self._measures:
            self._judge_cycle()
        elif state is State.ARMED or state is State.FOLLOWING:
            if self.clock.changed and self._measures:
                self._brake(Event.CYCLE_REFUSED, self.clock.changed)
        elif state is State.NO_CONTROLLER and self.refusals.unread:
            self._report_unread(now)
        elif state is State.READ_ONLY and self._measures:
            self._report_clock()

    def _report_unread(self, now: int) -> None:
        sentence, is_new = self.refusals.unread_news(now)
        if sentence:
            self._machine.add(sentence)
            self._machine.changed = self._machine.changed or is_new

    def _report_clock(self) -> None:
        """Say of a controller that takes no corrections whether its clock is another one: the next program may take some."""
        wrong = self.clock.judge()
        if wrong is None or not self.clock.is_new(wrong):
            return
        if wrong:
            self._machine.add(wrong)
            self._machine.changed = True
        else:
            self._machine.drop()

    def _judge_clock(self) -> None:
        wrong = self.clock.judge()
        if wrong is None:
            return
        if self.clock.is_new(wrong) or not wrong:
            event = Event.CYCLE_REFUSED if wrong else Event.CYCLE_FITS
            self._machine.on(event, Occasion(wrong or self._began))

    def _judge_cycle(self) -> None:
        """Notice that a program began RSI anew in the other mode, where nothing else shows that it did."""
        wrong = self.clock.judge(rates=False)
        wrong = self._changed_cycle if wrong is None else wrong
        if wrong:
            self.clock.is_new(wrong)
            self._machine.on(Event.CYCLE_REFUSED, Occasion(wrong))

    @property
    def _changed_cycle(self) -> str:
        return self.clock.changed if self._measures else ""

    def state_message(self, stamp: int) -> tuple[bytes, StateProperties] | None:
        """Return the joint string of the measured pose and its properties, None without one; `stamp` is the gateway's own [ns]."""
        return self._states.message(self._controller.measured, self._command_stamp, stamp)

    def _begin_session(self, telegram: Telegram) -> None:
        words = self._words
        began = Sentence(
            "{protocol} session began at {stamp} {value}: {why}",
            protocol=words.protocol,
            stamp=words.stamp,
            value=telegram.controller_ms,
            why=self._controller.began,
        )
        # what stands against arming is said, too: the states of a new session do not tell
        self._began = both(self.noted(began), _not_reset(self.stopped))
        self._machine.on(Event.SESSION_BEGAN, Occasion(self._began))
        if self._machine.state is State.MEASURING:
            if self._measures:
                self._machine.add(Sentence("measuring the controller's cycle"))
            else:
                self._machine.on(Event.CYCLE_FITS, Occasion(self._began))

    def _on_session_began(self, row: Row, occasion: Occasion) -> None:
        self._player.remove()
        if self.tool is not None:
            self.tool.begin_session()
        self._disarm(occasion.reason)
        self._ending = False
        self._replies.begin()
        self.clock.restart()
        self._parts.restart()
        self.refusals.begin_session()

    def _on_session_ended(self, row: Row, occasion: Occasion) -> None:
        self._controller.end()
        self.clock.restart()
        self._status = self.config.make.no_status
        self._player.remove()
        if self.tool is not None:
            self.tool.end_session(occasion.reason)
        self._disarm(occasion.reason)

    def _note_drift(self, follower: Follower, setpoint: tuple[float, ...]) -> Follower:
        state = self._machine.state
        if state in HELD:
            # a program of the controller moves the arm: no session commands it now, so the held pose follows the measured one
            return self._player.place(self._controller.move_origin(setpoint, follower.position))
        if state is State.FOLLOWING:
            drift = self._controller.drift(setpoint)
            if drift:
                self._brake(Event.DRIFTED, drift)
        return follower

    # -- motion

    def _stand(self, follower: Follower, elapsed: int, lost: bool) -> tuple[Follower, int]:
        """Stand at the last correction that arrived; return the follower there, and what of `elapsed` [ns] is left to move in."""
        if self._parts.interpolated:
            # it stands within a step, not at its end
            self._parts.restart()
            follower = self._player.place(moved(self._controller.origin, self._replies.kept))
        elif lost:
            follower.take_back()
        else:
            follower.rest()
        pause = max(0, elapsed - self._cycle)
        if self._machine.state is State.FOLLOWING:
            self._player.stand(pause, lost)
            self.counters["standstills"] += 1
        return follower, elapsed - pause

    def _move_in_parts(self, follower: Follower, elapsed: int) -> tuple[float, ...]:
        """Answer a telegram that comes before a cycle is over: until the change of the cycle is noticed, and while it brakes."""
        if self._machine.state not in (State.FOLLOWING, State.BRAKING):
            self._parts.restart()
            return follower.position
        return self._parts.position(elapsed, follower.position, lambda: self._move(follower, self._cycle))

    def _move(self, follower: Follower, elapsed: int) -> tuple[float, ...]:
        machine = self._machine
        if machine.state is State.FOLLOWING:
            # in commissioning mode the arm does not do what the player does
            position = self._player.play(
                follower, elapsed, self._controller.measured if self.mode is Mode.NORMAL else ()
            )
            overdue = self._player.overdue
            if overdue > self._silence:
                self._player.give_up(self.session, self._controller.heard_at)
                why = Sentence("no command for {seconds:.3f} s beyond the newest one", seconds=overdue / NANOSECONDS)
                self._brake(Event.STREAM_SILENT, why)
            return position
        if machine.state is State.BRAKING:
            position = follower.brake()
            self.side_effects.run("the way to rest", self._stopping.advance, follower, elapsed)
            if follower.at_rest:
                machine.on(Event.AT_REST, Occasion(machine.reason))
            return position
        return follower.position

    def _brake(self, event: Event, reason: str, account: str = "", ending: bool = False) -> None:
        why = Sentence("{cause}: {reason}", cause=CAUSES[event], reason=reason)
        self._machine.on(event, Occasion(why, account=account, ending=ending))

    def _on_brake(self, row: Row, occasion: Occasion) -> None:
        cause, state, follower = CAUSES[row.event], row.state, self._player.follower
        self.counters[f"stops_{cause}"] += 1
        if state is not State.BRAKING and follower is not None:
            # a second stop while braking keeps the first report; after a silent stream, braking began in the first cycle without a
            # command
            begun = self._player.braking if cause == "silence" else None
            follows = self.mode is Mode.NORMAL and state is State.FOLLOWING and cause != "drift"
            measured = self._controller.measured if follows else ()
            self.side_effects.run(
                "the way to rest", self._stopping.begin, cause, follower, measured, begun, occasion.account
            )
        self._disarm(occasion.reason)

    def _on_brake_to_fault(self, row: Row, occasion: Occasion) -> None:
        self._on_fault(row, occasion)
        self._on_brake(row, occasion)

    def _on_fault(self, row: Row, occasion: Occasion) -> None:
        self.fault = self._machine.changed = True
        if not occasion.ending:
            self.fault_number += 1
            self.stopped = self.stopped or occasion.reason

    def fail(self, reason: str) -> None:
        """Take note of an unexpected exception; from now on the last resort answers (`last_resort`), for good.

        Touches nothing but state and fault: what else is here may be what has failed.
        """
        self._machine.on(Event.FAILURE, Occasion(reason))

    # -- the command side

    def on_command(self, payload: bytes, properties: CommandProperties | PayloadError | None, now: int) -> None:
        """Take a joint string of the `command` topic; `properties` are None without any, the error when they cannot be read."""
        machine = self._machine
        state = machine.state
        try:
            if state is not State.FOLLOWING and state is not State.ARMED:
                raise PayloadError("not_armed", f"gateway is {state.value}")
            stamp, q, lost = self._intake.stream.read(payload, properties, now)
        except PayloadError as error:
            self.refusals.message(error.reason, error, follows=error.reason == "not_armed")
            if error.reason in ("session", "not_armed"):
                self._note_stranger(properties.session if isinstance(properties, CommandProperties) else None, now)
            return
        try:
            if state is State.ARMED:
                why = Sentence("stream of session {session} began", session=self.session)
                machine.on(Event.STREAM_BEGAN, Occasion(why, now, stamp=stamp, q=q))
            else:
                if lost:
                    self.counters["commands_lost"] += lost
                self._intake.take(stamp, q, now - self._controller.heard_at)
            self.counters["commands_received"] += 1
        except MotionRefused as refusal:
            self.refusals.message(refusal.reason, refusal)
            if machine.state is State.FOLLOWING:
                self.refusals.stopped()
            self._brake(Event.COMMAND_REFUSED, str(refusal))
        except StreamBroken as broken:
            self._brake(broken.event, broken.args[0])

    def _note_stranger(self, session: str | None, now: int) -> None:
        if session is not None and self.session and not self._owners.knows(session):
            self._owners.refuse(session)
        else:
            self._player.learn_from_stall(session, now)

    def _on_stream_began(self, row: Row, occasion: Occasion) -> None:
        assert self._player.follower is not None  # an armed gateway has one
        held, now = self._player.follower.position, occasion.now
        self._intake.start(held, occasion.stamp, occasion.q, now - self._controller.heard_at, now)

    # -- control

    def on_control(self, control: Control, now: int) -> Answer:
        """Carry out a `control` message that came at `now` [ns]."""
        if control.verb == "speed_limit":
            return self._limit_speed(control, now)
        if control.verb == "void":
            return self._void(control)
        verbs = {
            "arm": self._arm,
            "stop": self._stop,
            "reset": self._reset,
            "end": self._end,
            "switch": lambda switch: self._switch(switch, now),
        }
        if control.verb not in verbs:
            return self._refuse("verb", f"unknown verb {control.verb!r}")
        if control.verb != "stop" and self._owners.is_repeated(control):
            return self._refuse(
                "repeated", f"message {control.id!r} of session {control.session!r} was answered before"
            )
        answer = verbs[control.verb](control)
        return answer if answer.ok else self._refuse(control.verb, answer.reason)

    def _refuse(self, reason: str, why: str) -> Answer:
        self.refusals.message(reason, why)
        return Answer(False, why)

    def _limit_speed(self, control: Control, now: int) -> Answer:
        if refusal := self.speed.refusal(control, self.session):
            # one that only lacks an armed session may have been under way when a stop came
            follows = not self.session and not self.speed.refusal(control, control.session)
            self.refusals.message("speed_limit", refusal, follows)
            return Answer(False, refusal)
        fraction = float(control.value)  # type: ignore[arg-type]  # `refusal` has found a number
        # a lower limit counts even with an old number: its source may count anew, and a recording of it can only slow the arm
        if self.speed.is_repeated(control) and fraction >= self.speed.given:
            what = f"speed limit {control.id} of session {control.session!r}"
            self._refuse("repeated", f"{what}, or a later one, came before")
            return Answer(False, "")
        if self.speed.give(fraction, control.session, now):
            self._machine.changed = True
        self._poll_speed_limit(now)
        return Answer(True, Sentence("speed at most {fraction:g} of the limits", fraction=fraction))

    def _poll_speed_limit(self, now: int) -> None:
        if self.speed.poll(now):
            self.counters["speed_limit_silent"] += 1
            self._machine.changed = True
        if self.speed.fraction != self._player.fraction:
            self._player.limit(self.speed.fraction)
        if self.tool is not None and not self.speed.given:
            # at once: the grace is for motion that has begun
            self.tool.void(_SPEED_0)

    def _arm(self, control: Control) -> Answer:
        another = self._refusal_of_value(control.value)
        if self.state in (State.ARMED, State.FOLLOWING) and not another:
            refusal = self._machine.on(Event.ARM, Occasion(session=control.session))
            if refusal:
                self._owners.refuse(control.session)
                return Answer(False, refusal)
            return Answer(True, Sentence("already armed for this session"))
        refusal = another or self._refusal_of_session(control.session)
        why = self.noted(Sentence("armed for session {session}", session=control.session))
        refusal = refusal or self._machine.on(Event.ARM, Occasion(why, session=control.session))
        return Answer(False, refusal) if refusal else Answer(True, self.noted(Sentence("armed")))

    def _refusal_of_value(self, value: object) -> str:
        """Return in one sentence why the value of an `arm` does not mean this configuration and run; "" when it does."""
        if refusal := other_protocol(PROTOCOL, protocol_of(value)):
            return refusal
        named = value if isinstance(value, dict) else {"hash": value}
        if named.get("hash") != self.config.hash:
            return Sentence(
                "configuration hash {found} is not the gateway's {present}",
                found=repr(named.get("hash")),
                present=self.config.hash,
            )
        if set(named) != {"hash", "run", "protocol"}:
            return "arm must name hash, run and protocol of the gateway's status, and nothing else"
        return self._refusal_of_run(named["run"])

    def _refusal_of_run(self, run: object) -> str:
        if run == self.run:
            return ""
        return Sentence(
            "run {run} is not the gateway's present one: it was started again, or this is a recording", run=repr(run)
        )

    def _refusal_of_session(self, session: str) -> str:
        if not is_session(session):
            return f"session {session!r} cannot be armed; expected 1 to 64 letters, digits, - and _"
        if self.fault and self.state is not State.FAILED:
            return Sentence("stopped since the last reset; reset first")
        return ""

    def _refusal_of_arm(self, occasion: Occasion) -> str:
        if refusal := self._refusal_of_session(occasion.session) or self._refusal_without_origin(occasion):
            return refusal
        if self._changed_cycle:
            return self._changed_cycle
        measured, follower = self._controller.measured, self._player.follower
        distance = measured and follower and self._controller.distance_off(measured, follower.position, DISPLACED)
        if distance:
            return Sentence(
                "{distance} off the held pose: the arm was moved, or still moves; reset, or start the controller's program again",
                distance=distance,
            )
        if self._owners.knows(occasion.session):
            return Sentence("session {session} has had its turn; begin another", session=occasion.session)
        return ""

    def _on_armed(self, row: Row, occasion: Occasion) -> None:
        self._owners.begin(occasion.session)
        self._intake.stream.begin(occasion.session)
        self.refusals.forgive()

    def _refusal_of_second_session(self, occasion: Occasion) -> str:
        if occasion.session == self.session:
            return ""
        return Sentence("armed for session {session}; stop and reset first", session=self.session)

    def _refusal_without_origin(self, occasion: Occasion) -> str:
        return self._sentence if self._player.follower is None else ""

    def _switch(self, control: Control, now: int) -> Answer:
        if self.tool is None:
            return Answer(False, Sentence("tool: the configuration has none: no switch is possible"))
        stamp, waited = stamp_of(control.value), now - self._controller.heard_at
        lead = None if stamp is None else self._player.lead(stamp) - waited / NANOSECONDS
        refusal = self.tool.arm(control.value, lead, self._obstacle_of_switch(control.session))
        return Answer(not refusal, refusal or Sentence("armed"))

    def _obstacle_of_switch(self, session: str) -> str:
        """Return why nothing may be switched now; "" for nothing."""
        if self.state is not State.FOLLOWING:
            return Sentence("no stream is followed, {present}", present=self._sentence)
        if session != self.session:
            return f"session {session} does not command, session {self.session} does"
        if self.mode is Mode.COMMISSIONING:
            return Sentence("commissioning mode: nothing is switched, as nothing moves")
        return "" if self.speed.given else _SPEED_0

    def _void(self, control: Control) -> Answer:
        count = self.tool.void(_asked(control)) if self.tool else 0
        return Answer(True, f"{count} armed {'switch is' if count == 1 else 'switches are'} void")

    def _stop(self, control: Control) -> Answer:
        self.stop(_asked(control))
        return Answer(True, Sentence("gateway is {state}", state=self.state.value))

    def stop(self, reason: str, account: str = "", ending: bool = False) -> None:
        """Brake, whatever the state, and stay stopped until a `reset`: also a stop of an arm at rest must not be forgotten."""
        self._brake(Event.STOP, reason, account, ending)

    def recall(self, reason: str) -> None:
        """Be stopped until a `reset`, because the run before this one was, and nobody has reset that; before anything else."""
        self.stopped = reason
        self.stop(_not_reset(reason))

    def on_stop(self, stop: Intervention, now: int) -> Answer:
        """Carry out a person's stop that came at `now` [ns]; it needs no session, and nothing that arming needs.

        It is never refused. One that can change nothing any more, because the arm is stopped until a `reset` and the same account
        was just answered several times, is only counted (``stops_repeated``): its answer has no reason.
        """
        # what cannot tell how often an account was answered must not refuse its stop
        if (
            self.side_effects.run("the pace of answers", self._stop_pace.take, stop.account, now) is False
            and self.stopped
        ):
            self.counters["stops_repeated"] += 1
            # it changes nothing now, and yet a reset that is under way does not know of it
            self.fault_number += 1
            return Answer(True, "")
        self.stop(Sentence("asked for by account {account}", account=stop.account), stop.account)
        return Answer(True, Sentence("gateway is {state}", state=self.state.value))

    def refuse_stop(self, account: str, error: PayloadError, now: int) -> Answer:
        """Count a message on `stop/<account>` that is no stop; the answer has no reason where none is due."""
        self.refusals.message(error.reason, error)
        return Answer(False, str(error) if self._stop_pace.take(account, now) else "")

    def _end(self, control: Control) -> Answer:
        if not self.config.layout.stop:
            return Answer(False, self._words.no_stop)
        if self._player.follower is None or self.state is State.FAILED:
            return Answer(False, self._sentence)
        self.end(Sentence("end {asked}", asked=_asked(control)))
        return Answer(True, self._words.ends)

    def end(self, reason: str, program: bool = False) -> None:
        """Brake as in `stop`, and once at rest end the controller's program where a reply can.

        Where this `program` ends, and asks for it itself, that is no stop of anybody's, and gets no number.
        """
        self.stop(reason, ending=program)
        self._ending = self.config.layout.stop

    @property
    def ends(self) -> bool:
        """True when replies must end the controller's program: the end was asked for, and the arm is at rest."""
        return self._ending and self.state in (State.HOLDING, State.MEASURING, State.OTHER_CYCLE)

    def _reset(self, control: Control) -> Answer:
        done = Sentence("reset")
        occasion = Occasion(self.noted(done), session=control.session, value=control.value)
        refusal = self._machine.on(Event.RESET, occasion)
        return Answer(False, refusal) if refusal else Answer(True, done)

    def _refusal_of_reset(self, occasion: Occasion) -> str:
        follower = self._player.follower
        if follower is None:
            return self._refusal_without_origin(occasion)
        if refusal := self._refusal_of_number(occasion.value):
            return refusal
        return "" if follower.at_rest else Sentence("the arm is still moving; stop it first")

    def _refusal_of_number(self, value: object) -> str:
        """Return in one sentence why the value of a `reset` does not mean the newest stop of this run; "" when it does."""
        if refusal := other_protocol(PROTOCOL, protocol_of(value)):
            return refusal
        if not isinstance(value, dict) or set(value) != {"run", "fault_number", "protocol"}:
            return "reset must name run, fault_number and protocol of the gateway's status, and nothing else"
        number = value["fault_number"]
        if refusal := self._refusal_of_run(value["run"]):
            return refusal
        if type(number) is not int or number != self.fault_number:
            return Sentence(
                "reset names fault_number {found}, the last stop is number {number}: look at it, and reset again",
                found=repr(number),
                number=self.fault_number,
            )
        return ""

    def _refusal_of_owner_reset(self, occasion: Occasion) -> str:
        if occasion.session != self.session:
            # also the owner's own next session asks too early sometimes: no intruder yet
            return Sentence(
                "session {session} commands; stop it, or wait until its stream has ended", session=self.session
            )
        return self._refusal_of_reset(occasion)

    def _on_reset(self, row: Row, occasion: Occasion) -> None:
        self._disarm(Sentence("reset"))
        self.fault, self.stopped, self._ending = False, "", False
        self.refusals.forgive()
        if self.mode is Mode.COMMISSIONING or not any(self.correction):
            # the arm stands at its origin, or where a program of the controller took it: the next stream begins there
            self._controller.renew_origin()
            self._player.place(self._controller.origin)

    def _disarm(self, why: str) -> None:
        if self.tool is not None:
            self.tool.void(why)
        self._intake.stream.begin("")
        self._command_stamp = 0
        self._player.clear()

    # -- status

    def take_change(self) -> bool:
        """Return whether the state changed since the last call."""
        changed, self._machine.changed = self._machine.changed, False
        return self.tool.take_change() or changed if self.tool is not None else changed

    def status(self) -> dict:
        """Return the content of the `status` topic."""
        config, owners = self.config, self._owners
        failure = self.reason if self.state is State.FAILED else ""
        return document(
            Status(
                tool=self.tool.report(failure) if self.tool is not None else None,
                state=self.state.value,
                reason=self.reason,
                session=self.session,
                fault=self.fault,
                fault_number=self.fault_number,
                mode=self.mode.value,
                correction=self.correction,
                controller=self._status.report(),
                last_ipoc_jump_ms=self._controller.jump_ms,
                cycle=self.clock.report(),
                run=self.run,
                protocol=PROTOCOL,
                hash=config.hash,
                decimals=config.decimals,
                properties=config.properties,
                playout=self._player.report(),
                speed_limit=self.speed.report(),
                stop=self._stopping.report(),
                intruder={"session": owners.intruder, "count": owners.intrusions},
                last_refusal=self.refusals.last,
                later_refusal=self.refusals.later,
                counters=dict(self.counters) | self.side_effects.counts("failed_beside"),
            )
        )

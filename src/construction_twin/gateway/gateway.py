"""The gateway as a pure object: commands, controls and telegrams in; corrections, states and status out.

It knows no socket and no clock: `now` is an argument, in ns on the gateway's monotonic clock. Every telegram is answered from what
is already here (design, law 1). Standard library only; rad and ns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from construction_twin.core.errors import MotionRefused, PayloadError
from construction_twin.core.units import CYCLE_NS, NANOSECONDS
from construction_twin.gateway.arming import refusal_of_arm, refusal_of_value
from construction_twin.gateway.command_intake import CommandIntake, StreamBroken
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.mode import NOTES, Mode
from construction_twin.gateway.ownership import Ownership
from construction_twin.gateway.player import Player
from construction_twin.gateway.refusals import Refusals
from construction_twin.gateway.rsi_session import ControllerSession
from construction_twin.gateway.speed_limit import SpeedLimit
from construction_twin.gateway.state_report import StateReport
from construction_twin.gateway.states import State
from construction_twin.gateway.status import gateway_status
from construction_twin.gateway.stop_report import StopReport
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties, Control, StateProperties
from construction_twin.rsi.gateway_codec import RobotTelegram

#: Telegrams missed for longer than this mean that the arm has come to a stand under HOLDON. A single missed telegram is less of a
#: blow when the motion goes on at its speed than when it starts over [ns].
STANDSTILL = 2 * CYCLE_NS


class Gateway:
    """One robot's gateway between the command stream and the RSI session.

    Parameters
    ----------
    config : GatewayConfig
    run : str
        An id that no other run of the gateway has had; an `arm` must name it.
    commissioning : bool, optional
        True: everything runs and is reported as usual, but every correction that leaves is zero.
    """

    def __init__(self, config: GatewayConfig, run: str, commissioning: bool = False):
        self.config = config
        self.run = run
        self.mode = Mode.of(config, commissioning)
        #: The last correction, as it would be without commissioning mode [rad], [m].
        self.correction: tuple[float, ...] = ()
        self.codec = JointStringCodec.of_config(config)
        self.counters: Counter[str] = Counter()
        #: What was refused, and why; whoever stands before the gateway refuses here too.
        self.refusals = Refusals(self.counters)
        self.state = State.NO_CONTROLLER
        self.reason = "no telegram yet"
        #: True after any stop but one by silence, until a `reset`; outlives the RSI session.
        self.fault = False
        #: Called with every answered telegram: IPOC, number of the RSI session, state, stamp of the target [ns] (0: none), and
        #: position [rad], which is origin plus correction. None costs nothing.
        self.trace: Callable[[int, int, State, int, tuple[float, ...]], None] | None = None
        self._controller = ControllerSession(config, self.counters)
        self._owners = Ownership()
        self._player = Player(config, self.counters)
        self._stream = CommandIntake(config, self.codec, self._player)
        #: How fast the arm may move, as somebody outside says.
        self.speed = SpeedLimit(config)
        self._stopping = StopReport(config.limits.linear)
        self._states = StateReport(self.codec, self.counters, config.properties)
        self._silence = round(config.silence * NANOSECONDS)
        self._answered_stamp = 0
        self._ending, self._changed = False, True

    @property
    def session(self) -> str:
        """Id of the session that may command; "" for none."""
        return self._stream.session

    # -- the controller's side

    def accepts(self, source: object, now: int) -> bool:
        """Return whether a datagram from `source` may be read: nobody else may disturb a controller that is alive."""
        return self._controller.accepts(source, now)

    def on_telegram(self, telegram: RobotTelegram, source: object, now: int) -> tuple[float, ...] | None:
        """Take a telegram and return the corrections to answer it with.

        Parameters
        ----------
        telegram : RobotTelegram
        source : object
            Where it came from; another source is another session.
        now : int
            [ns]

        Returns
        -------
        correction : tuple, shape (n,) or None
            Target minus origin [rad]; None when this telegram must not be answered.
        """
        controller = self._controller
        if controller.is_repeated(telegram.ipoc, source):
            self.counters["telegrams_repeated"] += 1
            return None
        sent = self.correction if self.mode is Mode.NORMAL else ()
        elapsed = controller.hear(telegram, source, now, sent, self.state in (State.FOLLOWING, State.BRAKING))
        if elapsed is None:
            self._begin_session(telegram)
            elapsed = CYCLE_NS
        if self.state is State.JOINED or self.state is State.READ_ONLY:
            return self._leave_unanswered(telegram)
        player = self._player
        if player.follower is None:
            self._find_origin(telegram)
        drifted = controller.note(telegram)
        if player.follower is None:
            self.counters["telegrams_unanswered" if self.state is State.JOINED else "telegrams"] += 1
            return None if self.state is State.JOINED else (0.0,) * len(self.config.axes)
        if drifted:
            self._note_drift(telegram.setpoint)
        self._answered_stamp = player.stamp
        self.counters["telegrams"] += 1
        if elapsed > STANDSTILL:
            # HOLDON kept the arm where it was: going on at the speed of before would be a step from standstill
            player.follower.rest()
        position = self._move(elapsed)
        if self.trace is not None:
            self.trace(telegram.ipoc, self.counters["rsi_sessions"], self.state, player.stamp, position)
        self.correction = tuple([value - start for value, start in zip(position, controller.origin)])
        return self.correction if self.mode is Mode.NORMAL else (0.0,) * len(position)

    def poll(self, now: int) -> None:
        """Notice silence, of the controller or of a speed limit's source; call this at least every 0.1 s."""
        self._poll_speed_limit(now)
        if self._controller.is_silent(now):
            self._controller.end()
            self._player.remove()
            self._disarm()
            self._enter(State.NO_CONTROLLER, f"no telegram for {self.config.timeout:g} s")

    def state_message(self, stamp: int) -> tuple[bytes, StateProperties] | None:
        """Return the joint string of the measured pose and its properties, or None when there is nothing to tell.

        Parameters
        ----------
        stamp : int
            The gateway's own time, for the receiver's freshness check [ns].
        """
        return self._states.message(self._controller.measured, self._answered_stamp, stamp)

    def _begin_session(self, telegram: RobotTelegram) -> None:
        self._controller.begin(telegram)
        self._player.remove()
        self._disarm()
        self._ending = False
        self.correction = ()
        state = State.READ_ONLY if self.mode is Mode.READ_ONLY else State.READY
        self._enter(state, f"RSI session began at IPOC {telegram.ipoc}: {self._controller.began}{NOTES[self.mode]}")

    def _leave_unanswered(self, telegram: RobotTelegram) -> None:
        self.counters["telegrams_unanswered"] += 1
        if self.state is State.READ_ONLY and telegram.measured is not None:
            self._controller.measured = telegram.measured

    def _find_origin(self, telegram: RobotTelegram) -> None:
        refusal = self._controller.find_origin(telegram)
        if refusal:
            self._enter(State.JOINED, refusal)
        elif self._controller.origin:
            self._player.place(self._controller.origin)

    def _note_drift(self, setpoint: tuple[float, ...]) -> None:
        if self.state is State.READY or self.state is State.ARMED:
            # a program of the controller moves the arm: nobody commands it here, so what is held goes with it
            position = self._player.follower.position
            self._player.place(self._controller.move_origin(setpoint, position))
        elif self.state is State.FOLLOWING:
            drift = self._controller.drift(setpoint)
            if drift:
                self._brake("drift", drift)

    # -- motion

    def _move(self, elapsed: int) -> tuple[float, ...]:
        if self.state is State.FOLLOWING:
            # in commissioning mode the arm does not do what the player does
            position = self._player.play(elapsed, self._controller.measured if self.mode is Mode.NORMAL else ())
            overdue = self._player.overdue
            if overdue > self._silence:
                self._player.give_up(self.session, self._controller.heard_at)
                self._brake("silence", f"no command for {overdue / NANOSECONDS:.3f} s beyond the newest one")
            return position
        follower = self._player.follower
        if self.state is State.BRAKING:
            position = follower.brake()
            self._stopping.advance(follower, elapsed)
            if follower.at_rest:
                self._enter(State.HOLDING, self.reason)
            return position
        return follower.position

    def _brake(self, cause: str, reason: str) -> None:
        self.counters[f"stops_{cause}"] += 1
        self.fault = self.fault or cause != "silence"
        if self.state is not State.BRAKING:
            # asked again while it brakes, what was stated holds; for a stream that is missing it has braked since it ran dry
            begun = self._player.braking if cause == "silence" else None
            follows = self.mode is Mode.NORMAL and self.state is State.FOLLOWING and cause != "drift"
            self._stopping.begin(cause, self._player.follower, self._controller.measured if follows else (), begun)
        self._disarm()
        self._enter(State.BRAKING, f"{cause}: {reason}")

    # -- the command side

    def on_command(self, payload: bytes, properties: CommandProperties | PayloadError | None, now: int) -> None:
        """Take one message of the `command` topic.

        Parameters
        ----------
        payload : bytes
            A joint string.
        properties : CommandProperties, PayloadError or None
            What was beside it: None without MQTT 5 properties, the error when they could not be read.
        now : int
            [ns]
        """
        try:
            stamp, q = self._read_command(payload, properties, now)
        except PayloadError as error:
            self.refusals.message(error.reason, error)
            if error.reason in ("session", "not_armed"):
                self._note_stranger(properties.session if isinstance(properties, CommandProperties) else None, now)
            return
        try:
            self._take(stamp, q, now)
        except MotionRefused as refusal:
            self.refusals.message(refusal.reason, refusal)
            if self.state is State.FOLLOWING:
                self._brake("refused", str(refusal))
        except StreamBroken as broken:
            self._brake(broken.cause, str(broken))

    def _note_stranger(self, session: str | None, now: int) -> None:
        if session is not None and self.session and not self._owners.knows(session):
            self._owners.refuse(session)
        else:
            self._player.learn_from_stall(session, now)

    def _read_command(
        self, payload: bytes, properties: CommandProperties | PayloadError | None, now: int
    ) -> tuple[int, tuple[float, ...]]:
        if self.state is not State.FOLLOWING and self.state is not State.ARMED:
            raise PayloadError("not_armed", f"gateway is {self.state.value}")
        stamp, q, lost = self._stream.read(payload, properties, now)
        if lost and self.state is State.FOLLOWING:
            self.counters["commands_lost"] += lost
        return stamp, q

    def _take(self, stamp: int, q: tuple[float, ...], now: int) -> None:
        waited = now - self._controller.heard_at
        if self.state is State.ARMED:
            self._stream.start(stamp, q)
            self._enter(State.FOLLOWING, f"stream of session {self.session} began")
            self._player.learn_from_stall(self.session if self.config.properties else None, now)
        else:
            self._stream.go_on(stamp, q, waited)
        self._stream.push(stamp, q, waited)
        self.counters["commands_received"] += 1

    # -- control

    def on_control(self, control: Control, now: int) -> tuple[bool, str]:
        """Carry out a `control` message that came at `now` [ns].

        Returns
        -------
        ok : bool
        reason : str
            Why, in one sentence; goes into `control/ack`. "" when there is nothing to answer: it was answered before.
        """
        if control.verb == "speed_limit":
            return self._limit_speed(control, now)
        verbs = {"arm": self._arm, "stop": self._stop, "reset": self._reset, "end": self._end}
        if control.verb not in verbs:
            return self._refuse("verb", f"unknown verb {control.verb!r}")
        if self._owners.is_repeated(control) and control.verb != "stop":
            why = f"message {control.id!r} of session {control.session!r} was answered before"
            return self._refuse("repeated", why)
        ok, reason = verbs[control.verb](control)
        return (ok, reason) if ok else self._refuse(control.verb, reason)

    def _refuse(self, reason: str, why: str) -> tuple[bool, str]:
        self.refusals.message(reason, why)
        return False, why

    def _limit_speed(self, control: Control, now: int) -> tuple[bool, str]:
        if refusal := self.speed.refusal(control, self.session):
            return self._refuse("speed_limit", refusal)
        # a lower limit counts however old it looks: its source may count anew, and a recording of it can only slow the arm
        if self.speed.is_repeated(control) and control.value >= self.speed.given:
            why = f"speed limit {control.id} of session {control.session!r}, or a later one, came before"
            return self._refuse("repeated", why)[0], ""
        self._changed |= self.speed.give(float(control.value), control.session, now)
        self._poll_speed_limit(now)
        return True, f"speed at most {control.value:g} of the limits"

    def _poll_speed_limit(self, now: int) -> None:
        if self.speed.poll(now):
            self.counters["speed_limit_silent"] += 1
            self._changed = True
        if self.speed.fraction != self._player.fraction:
            self._player.limit(self.speed.fraction)

    def _arm(self, control: Control) -> tuple[bool, str]:
        if self.state in (State.ARMED, State.FOLLOWING) and not refusal_of_value(control.value, self):
            if control.session == self.session:
                return True, "already armed for this session"
            self._owners.refuse(control.session)
            return False, f"armed for session {self.session}; stop and reset first"
        refusal = refusal_of_arm(control, self, self._controller, self._player.follower)
        if refusal:
            return False, refusal
        if not self._owners.begin(control.session):
            return False, f"session {control.session} has had its turn; begin another"
        self._stream.begin(control.session)
        self._enter(State.ARMED, f"armed for session {control.session}{NOTES[self.mode]}")
        return True, f"armed{NOTES[self.mode]}"

    def _stop(self, control: Control) -> tuple[bool, str]:
        self.stop(f"asked for by {control.session or 'nobody by name'}")
        return True, f"gateway is {self.state.value}"

    def stop(self, reason: str) -> None:
        """Brake, whatever the state, and stay stopped until a `reset`: also a stop of an arm at rest must not be forgotten."""
        if self._player.follower is None:
            self.fault = self._changed = True
            return
        self._brake("stop", reason)

    def _end(self, control: Control) -> tuple[bool, str]:
        if not self.config.layout.stop:
            return False, "the Ethernet XML declares no Stop element: end the program on the pendant"
        if self._player.follower is None:
            return False, f"gateway is {self.state.value}: {self.reason}"
        self.end(f"end asked for by {control.session or 'nobody by name'}")
        return True, "RSI_MOVECORR ends as soon as the arm is at rest"

    def end(self, reason: str) -> None:
        """Brake as in `stop`, and once at rest end RSI_MOVECORR where the Ethernet XML declares `Stop`."""
        self.stop(reason)
        self._ending = self.config.layout.stop

    @property
    def ends(self) -> bool:
        """True when replies must carry Stop 1: the end was asked for, and the arm is at rest."""
        return self._ending and self.state is State.HOLDING

    def _reset(self, control: Control) -> tuple[bool, str]:
        if self._player.follower is None:
            return False, f"gateway is {self.state.value}: {self.reason}"
        if self.state is State.FOLLOWING and control.session != self.session:
            # also the owner's own next session asks too early sometimes: no intruder yet
            return False, f"session {self.session} commands; stop it, or wait until its stream has ended"
        if not self._player.follower.at_rest:
            return False, "the arm is still moving; stop it first"
        self._disarm()
        self.fault = self._ending = False
        if self.mode is Mode.COMMISSIONING or not any(self.correction):
            # the arm stands at its origin, or where a program of the controller took it: the next stream begins there
            self._controller.renew_origin()
            self._player.place(self._controller.origin)
        self._enter(State.READY, f"reset{NOTES[self.mode]}")
        return True, "reset"

    def _disarm(self) -> None:
        self._stream.begin("")
        self._answered_stamp = 0
        self._player.clear()

    # -- status

    def _enter(self, state: State, reason: str) -> None:
        self.state, self.reason, self._changed = state, reason, True

    def add_reason(self, note: str) -> None:
        """Add to the reason of the present state; a change, too."""
        self._enter(self.state, f"{self.reason}; {note}")

    def take_change(self) -> bool:
        """Return whether the state changed since the last call."""
        changed, self._changed = self._changed, False
        return changed

    def status(self) -> dict:
        """Return the content of the `status` topic."""
        parts = (self._controller, self._player, self.speed, self._stopping, self._owners)
        return gateway_status(self, *parts)

"""The gateway as a pure object: commands, controls and telegrams in; corrections, states and status out.

It knows no socket and no clock: `now` is an argument, in ns on the gateway's monotonic clock. Every telegram is answered from what
is already here (design, law 1). Standard library only; rad and ns.
"""

from __future__ import annotations

from collections import Counter
from enum import Enum

from construction_twin.errors import MotionRefused, PayloadError
from construction_twin.limits import MotionCheck, outside_tolerance
from construction_twin.mqtt.codec import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties, Control, StateProperties
from construction_twin.rsi.codec import RobotTelegram
from construction_twin.rsi.command_stream import CommandStream
from construction_twin.rsi.config import GatewayConfig
from construction_twin.rsi.follower import Follower
from construction_twin.rsi.playout import Playout
from construction_twin.units import CYCLE_NS, NANOSECONDS

#: IPOC counts milliseconds (rsi.md, section 4).
IPOC_NS = 1_000_000
#: A controller that was heard this recently is alive, and its session its own [ns].
ALIVE = NANOSECONDS // 10
#: Telegrams missed for longer than this mean that the arm has come to a stand under HOLDON. A single missed telegram is less of a
#: blow when the motion goes on at its speed than when it starts over [ns].
STANDSTILL = 2 * CYCLE_NS


class State(Enum):
    """What the gateway is doing; the words are those of `status`."""

    NO_CONTROLLER = "no_controller"  # no telegram for the timeout: nothing to answer
    JOINED = "joined_running"  # telegrams whose correction we cannot know: not answered, so that the session times out
    READY = "ready"  # origin captured, holding; waits for `arm`
    ARMED = "armed"  # holding; the session's stream may begin
    FOLLOWING = "following"  # the stream is played
    BRAKING = "braking"  # on the way to rest
    HOLDING = "holding"  # at rest after a fault or a stop; waits for `reset`


class Gateway:
    """One robot's gateway between the command stream and the RSI session.

    Parameters
    ----------
    config : GatewayConfig
    """

    def __init__(self, config: GatewayConfig):
        self.config = config
        self.codec = JointStringCodec(len(config.axes), config.decimals)
        self.counters: Counter[str] = Counter()
        self.state = State.NO_CONTROLLER
        self.reason = "no telegram yet"
        self._stream = CommandStream(config, self.codec)
        self._check = MotionCheck(config.limits, config.decimals)
        self._playout = Playout(round(config.playout_delay * NANOSECONDS))
        self._follower: Follower | None = None
        self._origin: tuple[float, ...] = ()
        self._measured: tuple[float, ...] = ()
        self._source: object = None
        self._ipoc = 0
        self._last_telegram = 0
        self._last_delay = 0
        self._empty_telegrams = 0
        self._target_stamp = 0
        self._answered_stamp = 0
        self._changed = True
        #: True after any stop but one by silence, until a `reset`; outlives the RSI session.
        self.fault = False

    @property
    def session(self) -> str:
        """Id of the session that may command; "" for none."""
        return self._stream.session

    # -- the controller's side

    def accepts(self, source: object, now: int) -> bool:
        """Return whether a datagram from `source` may be read: while a controller is alive, only its own are.

        Whatever else sends to the port must neither end the session nor push one of its telegrams aside.
        """
        alive = self.state is not State.NO_CONTROLLER and now - self._last_telegram <= ALIVE
        return source == self._source or not alive

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
        if self._is_repeated(telegram.ipoc, source):
            self.counters["telegrams_repeated"] += 1
            return None
        elapsed = self._elapsed(telegram.ipoc, source, now)
        self._ipoc, self._source, self._last_telegram = telegram.ipoc, source, now
        if elapsed is None:
            self._begin_session(telegram)
            elapsed = CYCLE_NS
        if self.state is State.JOINED:
            self.counters["telegrams_unanswered"] += 1
            return None
        self._note_delay(telegram.delay)
        if telegram.measured is None or telegram.setpoint is None:
            self.counters["telegrams_without_pose"] += 1
        if self._follower is None and not self._begin_at(telegram):
            return None if self.state is State.JOINED else (0.0,) * len(self.config.axes)
        if telegram.measured is not None:
            self._note_pose(telegram)
        self._answered_stamp = self._target_stamp
        self.counters["telegrams"] += 1
        if elapsed > STANDSTILL:
            # HOLDON kept the arm where it was: going on at the speed of before would be a step from standstill
            self._follower.rest()
        position = self._move(elapsed)
        return tuple([value - start for value, start in zip(position, self._origin)])

    def poll(self, now: int) -> None:
        """Notice that the controller has fallen silent; call this at least every 0.1 s."""
        if self.state is not State.NO_CONTROLLER and now - self._last_telegram > self.config.timeout * NANOSECONDS:
            self._end_session(f"no telegram for {self.config.timeout:g} s")

    def state_message(self, stamp: int) -> tuple[bytes, StateProperties] | None:
        """Return the joint string of the measured pose and its properties, or None when there is nothing to tell.

        Parameters
        ----------
        stamp : int
            The gateway's own time, for the receiver's freshness check [ns].
        """
        if not self._measured or self.state is State.NO_CONTROLLER:
            return None
        try:
            payload = self.codec.encode(self._measured)
        except PayloadError as error:
            self.counters[f"state_refused_{error.reason}"] += 1
            return None
        self.counters["states_sent"] += 1
        command_stamp = self._answered_stamp if self.config.properties else 0
        return payload, StateProperties(self.counters["states_sent"], stamp, command_stamp)

    def _is_repeated(self, ipoc: int, source: object) -> bool:
        """Tell whether the network brought a telegram twice, or behind a newer one: it was answered, or it is too late to."""
        behind = (self._ipoc - ipoc) * IPOC_NS
        alive = self.state is not State.NO_CONTROLLER and source == self._source
        return alive and 0 <= behind <= self.config.timeout * NANOSECONDS

    def _elapsed(self, ipoc: int, source: object, now: int) -> int | None:
        """Return the controller time since the last telegram [ns], or None when this one begins another session."""
        if self.state is State.NO_CONTROLLER:
            return None
        if source != self._source:
            self.counters["sessions_by_source"] += 1
            return None
        elapsed = (ipoc - self._ipoc) * IPOC_NS
        if not 0 < elapsed <= self.config.timeout * NANOSECONDS:
            self.counters["sessions_by_ipoc_jump"] += 1
            return None
        if elapsed != CYCLE_NS:
            self.counters["ipoc_steps_irregular"] += 1
        return elapsed

    def _begin_session(self, telegram: RobotTelegram) -> None:
        self._origin, self._follower = (), None
        self._disarm()
        # a Delay on the first packet belongs to the session's start, before anybody could answer
        self._last_delay = telegram.delay or 0
        self._empty_telegrams = 0
        self.counters["rsi_sessions"] += 1
        self._enter(State.READY, f"RSI session began at IPOC {telegram.ipoc}")

    def _end_session(self, reason: str) -> None:
        self._origin, self._follower, self._measured = (), None, ()
        self._disarm()
        self._enter(State.NO_CONTROLLER, reason)

    def _begin_at(self, telegram: RobotTelegram) -> bool:
        """Capture the origin; return False while there is none, or when this session must not be answered (JOINED)."""
        if telegram.measured is None and telegram.setpoint is None and not self._empty_telegrams:
            # RSI up to 2.3 opens a session with a telegram that holds only IPOC (rsi.md, section 2)
            self._empty_telegrams += 1
            return False
        if telegram.measured is None or telegram.setpoint is None:
            self._enter(
                State.JOINED,
                "telegrams lack AIPos or ASPos, so nobody can tell where the correction stands: not answering; declare DEF_AIPos "
                "and DEF_ASPos in the Ethernet XML",
            )
            return False
        self._capture_origin(telegram)
        return self.state is not State.JOINED

    def _capture_origin(self, telegram: RobotTelegram) -> None:
        off = outside_tolerance(telegram.measured, telegram.setpoint, self.config.start_tolerance)
        if off is not None:
            self._enter(
                State.JOINED,
                f"{self.config.axes[off]} is already {telegram.measured[off] - telegram.setpoint[off]:.6f} rad off its programmed "
                "position: joined a running session, not answering; it times out, then start the program again",
            )
            return
        self._origin = telegram.setpoint if self.config.reference == "ASPos" else telegram.measured
        self._follower = Follower(self.config.limits, self.config.decimals, self._origin)

    def _note_pose(self, telegram: RobotTelegram) -> None:
        self._measured = telegram.measured
        if self.config.reference == "ASPos" and telegram.setpoint is not None and telegram.setpoint != self._origin:
            self.counters["reference_drifts"] += 1

    def _note_delay(self, delay: int | None) -> None:
        if delay is not None:
            self.counters["late_replies"] += max(0, delay - self._last_delay)
            self._last_delay = delay

    # -- motion

    def _move(self, elapsed: int) -> tuple[float, ...]:
        if self.state is State.FOLLOWING:
            return self._play(elapsed)
        if self.state is State.BRAKING:
            position = self._follower.brake()
            if self._follower.at_rest:
                self._enter(State.HOLDING, self.reason)
            return position
        return self._follower.position

    def _play(self, elapsed: int) -> tuple[float, ...]:
        stamp, target = self._playout.advance(elapsed)
        if self._playout.silence > self.config.silence * NANOSECONDS:
            self._brake("silence", f"no command for {self._playout.silence / NANOSECONDS:.3f} s beyond the newest one")
            return self._follower.brake()
        self._target_stamp = stamp
        position = self._follower.follow(target)
        if self._follower.settling:
            self.counters["settling"] += 1
        return position

    def _brake(self, cause: str, reason: str) -> None:
        self.counters[f"stops_{cause}"] += 1
        self.fault = self.fault or cause != "silence"
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
            self.counters[f"refused_{error.reason}"] += 1
            return
        try:
            self._take(stamp, q)
        except MotionRefused as refusal:
            self.counters[f"refused_{refusal.reason}"] += 1
            if self.state is State.FOLLOWING:
                self._brake("refused", str(refusal))

    def _read_command(
        self, payload: bytes, properties: CommandProperties | PayloadError | None, now: int
    ) -> tuple[int, tuple[float, ...]]:
        if isinstance(properties, PayloadError):
            raise properties
        if self.config.properties and properties is None:
            raise PayloadError("properties", "command without session, seq and stamp")
        if self.state not in (State.ARMED, State.FOLLOWING):
            raise PayloadError("not_armed", f"gateway is {self.state.value}")
        stamp, q, lost = self._stream.read(payload, properties, now)
        if self.state is State.FOLLOWING:
            self.counters["commands_lost"] += lost
        return stamp, q

    def _take(self, stamp: int, q: tuple[float, ...]) -> None:
        if self.state is State.ARMED:
            self.config.limits.check_range(q)
            off = outside_tolerance(q, self._follower.position, self.config.start_tolerance)
            if off is not None:
                distance = q[off] - self._follower.position[off]
                raise MotionRefused("start", self.config.axes[off], distance, self.config.start_tolerance)
            self._check.start(stamp, q)
            self._enter(State.FOLLOWING, f"stream of session {self.session} began")
        else:
            lead = self._playout.lead(stamp) / NANOSECONDS
            if lead > self.config.max_age:
                # a clock that was set, or a sender faster than time: it would be played in slow motion, and never fall silent
                raise MotionRefused("lead", "", lead, self.config.max_age, "s")
            self._check.accept(stamp, q)
        self._stream.last_stamp = stamp
        self._playout.push(stamp, q)
        self.counters["commands_received"] += 1

    # -- control

    def on_control(self, control: Control) -> tuple[bool, str]:
        """Carry out a `control` message.

        Returns
        -------
        ok : bool
        reason : str
            Why, in one sentence; goes into `control/ack`.
        """
        verbs = {"arm": self._arm, "stop": self._stop, "reset": self._reset}
        if control.verb not in verbs:
            self.counters["refused_verb"] += 1
            return False, f"unknown verb {control.verb!r}"
        ok, reason = verbs[control.verb](control)
        if not ok:
            self.counters[f"refused_{control.verb}"] += 1
        return ok, reason

    def _arm(self, control: Control) -> tuple[bool, str]:
        if control.value != self.config.hash:
            return False, f"configuration hash {control.value!r} is not the gateway's {self.config.hash}"
        if self.state in (State.ARMED, State.FOLLOWING):
            if control.session == self.session:
                return True, "already armed for this session"
            return False, f"armed for session {self.session}; stop and reset first"
        if self.fault:
            return False, "stopped since the last reset; reset first"
        if self.state is not State.READY or self._follower is None:
            return False, f"gateway is {self.state.value}: {self.reason}"
        self._stream.begin(control.session)
        self._enter(State.ARMED, f"armed for session {control.session}")
        return True, "armed"

    def _stop(self, control: Control) -> tuple[bool, str]:
        self.stop(f"asked for by {control.session or 'nobody by name'}")
        return True, f"gateway is {self.state.value}"

    def stop(self, reason: str) -> None:
        """Brake, whatever the state, and stay stopped until a `reset`: also a stop of an arm at rest must not be forgotten."""
        if self._follower is None:
            self.fault = self._changed = True
            return
        self._brake("stop", reason)

    def _reset(self, control: Control) -> tuple[bool, str]:
        if self._follower is None:
            return False, f"gateway is {self.state.value}: {self.reason}"
        if not self._follower.at_rest:
            return False, "the arm is still moving; stop it first"
        self._disarm()
        self.fault = False
        self._enter(State.READY, "reset")
        return True, "reset"

    def _disarm(self) -> None:
        self._stream.begin("")
        self._target_stamp = 0
        self._answered_stamp = 0
        self._playout.clear()

    # -- status

    def _enter(self, state: State, reason: str) -> None:
        self.state, self.reason, self._changed = state, reason, True

    def take_change(self) -> bool:
        """Return whether the state changed since the last call."""
        changed, self._changed = self._changed, False
        return changed

    def status(self) -> dict:
        """Return the content of the `status` topic."""
        return {
            "state": self.state.value,
            "reason": self.reason,
            "session": self.session,
            "fault": self.fault,
            "hash": self.config.hash,
            "decimals": self.config.decimals,
            "properties": self.config.properties,
            "counters": dict(self.counters),
        }

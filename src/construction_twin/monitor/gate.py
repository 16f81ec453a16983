"""The gate: Algorithm 1 in the command path. Nothing reaches either robot that has not passed here.

`now` is in ns on the monotonic clock, which is never set; stamps are on a clock of their own. Angles in rad, prismatic joints in m.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from construction_twin.core.errors import ConfigurationError, MotionRefused, PayloadError
from construction_twin.core.limits import MotionCheck, MotionLimits
from construction_twin.core.sentences import Quantity, Sentence, Value
from construction_twin.core.state_table import row_of
from construction_twin.core.travel_time import TravelTime
from construction_twin.core.units import CYCLE_NS, NANOSECONDS, axis_name, from_display_unit, to_display_unit
from construction_twin.monitor.comparison import Comparison, PoseComparison, RoundTrips
from construction_twin.monitor.servo_watch import ServoDifference, ServoWatch
from construction_twin.monitor.settings import STOP, GateSettings
from construction_twin.monitor.states import (
    HELD_STATES,
    ROWS,
    Action,
    Guard,
    Row,
    SyncEvent,
    SyncState,
    Transition,
)
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.servo.model import ServoModel

#: A setpoint may be this much later than the quickest one [ns]: an executor that catches up sends what is 80 ms late, and what is
#: later the gateway has bridged and braked for.
LATEST = NANOSECONDS // 10
#: A gate is at rest when the command has not changed for this long [ns]: by then the arm has arrived, too.
REST = NANOSECONDS // 2
_IN_TIME = Sentence(
    "at most {latest:g} s: the monitor was not run, or the executor's clock was set back (then call reset)",
    latest=LATEST / NANOSECONDS,
)


@dataclass(frozen=True)
class Cause:
    """Why a gate is closed, and since when [ns], on the gate's clock."""

    sentence: str
    since: int


class Gate:
    """Passes theta_next, or repeats the last command that passed: Algorithm 1 of the paper.

    The paper holds the twin's pose, theta_virtual. The last command is where the twin is, or is about to be: holding anything older
    would send both robots a step backwards.

    Args:
        codec: The wire's; everything that passes is rounded by it, so that both robots execute identical numbers.
        servos: How the arm's servos answer; None: unknown, and the arm is compared with the twin alone.
        compares: False without a physical arm: the gate then only checks the motion.
    """

    def __init__(
        self,
        limits: MotionLimits,
        codec: JointStringCodec,
        settings: GateSettings,
        now: int = 0,
        servos: ServoModel | None = None,
        compares: bool = True,
    ):
        self._limits, self._compares = limits, compares
        #: Compares the arm with the model of its servos; None: there is no model.
        self.servo_watch = (
            ServoWatch(servos, settings.comparison_settings(limits).threshold) if servos is not None else None
        )
        self._codec = codec
        self.settings = settings
        self.violations = 0
        self.refused = 0
        #: Whether the arm leads: then nothing opens the gate.
        self.mirrored = False
        #: Queued changes of state, oldest first.
        self.transitions: list[Transition] = []
        self.state, self._entered_for = SyncState.WAITING, ""
        self._forget()
        self.fire(SyncEvent.STARTED, Sentence("started"), now)

    def _forget(self) -> None:
        self.comparison = PoseComparison(self.settings.comparison_settings(self._limits))
        if self.servo_watch is not None:
            self.servo_watch.restart()
        #: Nominal stamp of the last setpoint that passed [ns]; 0 when none.
        self.held_stamp = 0
        self._check = MotionCheck(self._limits, self._codec.decimals)
        self._agreed_since: int | None = None
        self._agreed = False
        self._stamp = 0
        #: Stamp of the last setpoint that passed; at the opening, one cycle before the first.
        self._before = 0
        self._travel = TravelTime()
        self._round_trips = RoundTrips()
        #: When a pose that could be compared was received last.
        self._last_feedback: int | None = None
        self._obstacle = ""
        self._policy = self.settings.policy
        self._closed_at = 0
        #: What closed the gate, until it opens; None while it never was open.
        self._violation: Cause | None = None
        #: The first difference since the poses agreed last, or were not known; None: they agree.
        self._difference: Cause | None = None
        #: When the last command that passed differed from the one before it.
        self._moved_at: int | None = None
        #: When holds began that count towards `escalate_count` [ns].
        self._closings: deque[int] = deque()
        #: Whether the present hold is in `_closings`.
        self._counted = False

    @property
    def reason(self) -> str:
        """Why the state was entered, and what keeps it although the poses agree."""
        if not self._obstacle:
            return self._entered_for
        return Sentence("{reason}; not opened: {obstacle}", reason=self._entered_for, obstacle=self._obstacle)

    @property
    def cause(self) -> Cause | None:
        """Violation or difference that keeps the gate closed, through every closed state; None: open, none known, the arm leads."""
        if self.state is SyncState.IN_SYNC or self.mirrored:
            return None
        return self._violation or self._difference

    @property
    def policy(self) -> str:
        """The policy after a violation: of a closed gate, the one at its closing."""
        return self.settings.policy if self.state in (SyncState.WAITING, SyncState.IN_SYNC) else self._policy

    @property
    def held(self) -> tuple[float, ...]:
        """Last command that passed [rad], which a closed gate repeats; empty while it has never been open."""
        return self._check.position

    def pop_transitions(self) -> list[Transition]:
        """Return the changes of state since the last call, oldest first."""
        taken, self.transitions = self.transitions, []
        return taken

    # -- the table

    def fire(self, event: SyncEvent, reason: str, now: int) -> bool:
        """Apply the first row of the table whose guard holds; return whether there was one."""
        self._obstacle = ""
        row, comparison, held_stamp = self._row(event, now), self.comparison.last, self.held_stamp
        if row is None:
            return False
        self._act(row.action, now)
        if row.target is not None:
            self.state = row.target
            if row.action is not Action.KEEP_REASON:
                self._entered_for = reason
            cause = row.state, row.target, event, reason
            self.transitions.append(Transition(now, *cause, comparison, held_stamp))
        return True

    def _row(self, event: SyncEvent, now: int) -> Row | None:
        """Return the row that would apply to an event now."""
        settings = self.settings

        def holds(guard: Guard) -> bool:
            match guard:
                case Guard.UNCOUNTED:
                    return not self._counted
                case Guard.STOP_POLICY:
                    return self._policy == STOP
                case Guard.TOO_MANY:
                    return len(self._closings) >= settings.escalate_count
                case Guard.HELD_TOO_LONG:
                    return now - self._closed_at > settings.give_up_time * NANOSECONDS
            return True

        return row_of(ROWS, self.state, event, holds)

    def _act(self, action: Action, now: int) -> None:
        if action is Action.FORGET:
            self._forget()
        if action in (Action.HOLD, Action.HOLD_AND_COUNT):
            self.violations += 1
            # whatever closed the gate, agreement counts from now on
            self._agreed, self._agreed_since = False, None
            self._policy, self._closed_at, self._counted = self.settings.policy, now, False
            if self.servo_watch is not None:
                # what stops here is not what the gateway plays: it brakes
                self.servo_watch.suspend_judging()
        if action in (Action.COUNT, Action.HOLD_AND_COUNT):
            self._counted = True
            self._closings.append(now)
            while self._closings[0] < now - self.settings.escalate_time * NANOSECONDS:
                self._closings.popleft()

    # -- from outside

    def restart(self, reason: str, now: int) -> None:
        """Close the gate and forget every pose: a new command session, in which twin and arm start over."""
        self.fire(SyncEvent.NEW_SESSION, reason, now)

    def set_mirrored(self, leads: bool, now: int) -> None:
        """Set whether the arm leads and nothing is sent; STOPPED stays. A new session follows."""
        if leads and not self.mirrored:
            self.fire(SyncEvent.MIRROR, Sentence("the arm leads: nothing is commanded"), now)
        self.mirrored = leads

    def is_at_rest(self, now: int) -> bool:
        """Return whether the command has not changed for `REST`; `now` in ns."""
        return self._moved_at is None or now - self._moved_at >= REST

    def check_rest(self, now: int) -> None:
        """Raise ConfigurationError for a change of settings while the arm moves or may move, or while the gate holds."""
        if self.mirrored:
            raise ConfigurationError("the gate", "the arm leads", "an arm that does not: it can move at any moment")
        if not self.is_at_rest(now):
            expected = f"a command that has not changed for {REST / NANOSECONDS:g} s"
            raise ConfigurationError("the gate", "in motion", expected)
        if self.state in HELD_STATES:
            expected = "WAITING, IN_SYNC or STOPPED: settings must not open a gate that a violation has closed"
            raise ConfigurationError("the gate", self.state.name, expected)

    def configure(self, settings: GateSettings, reason: str, now: int) -> None:
        """Apply other settings at rest, as a transition."""
        self.check_rest(now)
        comparison = settings.comparison_settings(self._limits)
        if self.servo_watch is not None:
            self.servo_watch.configure(comparison.threshold)
        self.comparison.configure(comparison)
        self.settings = settings
        self.fire(SyncEvent.CONFIGURED, reason, now)

    # -- poses

    def on_twin(self, stamp: int, q: tuple[float, ...]) -> None:
        """Store the twin's pose [rad] with the stamp of the command it executes [ns]."""
        self.comparison.twin.add(stamp, q)

    def on_physical(
        self, q: tuple[float, ...], command_stamp: int, now: int, received: int | None = None, seq: int = 0
    ) -> Comparison | None:
        """Compare a physical pose, shape (n,) [rad]; None: the twin's for that stamp is unknown. The first difference closes.

        Args:
            received: Time of reception on the clock of the stamps [ns], for the report alone; by default `now`.
            seq: The gateway's counter of its states; 0: not known, and so is what the servos should do.
        """
        continued = self._is_fresh(now)
        round_trip = self._round_trips.elapsed_since(command_stamp, now)
        comparison = self.comparison.compare(q, command_stamp, now if received is None else received, round_trip)
        servos = None
        if self.servo_watch is not None and self._compares:
            in_sync = self.state is SyncState.IN_SYNC and comparison is not None and comparison.agrees
            servos = self.servo_watch.on_pose(q, seq, command_stamp, in_sync)
        if comparison is None:
            return None
        self._last_feedback = now
        if servos is not None or not comparison.agrees:
            self._agreed, self._agreed_since = False, None
            self._on_difference(comparison, servos, now)
            return comparison
        self._difference = None
        if not continued:
            self._agreed, self._agreed_since = False, None
        if not self._agreed:
            if not comparison.agrees_within(self.settings.agree_share):
                self._agreed_since = None
            else:
                self._agreed_since = now if self._agreed_since is None else self._agreed_since
                self._agreed = now - self._agreed_since >= self.settings.agree_time * NANOSECONDS
        return comparison

    def _on_difference(self, comparison: Comparison, servos: ServoDifference | None, now: int) -> None:
        """Record a difference from the twin or the servo model; close the gate where it is open."""
        closes = self._row(SyncEvent.POSE_DIFFERS, now) is not None
        if not self._compares or (self._difference is not None and not closes):
            return
        if servos is None:
            worst = comparison.worst()
            values = difference_values(self._limits, worst, comparison.error[worst], comparison.threshold[worst])
            sentence = Sentence("{joint} differs by {difference:.3}, {threshold:.3} allowed", **values)
        else:
            values = difference_values(self._limits, servos.joint, servos.residual, servos.threshold)
            sentence = Sentence(
                "{joint} is {difference:.3} from where its servo should have it, {threshold:.3} allowed", **values
            )
        self._difference = self._difference or Cause(sentence, now)
        if closes:
            self._close(SyncEvent.POSE_DIFFERS, sentence, now)

    def is_agreed(self, now: int) -> bool:
        """Return whether twin and arm agree, begun by `agree_time` within `agree_share`; without an arm, a twin's pose suffices."""
        if not self._compares:
            return self.comparison.twin.latest is not None
        return self._agreed and self._is_fresh(now)

    # -- the path

    def pass_next(self, stamp: int, theta_next: tuple[float, ...], now: int) -> tuple[float, ...] | None:
        """Return the command for theta_next, shape (n,) [rad], rounded to the wire, by its nominal stamp [ns].

        None while the gate has never been open, while the arm leads, and for a setpoint that is not newer than the last one.
        """
        if stamp <= self._stamp:
            self.refused += 1
            return None
        self._stamp = stamp
        self._round_trips.on_setpoint(stamp, now)
        late = self._travel.record(stamp, now)
        if self.mirrored:
            return None
        was_open = self.state is SyncState.IN_SYNC
        self.watch(now)
        if not was_open:
            self._try_to_open(stamp, theta_next, late, now)
        elif late > LATEST and self.state is SyncState.IN_SYNC:
            seconds = late / NANOSECONDS
            sentence = Sentence("theta_next is {late:.3f} s late; {expected}", late=seconds, expected=_IN_TIME)
            self._close(SyncEvent.SETPOINT_STALE, sentence, now)
        passed = self._check.position or None
        if self.state is SyncState.IN_SYNC:
            passed = self._checked(stamp, theta_next, now)
        if passed and self.servo_watch is not None:
            self.servo_watch.on_command(stamp, passed)
        return passed

    def watch(self, now: int) -> None:
        """Close on stale feedback, and give up a long hold: also while no theta_next comes."""
        if self.state is SyncState.IN_SYNC:
            if self._compares and not self._is_fresh(now) and self._last_feedback is not None:
                age = (now - self._last_feedback) / NANOSECONDS
                stale = Sentence("last comparable feedback is {age:.3f} s old", age=age)
                self._close(SyncEvent.FEEDBACK_STALE, stale, now)
            elif (watch := self.servo_watch) is not None and watch.refinement.due and self.is_at_rest(now):
                # what was learned of the servos takes effect at rest; a change is a transition
                if changes := watch.refine():
                    changed = ", ".join(f"{name} {1e3 * change:+.2f} ms" for name, change in changes.items())
                    refined = Sentence("the servos' lag was refined: {lags}", lags=changed)
                    self.fire(SyncEvent.SERVOS_REFINED, refined, now)
        elif self._row(SyncEvent.GAVE_UP, now) is not None:
            held = (now - self._closed_at) / NANOSECONDS
            sentence = Sentence("held for {held:.3f} s; {reason}; call reset", held=held, reason=self._entered_for)
            self.fire(SyncEvent.GAVE_UP, sentence, now)

    def _is_fresh(self, now: int) -> bool:
        last = self._last_feedback
        return last is not None and now - last <= self.settings.feedback_timeout * NANOSECONDS

    def _close(self, event: SyncEvent, reason: str, now: int) -> None:
        """Close the gate for a violation, and stop it where policy or number of holds demand that."""
        if self.fire(event, reason, now):
            self._violation = Cause(reason, self._closed_at)
        self.fire(SyncEvent.POLICY_STOP, Sentence("the policy is to stop; {reason}; call reset", reason=reason), now)
        count, time = len(self._closings), self.settings.escalate_time
        held = Sentence("held {count} times in {time:g} s; {reason}; call reset", count=count, time=time, reason=reason)
        self.fire(SyncEvent.ESCALATED, held, now)

    def _try_to_open(self, stamp: int, theta_next: tuple[float, ...], late: int, now: int) -> None:
        if self.state is SyncState.STOPPED or self.mirrored or not self.is_agreed(now):
            return
        if late > LATEST:
            self._obstacle = Sentence("theta_next is late; {expected}", expected=_IN_TIME)
            return
        latest = self.comparison.twin.latest
        if latest is None:
            return
        held = latest[1] if self.state is SyncState.WAITING else self._check.position
        try:
            trial = MotionCheck(self._limits, self._codec.decimals)
            trial.start(stamp - CYCLE_NS, self._codec.quantise(held))
            trial.accept(stamp, self._codec.quantise(theta_next))
        except (MotionRefused, PayloadError) as refusal:
            self._obstacle = str(refusal)
            return
        self._check.start(stamp - CYCLE_NS, self._codec.quantise(held))
        self._before = stamp - CYCLE_NS
        self._violation = None
        self.fire(SyncEvent.OPENED, Sentence("poses agree and the stream continues from the held pose"), now)

    def _checked(self, stamp: int, theta_next: tuple[float, ...], now: int) -> tuple[float, ...]:
        try:
            command = self._codec.quantise(theta_next)
            moves = command != self._check.position
            if moves and stamp - self._before > LATEST:
                gap = (stamp - self._before) / NANOSECONDS
                sentence = Sentence(
                    "theta_next moves {gap:.3f} s after the last one; {expected}", gap=gap, expected=_IN_TIME
                )
                self._close(SyncEvent.SETPOINT_STALE, sentence, now)
                return self._check.position
            self._check.accept(stamp, command)
        except (MotionRefused, PayloadError) as refusal:
            self.refused += 1
            self._close(SyncEvent.SETPOINT_REFUSED, str(refusal), now)
            return self._check.position
        self.held_stamp = self._before = stamp
        if moves:
            self._moved_at = now
        return command


def difference_values(limits: MotionLimits, joint: int, difference: float, threshold: float) -> dict[str, Value]:
    """Return `joint`, `difference` and `threshold` for a sentence, the difference also above its threshold in three decimals."""
    unit = "m" if limits.linear[joint] else "rad"
    (shown, _), (allowed, people) = to_display_unit(difference, unit), to_display_unit(threshold, unit)
    if round(shown, 3) <= round(allowed, 3):
        difference, _ = from_display_unit(round(allowed, 3) + 0.001, people)
    name = axis_name(limits.names[joint])
    return {"joint": name, "difference": Quantity(difference, unit), "threshold": Quantity(threshold, unit)}

"""The controller's side of the gateway: which telegrams count, when a session begins, its corrections and answers. rad, ns."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

from construction_twin.controller.port import ControllerStatus
from construction_twin.controller.telegram import STAMP_NS, Telegram, stamp_step
from construction_twin.core.limits import distance_off
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.config import GatewayConfig

#: A controller that was heard this recently is alive, and its session its own [ns].
ALIVE = NANOSECONDS // 10


@dataclass(frozen=True, slots=True)
class TelegramOutcome:
    """What a telegram means for its session.

    Attributes:
        elapsed: Controller time since the telegram before; a cycle for the first one.
        refusal: Why this session must not be answered, in the telegram that shows it; "": it may be.
        missed: The controller has missed a reply since the telegram before.
        lost: The last answer did not arrive in time.
        drifted_to: Shape (n,). The programmed position where it is off the origin, else ().
    """

    elapsed: int
    begins: bool
    refusal: str
    missed: bool
    lost: bool
    drifted_to: tuple[float, ...]


class Replies:
    """The last replies to a controller: corrections, `absolute` positions, or all `zero`."""

    def __init__(self, absolute: bool, zero: bool):
        self._absolute, self._zero = absolute, zero
        # an answer carries the correction as it is
        self._plain = not absolute and not zero
        self.begin()

    def begin(self) -> None:
        """Forget the session before."""
        #: The last correction, as it would be without commissioning mode; () before the first.
        self.correction: tuple[float, ...] = ()
        #: The last correction that was sent; () before the first.
        self.sent: tuple[float, ...] = ()
        #: The one that the controller had before it, and keeps if it does not arrive; () before the first.
        self.last_acknowledged: tuple[float, ...] = ()
        #: How long no answer has arrived while telegrams went on.
        self.lost_for = 0

    def record_loss(self, lost: bool, elapsed: int) -> None:
        """Record whether the last answer was lost, `elapsed` [ns] of the controller's time ago."""
        if lost:
            self.lost_for += elapsed
        else:
            self.last_acknowledged, self.lost_for = self.correction, 0

    def answer(self, position: tuple[float, ...], origin: tuple[float, ...]) -> tuple[float, ...]:
        """Return the content of the reply that brings the axes to a position [rad]."""
        correction = tuple([value - start for value, start in zip(position, origin)])
        self.correction = correction
        if not self._zero:
            self.sent = correction
        return correction if self._plain else self.to_target(correction, origin)

    def to_target(self, correction: tuple[float, ...], origin: tuple[float, ...]) -> tuple[float, ...]:
        """Return the content of the reply for a correction [rad]."""
        if self._zero:
            correction = (0.0,) * len(correction)
        return corrected(origin, correction) if self._absolute else correction


def corrected(origin: tuple[float, ...], correction: tuple[float, ...]) -> tuple[float, ...]:
    """Return the position of a correction to an origin [rad]."""
    return tuple([start + value for start, value in zip(origin, correction)])


class ControllerSession:
    """One session of the controller after the other."""

    def __init__(self, config: GatewayConfig, counters: Counter[str], zero: bool = False):
        self.replies = Replies(config.make.absolute, zero)
        self.status = self._no_status = config.make.no_status
        self._limits, self._tolerances = config.limits, config.start_tolerances
        self._rules, self._terms = config.make.rules(config), config.make.terms
        self._reader = config.make.reader(config)
        self._counters = counters
        self._timeout = round(config.timeout * NANOSECONDS)
        self._timeout_ms = round(config.timeout * 1000)
        self._cycle = config.cycle_ns
        self.alive = False
        #: What corrections are relative to; () while it is unknown.
        self.origin: tuple[float, ...] = ()
        #: Measured pose of the last telegram that had one; () for none.
        self.measured: tuple[float, ...] = ()
        #: The newest telegram, for `tool_pose`; b"" for none.
        self.datagram = b""
        self.received_at = 0
        self.stamp = 0
        self.begin_reason = ""
        #: The last step of the clock that was not a cycle [ms].
        self.jump_ms = 0
        self._source: object = None
        self._expects_replies = config.layout.expects_replies
        self._refused = False
        self._last_missed = 0
        # what most telegrams mean
        self._regular = TelegramOutcome(self._cycle, False, "", False, False, ())

    def accepts(self, source: object, now: int) -> bool:
        """Return whether a datagram from `source` may be read: while a controller is alive, only its own are."""
        return source == self._source or not (self.alive and now - self.received_at <= ALIVE)

    def is_silent(self, now: int) -> bool:
        """Return whether the controller has been silent for its timeout."""
        return self.alive and now - self.received_at > self._timeout

    def on_telegram(self, telegram: Telegram, source: object, now: int, moving: bool = False) -> TelegramOutcome | None:
        """Judge a telegram; None when it came twice or behind a newer one. `moving`: whether the correction is being changed."""
        step = stamp_step(self.stamp, telegram.controller_ms, self._timeout_ms)
        goes_on = self.alive and source == self._source
        if goes_on and -self._timeout_ms <= step <= 0:
            return None
        elapsed = step * STAMP_NS
        begins = False
        if not goes_on or elapsed != self._cycle:
            begins = self._is_new_session(goes_on, step) or self._is_restarted(telegram, moving)
        if begins:
            self._begin(telegram)
            elapsed = self._cycle
        self.stamp, self._source, self.received_at = telegram.controller_ms, source, now
        missed = elapsed > self._cycle or (telegram.missed is not None and telegram.missed > self._last_missed)
        refusal, lost = "", False
        drifted_to: tuple[float, ...] = ()
        if not self._expects_replies:
            self.store_measured(telegram)
        elif not self._refused:
            if not self.origin:
                self.origin, refusal = self._rules.origin(telegram)
                self._refused = bool(refusal)
            # before the count of missed replies is taken over
            if telegram.missed != self._last_missed or elapsed != self._cycle:
                lost = self._is_reply_lost(telegram.missed, elapsed)
            drifted_to = self._store_poses(telegram)
        if elapsed == self._cycle and not (begins or missed or refusal or lost or drifted_to):
            return self._regular
        return TelegramOutcome(elapsed, begins, refusal, missed, lost, drifted_to)

    def _begin(self, telegram: Telegram) -> None:
        self.alive = True
        # a pose of the session before is void
        self.origin = self.measured = ()
        self._refused = False
        # what was missed before the first telegram belongs to the session's start, before anybody could answer
        self._last_missed = telegram.missed or 0
        self._counters["rsi_sessions"] += 1

    def end(self) -> None:
        """End the session."""
        self.alive = False
        self.origin = self.measured = ()
        self.datagram = b""
        self.status = self._no_status

    @property
    def acknowledged_target(self) -> tuple[float, ...]:
        """The last acknowledged target, as it was sent [rad], [m]; () before the first."""
        return self.replies.to_target(self.replies.last_acknowledged, self.origin)

    def on_status(self, status: ControllerStatus, unreadable: int) -> None:
        """Store a telegram's optional channels, and count unreadable ones."""
        self.status = status
        if unreadable:
            self._counters["status_channels_unreadable"] += unreadable

    def tool_pose(self) -> dict[str, tuple[float, ...]] | None:
        """Return the newest telegram's tool pose and the axes of the same one, for `status`; None where it has none."""
        # read here, once a second, and not where a reply waits
        read = self._reader.tool_pose
        pose = read(self.datagram) if read is not None else None
        axes = self._reader.parse(self.datagram).measured if pose else None
        return {"axes": axes, "position": pose[:3], "abc": pose[3:]} if pose and axes else None

    def store_measured(self, telegram: Telegram) -> None:
        """Store the measured pose of a telegram, where it has one."""
        self.measured = telegram.measured or self.measured

    def _is_reply_lost(self, count: int | None, elapsed: int) -> bool:
        """Return whether the last answer was lost: the controller's count has risen by every cycle since.

        An impossible number is counted: a higher one is a lost reply, a lower one is not (docs/rsi.md, section 5).
        """
        if count is None:
            self._counters["telegrams_without_delay"] += 1
            return False
        cycles = max(1, elapsed // self._cycle)
        missed = count - self._last_missed
        if missed > cycles or (missed < cycles and cycles - 1 not in (missed, count)):
            self._counters["delay_irregular"] += 1
        return missed >= cycles

    def _store_poses(self, telegram: Telegram) -> tuple[float, ...]:
        """Store a telegram's poses and its count of late replies; return where it is programmed off the origin."""
        missed = telegram.missed
        if missed is not None and missed != self._last_missed:
            self._counters["late_replies"] += max(0, missed - self._last_missed)
            self._last_missed = missed
        if telegram.measured is None or telegram.setpoint is None:
            self._counters["telegrams_without_pose"] += 1
        if telegram.measured is None or not self.origin:
            return ()
        self.measured = telegram.measured
        if telegram.setpoint is None or telegram.setpoint == self.origin or not self._rules.follows_setpoint:
            return ()
        self._counters["reference_drifts"] += 1
        return telegram.setpoint

    def drift(self, setpoint: tuple[float, ...]) -> str:
        """Return in one sentence how far a programmed position [rad] is off the origin; "" within the start tolerance."""
        distance = self.distance_off(setpoint, self.origin)
        return distance and self._rules.drift_sentence(distance)

    def distance_off(self, q: tuple[float, ...], reference: tuple[float, ...], tolerances: float = 1.0) -> str:
        """Return in words the distance of the first axis beyond so many start tolerances; "" for none."""
        return distance_off(q, reference, self._limits, [tolerances * allowed for allowed in self._tolerances])

    def renew_origin(self) -> None:
        """Move a measured origin to the present pose, while the correction is zero."""
        if not self._rules.follows_setpoint and self.measured:
            self.origin = self.measured

    def move_origin(self, setpoint: tuple[float, ...], position: tuple[float, ...]) -> tuple[float, ...]:
        """Move the origin to a programmed position [rad]; return `position` there, with the same correction."""
        correction = [value - start for value, start in zip(position, self.origin)]
        self.origin = setpoint
        return tuple([start + value for start, value in zip(setpoint, correction)])

    def _is_new_session(self, goes_on: bool, step: int) -> bool:
        """Return whether a step of the stamps [ms] begins another session, by the rules of all makes."""
        if not self.alive:
            self.begin_reason = Sentence("the first telegram after silence")
        elif not goes_on:
            self.begin_reason = Sentence("telegrams come from another source")
            self._counters["sessions_by_source"] += 1
        else:
            self.jump_ms = step
            if 0 < step * STAMP_NS <= self._timeout:
                return False
            self.begin_reason = Sentence("{stamp} jumped by {jump} ms", stamp=self._terms.stamp, jump=step)
            self._counters["sessions_by_ipoc_jump"] += 1
        self._rules.begin()
        return True

    def _is_restarted(self, telegram: Telegram, moving: bool) -> bool:
        """Return whether missing cycles hide a restart of the session, by the make's own signs."""
        sign = self._rules.restart_sign(telegram, self.origin, self.replies.sent, moving)
        if sign:
            jump, protocol = self.jump_ms, self._terms.protocol
            self.begin_reason = Sentence(
                "{sign}, {jump} ms on: {protocol} was switched on anew", sign=sign, jump=jump, protocol=protocol
            )
        self._counters["sessions_by_restart" if sign else "ipoc_steps_irregular"] += 1
        return bool(sign)

"""The controller's side of the gateway: which telegrams count, when a session begins, and where its corrections stand.

Standard library only; rad and ns.
"""

from __future__ import annotations

from collections import Counter

from construction_twin.controller.telegram import STAMP_NS, Telegram, stamp_step
from construction_twin.core.limits import distance_off
from construction_twin.core.sentences import Sentence, Value
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.config import GatewayConfig

#: A controller that was heard this recently is alive, and its session its own [ns].
ALIVE = NANOSECONDS // 10


class ControllerSession:
    """One session of the controller after the other.

    Args:
        counters: The gateway's; what is noticed here is counted there.
    """

    def __init__(self, config: GatewayConfig, counters: Counter[str]):
        self._limits = config.limits
        self._tolerances = config.start_tolerances
        self._rules = config.make.rules(config)
        self._follows = self._rules.follows
        self._words = config.make.words
        self._counters = counters
        self._timeout = round(config.timeout * NANOSECONDS)
        self._timeout_ms = round(config.timeout * 1000)
        self._cycle = config.cycle_ns
        #: True from the first telegram to the end of the last session.
        self.alive = False
        #: What corrections are relative to [rad]; () while it is not known.
        self.origin: tuple[float, ...] = ()
        #: Measured pose of the last telegram that had one [rad]; () when there is none.
        self.measured: tuple[float, ...] = ()
        #: When the last telegram came [ns].
        self.heard_at = 0
        self.stamp = 0
        #: Why the present session began.
        self.began = ""
        #: The last step of the clock that was not a cycle [ms].
        self.jump_ms = 0
        self._source: object = None
        self._last_missed = 0

    def accepts(self, source: object, now: int) -> bool:
        """Return whether a datagram from `source` may be read: while a controller is alive, only its own are."""
        return source == self._source or not (self.alive and now - self.heard_at <= ALIVE)

    def is_repeated(self, stamp: int, source: object) -> bool:
        """Return whether a telegram came twice, or behind a newer one: it was answered, or an answer comes too late."""
        behind = stamp_step(stamp, self.stamp, self._timeout_ms)
        return self.alive and 0 <= behind <= self._timeout_ms and source == self._source

    def is_silent(self, now: int) -> bool:
        """Return whether the controller has been silent for its timeout."""
        return self.alive and now - self.heard_at > self._timeout

    def hear(
        self,
        telegram: Telegram,
        source: object,
        now: int,
        correction: tuple[float, ...] = (),
        moving: bool = False,
    ) -> int | None:
        """Take note of a telegram, and of whether it belongs to the session.

        Args:
            source: Where it came from.
            now: [ns]
            correction: Shape (n,). What the last answer carried [rad]; () for nothing.
            moving: Whether that correction is being changed.

        Returns:
            Controller time since the last telegram [ns]; None when another session begins.
        """
        elapsed = self._elapsed(telegram.stamp, source)
        if elapsed is None:
            self._rules.begin()
        elif elapsed != self._cycle:
            sign = self._rules.restarted(telegram, self.origin, correction, moving)
            if sign:
                values: dict[str, Value] = {"sign": sign, "jump": self.jump_ms, "protocol": self._words.protocol}
                self.began = Sentence("gateway.began.again", **values)
                elapsed = None
            self._counters["sessions_by_restart" if sign else "ipoc_steps_irregular"] += 1
        self.stamp, self._source, self.heard_at = telegram.stamp, source, now
        return elapsed

    def begin(self, telegram: Telegram) -> None:
        """Begin a session with its first telegram."""
        self.alive = True
        # what was measured in the session before says nothing about this one
        self.origin = self.measured = ()
        # what was missed before the first telegram belongs to the session's start, before anybody could answer
        self._last_missed = telegram.missed or 0
        self._counters["rsi_sessions"] += 1

    def end(self) -> None:
        """End the session."""
        self.alive = False
        self.origin = self.measured = ()

    def find_origin(self, telegram: Telegram) -> str:
        """Take the origin from a telegram; where that is impossible it stays unknown.

        Returns:
            Why this session must not be answered; "" when it may be.
        """
        self.origin, refusal = self._rules.origin(telegram)
        return refusal

    def counts_missed(self, telegram: Telegram) -> bool:
        """Return whether the controller has counted more late replies than in the last telegram that was noted."""
        return telegram.missed is not None and telegram.missed > self._last_missed

    def is_reply_lost(self, telegram: Telegram, elapsed: int) -> bool:
        """Return whether the controller says that the last answer did not arrive in time; call it before `note`.

        The count has then risen by every cycle since: so it does whether it counts the misses in a row, and falls back with a
        reply, or all of a session, and does not. A number that it cannot have is counted: a higher one is a reply that is lost, a
        lower one is not (docs/rsi.md, section 5).

        Args:
            elapsed: Controller time since the telegram that was answered last [ns].
        """
        told, before = telegram.missed, self._last_missed
        if told == before and elapsed == self._cycle:
            return False
        if told is None:
            self._counters["telegrams_without_delay"] += 1
            return False
        cycles = max(1, elapsed // self._cycle)
        missed = told - before
        if missed > cycles or (missed < cycles and cycles - 1 not in (missed, told)):
            self._counters["delay_irregular"] += 1
        return missed >= cycles

    def note(self, telegram: Telegram) -> bool:
        """Take a telegram's poses and its count of late replies; return whether it is programmed elsewhere than at the origin."""
        missed = telegram.missed
        if missed is not None and missed != self._last_missed:
            self._counters["late_replies"] += max(0, missed - self._last_missed)
            self._last_missed = missed
        if telegram.measured is None or telegram.setpoint is None:
            self._counters["telegrams_without_pose"] += 1
        if telegram.measured is None or not self.origin:
            return False
        self.measured = telegram.measured
        if telegram.setpoint is None or telegram.setpoint == self.origin or not self._follows:
            return False
        self._counters["reference_drifts"] += 1
        return True

    def drift(self, setpoint: tuple[float, ...]) -> str:
        """Return in one sentence how far a programmed position [rad] is off the origin; "" within the start tolerance."""
        distance = self.distance_off(setpoint, self.origin)
        return distance and Sentence(self._rules.drifted, distance=distance)

    def distance_off(self, q: tuple[float, ...], reference: tuple[float, ...], tolerances: float = 1.0) -> str:
        """Return how far the first axis is off that is further than so many start tolerances, for people; "" when none is."""
        return distance_off(q, reference, self._limits, [tolerances * allowed for allowed in self._tolerances])

    def renew_origin(self) -> None:
        """Where the measured pose is the origin, take the present one; only while the correction is zero."""
        if not self._follows and self.measured:
            self.origin = self.measured

    def move_origin(self, setpoint: tuple[float, ...], position: tuple[float, ...]) -> tuple[float, ...]:
        """Take another programmed position [rad] as origin; return where `position` is then, with the same correction."""
        correction = [value - start for value, start in zip(position, self.origin)]
        self.origin = setpoint
        return tuple([start + value for start, value in zip(setpoint, correction)])

    def _elapsed(self, stamp: int, source: object) -> int | None:
        if not self.alive:
            self.began = Sentence("gateway.began.first")
            return None
        if source != self._source:
            self.began = Sentence("gateway.began.source")
            self._counters["sessions_by_source"] += 1
            return None
        step = stamp_step(self.stamp, stamp, self._timeout_ms)
        elapsed = step * STAMP_NS
        if elapsed != self._cycle:
            self.jump_ms = step
            if not 0 < elapsed <= self._timeout:
                self.began = Sentence("gateway.began.jump", stamp=self._words.stamp, jump=self.jump_ms)
                self._counters["sessions_by_ipoc_jump"] += 1
                return None
        return elapsed

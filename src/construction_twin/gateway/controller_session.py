"""The controller's side of the gateway: which telegrams count, when a session begins, and where its corrections stand.

Standard library only; rad and ns.
"""

from __future__ import annotations

from collections import Counter

from construction_twin.core.limits import outside_tolerance
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.config import GatewayConfig
from construction_twin.rsi.gateway_codec import RobotTelegram, ipoc_step

#: IPOC counts milliseconds (docs/rsi.md, section 4).
IPOC_NS = 1_000_000
#: A controller that was heard this recently is alive, and its session its own [ns].
ALIVE = NANOSECONDS // 10


def distance_off(
    q: tuple[float, ...], reference: tuple[float, ...], config: GatewayConfig, tolerances: float = 1.0
) -> str:
    """Return how far the first axis beyond the start tolerance is from its reference, for people; "" when none is.

    Args:
        q, reference: Shape (n,). [rad], [m]
        tolerances: How many start tolerances are allowed.
    """
    allowed = [tolerances * tolerance for tolerance in config.start_tolerances]
    off = outside_tolerance(q, reference, allowed)
    if off is None:
        return ""
    unit = "m" if config.axes[off] in config.linear else "rad"
    return f"{config.axes[off]} is {q[off] - reference[off]:.6f} {unit}"


class ControllerSession:
    """One RSI session after the other.

    Args:
        counters: The gateway's; what is noticed here is counted there.
    """

    def __init__(self, config: GatewayConfig, counters: Counter[str]):
        self._config = config
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
        self.ipoc = 0
        #: Why the present session began.
        self.began = ""
        #: The last step of IPOC that was not a cycle [ms].
        self.jump_ms = 0
        self._source: object = None
        self._last_delay = 0
        self._empty_telegrams = 0

    def accepts(self, source: object, now: int) -> bool:
        """Return whether a datagram from `source` may be read: while a controller is alive, only its own are."""
        return source == self._source or not (self.alive and now - self.heard_at <= ALIVE)

    def is_repeated(self, ipoc: int, source: object) -> bool:
        """Return whether a telegram came twice, or behind a newer one: it was answered, or an answer comes too late."""
        behind = ipoc_step(ipoc, self.ipoc, self._timeout_ms)
        return self.alive and 0 <= behind <= self._timeout_ms and source == self._source

    def is_silent(self, now: int) -> bool:
        """Return whether the controller has been silent for its timeout."""
        return self.alive and now - self.heard_at > self._timeout

    def hear(
        self,
        telegram: RobotTelegram,
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
        elapsed = self._elapsed(telegram.ipoc, source)
        if elapsed is None:
            self._empty_telegrams = 0
        elif elapsed != self._cycle:
            sign = self._sign_of_restart(telegram, correction, moving)
            if sign:
                self.began = f"{sign}, {self.jump_ms} ms on: RSI was switched on anew"
                elapsed = None
            self._counters["sessions_by_restart" if sign else "ipoc_steps_irregular"] += 1
        self.ipoc, self._source, self.heard_at = telegram.ipoc, source, now
        return elapsed

    def begin(self, telegram: RobotTelegram) -> None:
        """Begin a session with its first telegram."""
        self.alive = True
        # what was measured in the session before says nothing about this one
        self.origin = self.measured = ()
        # a Delay on the first packet belongs to the session's start, before anybody could answer
        self._last_delay = telegram.delay or 0
        self._counters["rsi_sessions"] += 1

    def end(self) -> None:
        """End the session."""
        self.alive = False
        self.origin = self.measured = ()

    def find_origin(self, telegram: RobotTelegram) -> str:
        """Take the origin from a telegram; where that is impossible it stays unknown.

        Returns:
            Why this session must not be answered; "" when it may be.
        """
        if telegram.measured is None and telegram.setpoint is None and not self._empty_telegrams:
            # RSI up to 2.3 opens a session with a telegram that holds only IPOC (docs/rsi.md, section 2)
            self._empty_telegrams += 1
            return ""
        if telegram.measured is None or telegram.setpoint is None:
            return (
                "telegrams lack AIPos or ASPos, so the present correction is unknown: not answering; declare DEF_AIPos "
                "and DEF_ASPos in the Ethernet XML"
            )
        if telegram.delay is None:
            return (
                "telegrams lack Delay, so a reply that does not arrive would go unnoticed, and the next one would be a step: not "
                "answering; declare DEF_Delay in the Ethernet XML"
            )
        distance = distance_off(telegram.measured, telegram.setpoint, self._config)
        if distance:
            return (
                f"{distance} off its programmed position already: joined a running session, not answering; "
                "it times out, then start the program again"
            )
        self.origin = telegram.setpoint if self._config.reference == "ASPos" else telegram.measured
        return ""

    def counts_missed(self, telegram: RobotTelegram) -> bool:
        """Return whether the controller has counted more late replies than in the last telegram that was noted."""
        return telegram.delay is not None and telegram.delay > self._last_delay

    def is_reply_lost(self, telegram: RobotTelegram, elapsed: int) -> bool:
        """Return whether the controller says that the last answer did not arrive in time; call it before `note`.

        `Delay` has then risen by every cycle since: so it does whether it counts the misses in a row, and falls back with a
        reply, or all of a session, and does not. A number that it cannot have is counted: a higher one is a reply that is lost, a
        lower one is not (docs/rsi.md, section 5).

        Args:
            elapsed: Controller time since the telegram that was answered last [ns].
        """
        delay, before = telegram.delay, self._last_delay
        if delay == before and elapsed == self._cycle:
            return False
        if delay is None:
            self._counters["telegrams_without_delay"] += 1
            return False
        cycles = max(1, elapsed // self._cycle)
        missed = delay - before
        if missed > cycles or (missed < cycles and cycles - 1 not in (missed, delay)):
            self._counters["delay_irregular"] += 1
        return missed >= cycles

    def note(self, telegram: RobotTelegram) -> bool:
        """Take a telegram's poses and its count of late replies; return whether its ASPos is no longer the origin."""
        delay = telegram.delay
        if delay is not None and delay != self._last_delay:
            self._counters["late_replies"] += max(0, delay - self._last_delay)
            self._last_delay = delay
        if telegram.measured is None or telegram.setpoint is None:
            self._counters["telegrams_without_pose"] += 1
        if telegram.measured is None or not self.origin:
            return False
        self.measured = telegram.measured
        if telegram.setpoint is None or telegram.setpoint == self.origin or self._config.reference != "ASPos":
            return False
        self._counters["reference_drifts"] += 1
        return True

    def drift(self, setpoint: tuple[float, ...]) -> str:
        """Return in one sentence how far a programmed position [rad] is off the origin; "" within the start tolerance."""
        distance = distance_off(setpoint, self.origin, self._config)
        return distance and (
            f"{distance} off where ASPos was: a program of the controller moves the arm while a stream does; "
            "if ASPos contains the corrections, set reference to AIPos"
        )

    def renew_origin(self) -> None:
        """Where AIPos is the reference, take the present one; only while the correction is zero."""
        if self._config.reference == "AIPos" and self.measured:
            self.origin = self.measured

    def move_origin(self, setpoint: tuple[float, ...], position: tuple[float, ...]) -> tuple[float, ...]:
        """Take another programmed position [rad] as origin; return where `position` is then, with the same correction."""
        correction = [value - start for value, start in zip(position, self.origin)]
        self.origin = setpoint
        return tuple([start + value for start, value in zip(setpoint, correction)])

    def _elapsed(self, ipoc: int, source: object) -> int | None:
        if not self.alive:
            self.began = "the first telegram after silence"
            return None
        if source != self._source:
            self.began = "telegrams come from another source"
            self._counters["sessions_by_source"] += 1
            return None
        step = ipoc_step(self.ipoc, ipoc, self._timeout_ms)
        elapsed = step * IPOC_NS
        if elapsed != self._cycle:
            self.jump_ms = step
            if not 0 < elapsed <= self._timeout:
                self.began = f"IPOC jumped by {self.jump_ms} ms"
                self._counters["sessions_by_ipoc_jump"] += 1
                return None
        return elapsed

    def _sign_of_restart(self, telegram: RobotTelegram, correction: tuple[float, ...], moving: bool) -> str:
        """Return what shows that a program ended RSI and began it again faster than silence does; "" when nothing.

        The controller's correction is zero then. Only asked where cycles are missing, which a restart cannot do without. A program
        that moves the arm under a correction has AIPos = ASPos + correction.
        """
        config, measured, setpoint = self._config, telegram.measured, telegram.setpoint
        tolerances = config.start_tolerances
        if not self.origin or outside_tolerance(correction, (0.0,) * len(correction), tolerances) is None:
            return ""
        if measured is None and setpoint is None:
            # so a session of RSI up to 2.3 begins, but no pose says that this is one: it is not answered
            self._empty_telegrams = 1
            return "a telegram with nothing but IPOC"
        if config.reference != "ASPos" or measured is None or setpoint is None:
            return ""
        if moving and outside_tolerance(setpoint, self.origin, tolerances) is None:
            # at the beginning of a motion the servo may be no further yet
            return ""
        return "" if outside_tolerance(measured, setpoint, tolerances) is not None else "ASPos is where the arm stands"

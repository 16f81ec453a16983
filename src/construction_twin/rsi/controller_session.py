"""The controller's side of the gateway: which telegrams count, when a session begins, and where its corrections stand.

Standard library only; rad and ns.
"""

from __future__ import annotations

from collections import Counter

from construction_twin.limits import outside_tolerance
from construction_twin.rsi.codec import RobotTelegram
from construction_twin.rsi.config import GatewayConfig
from construction_twin.units import CYCLE_NS, NANOSECONDS

#: IPOC counts milliseconds (rsi.md, section 4).
IPOC_NS = 1_000_000
#: A controller that was heard this recently is alive, and its session its own [ns].
ALIVE = NANOSECONDS // 10


class ControllerSession:
    """One RSI session after the other.

    Parameters
    ----------
    config : GatewayConfig
    counters : Counter
        The gateway's; what is noticed here is counted there.
    """

    def __init__(self, config: GatewayConfig, counters: Counter[str]):
        self._config = config
        self._counters = counters
        self._timeout = round(config.timeout * NANOSECONDS)
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
        """Tell whether the network brought a telegram twice, or behind a newer one: it was answered, or it is too late to."""
        behind = (self.ipoc - ipoc) * IPOC_NS
        return self.alive and 0 <= behind <= self._timeout and source == self._source

    def is_silent(self, now: int) -> bool:
        """Tell whether the controller has been silent for its timeout."""
        return self.alive and now - self.heard_at > self._timeout

    def hear(self, ipoc: int, source: object, now: int) -> int | None:
        """Take a telegram's IPOC; return the controller time since the last one [ns], None when another session begins."""
        elapsed = self._elapsed(ipoc, source)
        self.ipoc, self._source, self.heard_at = ipoc, source, now
        return elapsed

    def begin(self, telegram: RobotTelegram) -> None:
        """Begin a session with its first telegram."""
        self.alive = True
        self.origin = ()
        # a Delay on the first packet belongs to the session's start, before anybody could answer
        self._last_delay = telegram.delay or 0
        self._empty_telegrams = 0
        self._counters["rsi_sessions"] += 1

    def end(self) -> None:
        """End the session."""
        self.alive = False
        self.origin = self.measured = ()

    def find_origin(self, telegram: RobotTelegram) -> str:
        """Take the origin from a telegram; where that is impossible it stays unknown.

        Returns
        -------
        reason : str
            Why this session must not be answered; "" when it may be.
        """
        if telegram.measured is None and telegram.setpoint is None and not self._empty_telegrams:
            # RSI up to 2.3 opens a session with a telegram that holds only IPOC (rsi.md, section 2)
            self._empty_telegrams += 1
            return ""
        if telegram.measured is None or telegram.setpoint is None:
            return (
                "telegrams lack AIPos or ASPos, so nobody can tell where the correction stands: not answering; declare DEF_AIPos "
                "and DEF_ASPos in the Ethernet XML"
            )
        off = outside_tolerance(telegram.measured, telegram.setpoint, self._config.start_tolerances)
        if off is not None:
            unit = "m" if self._config.axes[off] in self._config.linear else "rad"
            distance = telegram.measured[off] - telegram.setpoint[off]
            return (
                f"{self._config.axes[off]} is already {distance:.6f} {unit} off its programmed "
                "position: joined a running session, not answering; it times out, then start the program again"
            )
        self.origin = telegram.setpoint if self._config.reference == "ASPos" else telegram.measured
        return ""

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
        elapsed = (ipoc - self.ipoc) * IPOC_NS
        if elapsed != CYCLE_NS:
            self.jump_ms = ipoc - self.ipoc
            if not 0 < elapsed <= self._timeout:
                self.began = f"IPOC jumped by {self.jump_ms} ms"
                self._counters["sessions_by_ipoc_jump"] += 1
                return None
            self._counters["ipoc_steps_irregular"] += 1
        return elapsed

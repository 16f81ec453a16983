"""The speed limit that the gateway enforces. It has a deadline, and a grace period in which the executor slows down first.

Pure: time is an argument [ns]. Standard library only.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from construction_twin.core import speed_limit
from construction_twin.core.units import NANOSECONDS
from construction_twin.gateway.config import GatewayConfig
from construction_twin.mqtt.messages import Control, message_number

#: Limits that are remembered inside the grace; with more of them the oldest, which are the higher ones, count no longer.
REMEMBERED = 64


@dataclass(frozen=True, slots=True)
class _Given:
    """A fraction of the velocity limits, and since when it was given [ns]."""

    since: int
    fraction: float


class EnforcedSpeedLimit:
    """The fraction of the velocity limits at which the arm may move.

    It is optional. Once one was given, silence for longer than the deadline counts as the fraction for silence, or as the
    last limit where that was lower, because a lost source must not speed the arm up. Both outlive command sessions, otherwise
    arming anew would lift the limit.

    A lowered limit is enforced a grace after it came, a raised one at once: in force is the highest of those that were given within
    the grace. A sender that obeys has slowed down by then.

    The messages of a session are numbered, and an old one does nothing: with a recording of a high limit among those of today the
    low one would never come into force.
    """

    def __init__(self, config: GatewayConfig):
        self._source = speed_limit.SpeedLimit(config.speed_limit_deadline, config.speed_limit_silent)
        self._grace = round(config.speed_limit_grace * NANOSECONDS)
        #: The fraction given last, that for silence included; 1 before the first one.
        self.given = 1.0
        #: Who gave it: "none", a session id, or "silence".
        self.source = "none"
        #: The fraction in force.
        self.fraction = 1.0
        # session and number of the last message that was taken
        self._numbered: tuple[str, int] = ("", -1)
        # fractions fall from left to right, so the first is the highest
        self._recent: deque[_Given] = deque(maxlen=REMEMBERED)

    @staticmethod
    def refusal(control: Control, session: str) -> str:
        """Return why a `speed_limit` message does not count while `session` is armed; "" when it does."""
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
        """Return whether this message (one without a `refusal`) or a later one of its session came before: a copy, a recording."""
        number = message_number(control.id)
        session, last = self._numbered
        if number is None or (control.session == session and number <= last):
            return True
        self._numbered = control.session, number
        return False

    def give(self, fraction: float, session: str, now: int) -> bool:
        """Take a limit, 0 to 1, from a session; return whether it, or who gave it, is another than before."""
        self._source.hear(fraction, session, now)
        news = (fraction, session) != (self.given, self.source)
        self.source = session
        self._take(fraction, now)
        return news

    def poll(self, now: int) -> bool:
        """Notice silence, and what has come into force; return whether the source has just fallen silent."""
        recent = self._recent
        if not recent:
            return False
        silent = self.source != "silence" and self._source.is_silent(now)
        if silent:
            self.source = "silence"
            self._take(self._source.fraction_when_silent, now)
        while len(recent) > 1 and now - recent[1].since >= self._grace:
            recent.popleft()
        self.fraction = recent[0].fraction
        return silent

    def _take(self, fraction: float, now: int) -> None:
        self.given = fraction
        recent = self._recent
        if not recent:
            # before the first one there was none
            recent.append(_Given(now, 1.0))
        if fraction == recent[-1].fraction:
            return
        since = now
        while recent and recent[-1].fraction <= fraction:
            # what was lower is no higher than this: the grace began there
            since = recent.pop().since
        recent.append(_Given(since, fraction))

    def report(self) -> dict:
        """Return what the status says: the fraction in force, the one given last, and by whom."""
        return {"share": self.fraction, "given": self.given, "source": self.source}

"""How an RSI session begins: what telegrams must tell, where corrections stand, and what shows that RSI was switched on anew.

Standard library only; rad.
"""

from __future__ import annotations

from construction_twin.controller.port import Setup
from construction_twin.controller.telegram import Telegram
from construction_twin.core.limits import distance_off, outside_tolerance
from construction_twin.core.sentences import Sentence
from construction_twin.rsi.layout import RsiLayout


class RsiSessionRules:
    """One RSI session after the other, see `SessionRules`."""

    drifted = "gateway.rsi.drifted"

    def __init__(self, setup: Setup[RsiLayout]):
        self.follows = setup.reference == "ASPos"
        self._limits = setup.limits
        self._tolerances = setup.start_tolerances
        self._empty_telegrams = 0

    def begin(self) -> None:
        """Forget the session before."""
        self._empty_telegrams = 0

    def origin(self, telegram: Telegram) -> tuple[tuple[float, ...], str]:
        """Return ASPos, or by option AIPos, and why the session must not be answered."""
        measured, setpoint = telegram.measured, telegram.setpoint
        if measured is None and setpoint is None and not self._empty_telegrams:
            # RSI up to 2.3 opens a session with a telegram that holds only IPOC (docs/rsi.md, section 2)
            self._empty_telegrams += 1
            return (), ""
        if measured is None or setpoint is None:
            return (), Sentence("gateway.rsi.no_pose")
        if telegram.missed is None:
            return (), Sentence("gateway.rsi.no_delay")
        distance = distance_off(measured, setpoint, self._limits, self._tolerances)
        if distance:
            return (), Sentence("gateway.rsi.joined", distance=distance)
        return setpoint if self.follows else measured, ""

    def restarted(
        self, telegram: Telegram, origin: tuple[float, ...], correction: tuple[float, ...], moving: bool
    ) -> str:
        """Return what shows that a program ended RSI and began it again faster than silence does; "" when nothing.

        The controller's correction is zero then. A program that moves the arm under a correction has AIPos = ASPos + correction.
        """
        measured, setpoint, tolerances = telegram.measured, telegram.setpoint, self._tolerances
        if not origin or outside_tolerance(correction, (0.0,) * len(correction), tolerances) is None:
            return ""
        if measured is None and setpoint is None:
            # so a session of RSI up to 2.3 begins, but no pose says that this is one: it is not answered
            self._empty_telegrams = 1
            return Sentence("gateway.rsi.only_ipoc")
        if not self.follows or measured is None or setpoint is None:
            return ""
        if moving and outside_tolerance(setpoint, origin, tolerances) is None:
            # at the beginning of a motion the servo may be no further yet
            return ""
        elsewhere = outside_tolerance(measured, setpoint, tolerances) is not None
        return "" if elsewhere else Sentence("gateway.rsi.at_arm")

"""How an RSI session begins: what telegrams must tell, where corrections stand, and what shows that RSI was switched on anew.

Standard library only; rad.
"""

from __future__ import annotations

from construction_twin.controller.port import Setup
from construction_twin.controller.telegram import Telegram
from construction_twin.core.limits import distance_off, outside_tolerance
from construction_twin.rsi.layout import RsiLayout


class RsiSessionRules:
    """One RSI session after the other, see `SessionRules`."""

    drifted = (
        "off where ASPos was: a program of the controller moves the arm while a stream does; "
        "if ASPos contains the corrections, set reference to AIPos"
    )

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
            return (), (
                "telegrams lack AIPos or ASPos, so the present correction is unknown: not answering; declare DEF_AIPos "
                "and DEF_ASPos in the Ethernet XML"
            )
        if telegram.missed is None:
            return (), (
                "telegrams lack Delay, so a reply that does not arrive would go unnoticed, and the next one would be a step: not "
                "answering; declare DEF_Delay in the Ethernet XML"
            )
        distance = distance_off(measured, setpoint, self._limits, self._tolerances)
        if distance:
            return (), (
                f"{distance} off its programmed position already: joined a running session, not answering; "
                "it times out, then start the program again"
            )
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
            return "a telegram with nothing but IPOC"
        if not self.follows or measured is None or setpoint is None:
            return ""
        if moving and outside_tolerance(setpoint, origin, tolerances) is None:
            # at the beginning of a motion the servo may be no further yet
            return ""
        return "" if outside_tolerance(measured, setpoint, tolerances) is not None else "ASPos is where the arm stands"

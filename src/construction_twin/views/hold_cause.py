"""Why the arm holds, in a person's words: the sentence that stands first on every screen until the cause is mended. Pure."""

from __future__ import annotations

import time

from construction_twin.core.axis_name import axis_name
from construction_twin.core.reports import HoldReport
from construction_twin.core.sentences import Sentence, understood
from construction_twin.core.units import NANOSECONDS


def hold_cause(hold: HoldReport | None) -> str:
    """Return what keeps the gate closed, and since when, by this machine's time of day; "" while nothing does.

    A sentence of a key, which is in deg and mm.
    """
    if hold is None or not hold.cause:
        return ""
    since = time.strftime("%H:%M:%S", time.localtime(hold.since / NANOSECONDS))
    found = understood(hold.cause)
    if found is None or found.key != "reason.gate.differs":
        return Sentence("reason.holds.because", reason=found or hold.cause, since=since)
    values = {**found.values, "joint": axis_name(str(found.values["joint"]))}
    return Sentence("reason.holds.differs", **values, since=since)

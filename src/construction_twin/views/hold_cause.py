"""Why the arm holds: the sentence that stands first on every screen until the cause is mended. Pure."""

from __future__ import annotations

import time

from construction_twin.core.reports import HoldReport
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS


def hold_cause(hold: HoldReport | None) -> str:
    """Return what keeps the gate closed, and since when, by this machine's time of day; "" while nothing does."""
    if hold is None or not hold.cause:
        return ""
    since = time.strftime("%H:%M:%S", time.localtime(hold.since / NANOSECONDS))
    return Sentence("{reason}, since {since}", reason=hold.cause, since=since)

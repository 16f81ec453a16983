"""Why the arm holds, in a person's words: the sentence that stands first on every screen until the cause is mended. Pure."""

from __future__ import annotations

import time
from typing import cast

from construction_twin.core.reports import HoldReport
from construction_twin.core.sentences import Quantity, Sentence, understood
from construction_twin.core.units import NANOSECONDS, axis_name, from_people, to_people


def hold_cause(hold: HoldReport | None) -> str:
    """Return what keeps the gate closed, and since when, by this machine's time of day; "" while nothing does.

    A `Sentence`, which is in deg and mm.
    """
    if hold is None or not hold.cause:
        return ""
    since = time.strftime("%H:%M:%S", time.localtime(hold.since / NANOSECONDS))
    found = understood(hold.cause)
    if found is None or found.key != "reason.gate.differs":
        return Sentence("{reason}, since {since}", reason=found or hold.cause, since=since)
    difference, threshold = (cast(Quantity, found.values[name]) for name in ("difference", "threshold"))
    return Sentence(
        "{joint} is {difference:.3} from the twin, {threshold:.3} allowed, since {since}",
        joint=axis_name(str(found.values["joint"])),
        difference=_above(difference, threshold),
        threshold=threshold,
        since=since,
    )


def _above(difference: Quantity, threshold: Quantity) -> Quantity:
    """Return a difference that is shown as more than its threshold, with the sentence's three decimals of deg or mm."""
    (shown, unit), (allowed, _) = (to_people(each.value, each.unit) for each in (difference, threshold))
    if round(shown, 3) > round(allowed, 3):
        return difference
    return Quantity(*from_people(round(allowed, 3) + 0.001, unit))

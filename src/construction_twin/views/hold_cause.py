"""Why the arm holds, in a person's words: the sentence that stands first on every screen until the cause is mended. Pure."""

from __future__ import annotations

import re
import time

from construction_twin.core.reports import HoldReport
from construction_twin.core.sentences import Sentence, understood
from construction_twin.core.units import NANOSECONDS

#: An axis as KUKA and ROS-Industrial name it.
_AXIS = re.compile(r"joint_([ae][1-9])")


def axis_name(joint: str) -> str:
    """Return what a person at the arm calls a joint: ``A3`` for ``joint_a3``; another name stays."""
    found = _AXIS.fullmatch(joint)
    return found[1].upper() if found else joint


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

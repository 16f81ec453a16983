"""Is the arm moved exactly as it was commanded? Gate and identification judge it by the same two numbers. Pure; ns."""

from __future__ import annotations

from construction_twin.core.units import NANOSECONDS

#: A playout that is slower or faster than its stream by more than one part in so many does not move the arm as commanded.
PACE = 20
#: What disturbs a motion shows for so long after it [ns]: by then a servo has forgotten it.
STEADY = NANOSECONDS // 5


def keeps_pace(advance: int, elapsed: int) -> bool:
    """Return whether a step through the stream, `advance`, was as long as its time, `elapsed`, but for what a clock drifts [ns]."""
    return abs(advance - elapsed) <= elapsed // PACE

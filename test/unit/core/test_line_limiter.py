"""At most one line of a log per kind and period; the next one says how many were left out."""

from __future__ import annotations

from construction_twin.core.rate_limit import LineLimiter
from construction_twin.core.units import NANOSECONDS


def test_a_flood_makes_one_line_per_second_which_counts_the_others():
    limiter = LineLimiter()
    notes = [limiter.admit("control", k * NANOSECONDS // 1000) for k in range(3001)]
    written = [(k, note) for k, note in enumerate(notes) if note is not None]
    assert written == [
        (0, ""),
        *((k, " (999 more like this since the last such line)") for k in (1000, 2000, 3000)),
    ]


def test_reasons_do_not_hide_each_other():
    limiter = LineLimiter()
    assert limiter.admit("control", 0) == ""
    assert limiter.admit("arm", 1) == "" and limiter.admit("control", 2) is None

"""The clock that a person's request is aged by: see `core.freshness`."""

from __future__ import annotations

import functools
import time
from pathlib import Path

from construction_twin.core.freshness import Moment

#: Another text after each start of the computer; the nodes of a robot run on one computer, and so read the same.
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


@functools.cache
def _origin() -> str:
    return _BOOT_ID.read_text(encoding="ascii")[:8]


def present() -> Moment:
    """Return the present moment. The clock counts from the computer's start, also while it sleeps, and cannot be set."""
    return Moment(_origin(), time.clock_gettime_ns(time.CLOCK_BOOTTIME))

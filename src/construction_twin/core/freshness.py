"""How old a person's request is: it repeats the newest moment of the robot that its screen had received.

A request may lie in a broker, in a socket or behind a disk until nobody looks any more. So what starts motion, or the work for it,
is void `LIFETIME` after that moment, read on a clock of the robot's computer that nobody sets: no tablet's clock is asked. That is
against delay, not against attackers. What stops, pauses or rejects needs no moment.
"""

from __future__ import annotations

import functools
import re
import time
from dataclasses import dataclass
from pathlib import Path

from construction_twin.core.errors import PayloadError
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS

#: A request is void so long after the moment that it repeats [ns]: 1 s for the oldest picture that the page shows as the present,
#: 1 s for a wireless network that sends twice again, 1 s for the record's disk. What was shown longer ago is not what is there.
LIFETIME = 3 * NANOSECONDS
#: As what a request that is older is counted, and the reason of its PayloadError.
TOO_OLD = "too_old"
#: A moment in text is whole milliseconds.
_MILLISECOND = NANOSECONDS // 1000
_TEXT = re.compile(r"([0-9a-f]{8})-([0-9]{1,15})")


@dataclass(frozen=True)
class Moment:
    """A moment [ns] since the start of the robot's computer; `origin`: 8 hexadecimal digits, others after each start."""

    origin: str
    at: int

    def __str__(self) -> str:
        return f"{self.origin}-{self.at // _MILLISECOND}"


def parse_moment(text: object) -> Moment:
    """Return the moment that a request repeats; PayloadError ``moment``."""
    found = _TEXT.fullmatch(text) if isinstance(text, str) else None
    if found is None:
        shown = "nothing" if text is None or text == "" else repr(text)[:60]
        raise PayloadError(
            "moment", f"found {shown} as moment; expected the text moment of the newest view, as it came"
        )
    return Moment(found[1], int(found[2]) * _MILLISECOND)


def staleness(seen: Moment, now: Moment) -> str:
    """Return why a request with the moment `seen` is void; "" while it is valid."""
    if seen.origin != now.origin:
        return Sentence("void: it repeats a moment of another computer, or of before this one was started; look again")
    age = (now.at - seen.at) / NANOSECONDS
    if age < 0.0:
        return Sentence(
            "void: it repeats a moment {ahead:.3f} s ahead, which no view has shown; look again", ahead=-age
        )
    oldest = LIFETIME / NANOSECONDS
    if now.at - seen.at > LIFETIME:
        return Sentence(
            "too old: it is of {age:.1f} s ago, after {oldest:g} s it is void; look again", age=age, oldest=oldest
        )
    return ""


def is_newer(seen: Moment, act: Moment | None) -> bool:
    """Return whether a shown moment is after an act, by the same clock; True without an act."""
    return act is None or (seen.origin == act.origin and seen.at > act.at)


#: Another text after each start of the computer; the nodes of a robot run on one computer, and so read the same.
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


@functools.cache
def _origin() -> str:
    return _BOOT_ID.read_text(encoding="ascii")[:8]


def present_moment() -> Moment:
    """Return the present moment, by a clock that runs from the computer's start, also while it sleeps."""
    return Moment(_origin(), time.clock_gettime_ns(time.CLOCK_BOOTTIME))

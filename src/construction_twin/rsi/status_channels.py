"""The optional channels by which a controller says why its arm may not move: `Mode`, `ProgStatus`, `OvPro`.

Somebody wires an object STATUS or OV_PRO to a channel of SEND and names it (docs/rsi.md, sections 2 and 9).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from construction_twin.core.sentences import Sentence, join_sentences
from construction_twin.rsi.telegram import is_number_in_bytes

#: Operating modes, as the STATUS object's type Mode_Op numbers them.
MODES = {1: "T1", 2: "T2", 3: "AUT", 4: "EXT"}
#: States of the robot interpreter, as its type ProState_R numbers them.
PROGRAM_STATES = {1: "FREE", 2: "RESET", 3: "ACTIVE", 4: "STOP", 5: "END"}
#: The channels' names, and what attribute a dotted TAG has: `ProgStatus.S` would be the submit interpreter's.
NAMES = ("Mode", "ProgStatus", "OvPro")
ATTRIBUTE = "R"

_MODE_SENTENCES = {
    1: Sentence("the controller is in T1: the arm moves only while enabling switch and start key are held, and slowly"),
    2: Sentence("the controller is in T2: the arm moves only while enabling switch and start key are held"),
}
_PROGRAM_SENTENCES = {
    1: Sentence("no program is selected on the controller (FREE): select and start the RSI program"),
    2: Sentence("the controller's program is at its beginning (RESET): start it"),
    4: Sentence("the controller's program is stopped (STOP): press start on the pendant"),
    5: Sentence("the controller's program has ended (END): reset and start it"),
}


@dataclass(frozen=True, slots=True)
class RsiStatus:
    """A controller's report on itself, see `MODES`, `PROGRAM_STATES`; override in percent. None: unknown."""

    mode: int | None = None
    program: int | None = None
    override: float | None = None

    def status_fields(self) -> dict[str, str | float]:
        """Return the known fields in words, with the sentence."""
        found: dict[str, str | float] = {}
        if self.mode is not None:
            found["mode"] = MODES.get(self.mode, f"number {self.mode}")
        if self.program is not None:
            found["program"] = PROGRAM_STATES.get(self.program, f"number {self.program}")
        if self.override is not None:
            found["override_percent"] = self.override
        return found | {"sentence": self.sentence} if found else {}

    @property
    def sentence(self) -> str:
        """See `ControllerStatus.sentence`."""
        parts = [_MODE_SENTENCES.get(self.mode or 0, ""), _PROGRAM_SENTENCES.get(self.program or 0, "")]
        if self.override is not None and self.override < 100.0:
            parts.append(
                Sentence(
                    "the override is {percent:g} %: the controller's own motions are slower by that, corrections are not",
                    percent=self.override,
                )
                if self.override > 0.0
                else Sentence("the override is 0 %: whether corrections act then is not known, set it to 100 %")
            )
        return join_sentences(*parts)


def status_channels(send: Sequence[str]) -> tuple[str, ...]:
    """Return the TAGs among those of an Ethernet XML's SEND that are optional channels, e.g. ``ProgStatus.R``, in order."""
    return tuple(tag for tag in send if _name_of(tag))


def _name_of(tag: str) -> str:
    """Return the channel of a TAG; "" for none."""
    name, dot, attribute = tag.partition(".")
    return name if name in NAMES and (not dot or attribute == ATTRIBUTE) else ""


class StatusReader:
    """Reads the optional channels (`status_channels`) of one Ethernet XML."""

    def __init__(self, channels: Sequence[str]):
        found: dict[str, Callable] = {_name_of(tag): _pattern(tag) for tag in channels}
        self._searches = [found.get(name) for name in NAMES]
        self._count = len(found)
        self._texts: list[bytes | None] = []
        self._status = RsiStatus()
        self._unreadable = 0

    def read(self, data: bytes) -> tuple[RsiStatus, int]:
        """Read a checked telegram's status, and how many channels are missing or no number of the kind."""
        texts = [None if search is None else _text(search(data)) for search in self._searches]
        if texts != self._texts:
            # the same for minutes
            self._texts = texts
            mode, program, override = [None if text is None else float(text) for text in texts]
            is_percentage = override is not None and 0.0 <= override <= 100.0
            self._status = RsiStatus(_whole(mode), _whole(program), override if is_percentage else None)
            values = (self._status.mode, self._status.program, self._status.override)
            self._unreadable = self._count - sum(value is not None for value in values)
        return self._status, self._unreadable


def _pattern(tag: str) -> Callable:
    name, dot, attribute = tag.encode().partition(b".")
    if dot:
        return re.compile(rb"<%b\s(?:[^<>]*\s)?%b\s*=\s*[\"']([^\"'<>]{1,32})[\"']" % (name, attribute)).search
    return re.compile(rb"<%b\s*>\s*([^<>\s]{1,32})\s*</%b\s*>" % (name, name)).search


def _text(match: re.Match[bytes] | None) -> bytes | None:
    return match[1] if match is not None and is_number_in_bytes(match[1]) else None


def _whole(value: float | None) -> int | None:
    return int(value) if value is not None and value.is_integer() and 0 <= value < 1000 else None

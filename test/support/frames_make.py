"""A second make of controller, for tests: binary frames of a fixed length, absolute targets, a cycle of 8 ms, no tool.

A telegram is session, cycle, missed replies, and two positions per axis: where it is, and the target that it follows; a reply is
session, cycle, end, and a target per axis. Angles are float64 in rad. Cycles count from 0 in each session; as a stamp the session
stands above the time, so that another session never looks like a step.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from types import SimpleNamespace
from typing import ClassVar

from construction_twin.controller.last_resort import BareProtocol, LastResort
from construction_twin.controller.port import ControllerSide, Make, Reader, Terms
from construction_twin.controller.telegram import Reply, Telegram
from construction_twin.core.errors import TelegramError
from construction_twin.core.limits import distance_off

CYCLE_MS = 8
SESSION = 2**40
TELEGRAM_HEAD, REPLY_HEAD = struct.Struct("<4sIIH"), struct.Struct("<4sIIB")
ASKS, TELLS = b"FRMT", b"FRMR"


@dataclass(frozen=True)
class Frames:
    """The layout."""

    make: ClassVar[str] = "frames"
    port: int = 50_000
    expects_replies: bool = True
    stop: bool = True
    summary: ClassVar[str] = "binary frames"
    switched: ClassVar[tuple] = ()
    switched_holdon: ClassVar[tuple] = ()
    outputs: ClassVar[tuple] = ()
    inputs: ClassVar[tuple] = ()
    not_filled: ClassVar[tuple] = ()


#: It says nothing of itself.
NOTHING = SimpleNamespace(sentence="", status_fields=dict)


def stamp_of(session: int, cycle: int) -> int:
    return session * SESSION + cycle * CYCLE_MS


def counts_of(stamp: int) -> tuple[int, int]:
    return stamp // SESSION, stamp % SESSION // CYCLE_MS


def unpack(head: struct.Struct, magic: bytes, values: int, data: bytes) -> tuple:
    """Return what a frame holds; TelegramError for another length, another beginning, or a number that is none."""
    body = struct.Struct(f"{head.format}{values}d")
    if len(data) != body.size:
        raise TelegramError("size", f"frame of {len(data)} B; expected {body.size} B")
    found = body.unpack(data)
    if found[0] != magic:
        raise TelegramError("root", f"the frame begins with {found[0]!r}; expected {magic!r}")
    if not all(abs(value) < 1e3 for value in found[-values:]):
        raise TelegramError("number", f"the frame holds {found[-values:]}; expected angles")
    return found[1:]


def reader(setup) -> Reader:
    count = len(setup.axes)

    def parse(data: bytes) -> Telegram:
        session, cycle, missed, *values = unpack(TELEGRAM_HEAD, ASKS, 2 * count, data)
        return Telegram(stamp_of(session, cycle), tuple(values[:count]), tuple(values[count:]), missed)

    return Reader(parse)


def template(stop, switched=()) -> bytes:
    return b"\1" if stop else b"\0"


ENCODER = SimpleNamespace(
    template=template, encode=lambda target, stamp, stop=None, switched=(): fill(template(stop), tuple(target), stamp)
)


def fill(text: bytes, target: tuple[float, ...], stamp: int) -> bytes:
    return REPLY_HEAD.pack(TELLS, *counts_of(stamp), text[0]) + struct.pack(f"<{len(target)}d", *target)


class Rules:
    """A session tells its number: only its beginning has to be judged."""

    follows_setpoint = False
    drift_sentence, begin, restart_sign = str, (lambda self: None), (lambda *_: "")

    def __init__(self, setup):
        self._limits, self._tolerances = setup.limits, setup.start_tolerances

    def origin(self, telegram) -> tuple[tuple[float, ...], str]:
        off = distance_off(telegram.measured, telegram.setpoint, self._limits, self._tolerances)
        return ((), f"{off} off its target: joined a running session") if off else (telegram.measured, "")


def last_resort(setup) -> LastResort:
    size = TELEGRAM_HEAD.size + 16 * len(setup.axes)

    def read(data: bytes):
        return TELEGRAM_HEAD.unpack_from(data) if len(data) == size and data.startswith(ASKS) else None

    bare = BareProtocol(
        lambda data: (found := read(data)) and stamp_of(*found[1:3]),
        lambda data: (found := read(data)) and found[3],
        fill,
        (b"\0", b"\1"),
    )
    return LastResort(setup.limits, bare, setup.cycle)


def controller_side(layout, axes, units, precision) -> ControllerSide:
    count = len(axes)

    def encode(stamp, measured, followed, *more) -> bytes:
        missed = more[2]
        head = TELEGRAM_HEAD.pack(ASKS, *counts_of(stamp), missed)
        return head + struct.pack(f"<{2 * count}d", *measured, *followed)

    def decode(data: bytes) -> Reply:
        session, cycle, stop, *target = unpack(REPLY_HEAD, TELLS, count, data)
        return Reply(stamp_of(session, cycle), tuple(target), bool(stop))

    return ControllerSide(encode, decode, (True,) * count, False, lambda told: NOTHING)


MAKE = Make(
    name=Frames.make,
    absolute=True,
    cycles={CYCLE_MS: "8 ms"},
    terms=Terms("frames", "cycle", "read-only", "", "it ends", "it ended", "{}", "8 ms", "its time-out", "the frames"),
    no_status=NOTHING,
    plain=lambda axes: Frames(),
    read_layout=lambda document: Frames(**document),
    check=lambda setup: None,
    reader=reader,
    encoder=lambda setup: ENCODER,
    rules=Rules,
    last_resort=last_resort,
    check_axes=lambda layout, axes: None,
    controller_side=controller_side,
    tool_channels=lambda layout: (),
)

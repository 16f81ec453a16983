"""What an Ethernet XML fixes about the telegrams of one controller, and the units in which each axis appears in them.

Both ends are built from this: the gateway and the mock read it from the same file (`ethernet_xml`). Standard library only; the
values of an `AxisUnit` are the only place besides the codec where degrees and millimetres of the wire appear.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

#: The only RECEIVE channel without an axis that the gateway fills.
STOP = "Stop"
#: Axis names of RSI, six attributes per position block.
ROBOT_AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
EXTERNAL_AXES = ("E1", "E2", "E3", "E4", "E5", "E6")


@dataclass(frozen=True)
class RsiLayout:
    """The telegrams that an Ethernet XML declares.

    Attributes:
        sentype: SENTYPE: the `Type` of every reply.
        port: UDP port of the PC.
        onlysend: True: the controller expects no answers and takes no corrections.
        send: Blocks of a packet as they appear on the wire, in order, e.g. ``AIPos``; `IPOC` follows.
        receive: Channels of a reply in order: ``Stop``, or element and axis, e.g. ``AK.A1``; `IPOC` follows.
        holdon: Per channel of `receive`: True keeps the last value when a reply is missed, False falls to 0.
        not_filled: Digital outputs that the file declares, e.g. ``Out.01``; no reply carries them, so they stay as they are at
            RSI's start.
        switched: Channels of a reply that set a tool's outputs, without ``Set.``, in order: ``Enable`` and the outputs' names.
        switched_holdon: Per channel of `switched`, as `holdon`.
    """

    sentype: str
    port: int
    onlysend: bool
    send: tuple[str, ...]
    receive: tuple[str, ...]
    holdon: tuple[bool, ...]
    not_filled: tuple[str, ...] = ()
    switched: tuple[str, ...] = ()
    switched_holdon: tuple[bool, ...] = ()

    @classmethod
    def plain(cls, axes: Sequence[str]) -> RsiLayout:
        """Return the layout of the drivers' usual file: `AK` (and `EK`) only, for tests and simulation without a file."""
        receive = tuple(f"{default_element(axis)}.{axis}" for axis in axes)
        external = ("EIPos", "ESPos") if any(axis in EXTERNAL_AXES for axis in axes) else ()
        send = ("RIst", "RSol", "AIPos", "ASPos", *external, "Delay")
        return cls("ImFree", 49152, False, send, receive, (True,) * len(receive))

    @property
    def stop(self) -> bool:
        """True when replies carry the `Stop` element."""
        return STOP in self.receive


def default_element(axis: str) -> str:
    """Return the usual name of the element that carries an axis' correction."""
    return "EK" if axis in EXTERNAL_AXES else "AK"


@dataclass(frozen=True)
class AxisUnit:
    """How one axis is written in RSI: ``feedback = feedback_scale * unit * (sign * x + offset)``.

    `unit` is degrees per rad, or mm per m for a linear axis. A correction has no offset and a scale of its own: a controller
    that reports an axis in another unit need not take it in that unit (docs/rsi.md, section 11).

    Attributes:
        linear: True: x in m and mm on the wire; False: rad and deg.
        sign: +1 or -1.
        offset: [rad] or [m], on the controller's side.
        feedback_scale, correction_scale: Positive; 1 when the controller keeps to its own units.
    """

    linear: bool = False
    sign: int = 1
    offset: float = 0.0
    feedback_scale: float = 1.0
    correction_scale: float = 1.0

    @property
    def feedback_factor(self) -> float:
        """Wire units of a position per rad or m."""
        return self._per_unit * self.feedback_scale * self.sign

    @property
    def reading_factor(self) -> float:
        """Rad or m per wire unit of a position."""
        inverse = 1e-3 if self.linear else math.pi / 180.0
        return inverse / self.feedback_scale * self.sign

    @property
    def zero(self) -> float:
        """What is subtracted from a position after `reading_factor` [rad] or [m]."""
        return self.sign * self.offset

    @property
    def correction_factor(self) -> float:
        """Wire units of a correction per rad or m."""
        return self._per_unit * self.correction_scale * self.sign

    @property
    def correction_reading_factor(self) -> float:
        """Rad or m per wire unit of a correction."""
        inverse = 1e-3 if self.linear else math.pi / 180.0
        return inverse / self.correction_scale * self.sign

    @property
    def _per_unit(self) -> float:
        return 1e3 if self.linear else 180.0 / math.pi

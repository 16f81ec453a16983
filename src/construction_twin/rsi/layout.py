"""The telegrams of one controller, as an Ethernet XML declares them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from construction_twin.rsi.tool_channels import IN, OUT, names_of

#: The only RECEIVE channel without an axis that the gateway fills.
STOP = "Stop"
#: Axis names of RSI, six attributes per position block.
ROBOT_AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
EXTERNAL_AXES = ("E1", "E2", "E3", "E4", "E5", "E6")


@dataclass(frozen=True)
class RsiLayout:
    """The telegrams of an Ethernet XML.

    Attributes:
        sentype: The `Type` of every reply.
        onlysend: True: the controller expects no answers and takes no corrections.
        send: Blocks of a packet in order, e.g. ``AIPos``; `IPOC` follows.
        receive: Channels of a reply in order: ``Stop``, or element and axis, e.g. ``AK.A1``; `IPOC` follows.
        holdon: Per channel of `receive`: True keeps the last value when a reply is missed, False falls to 0.
        not_filled: Digital outputs, e.g. ``Out.01``, that no reply carries, so that they stay as they are at RSI's start.
        switched, switched_holdon: Channels of a reply that set a tool's outputs: ``Enable`` and the outputs' names.
    """

    make: ClassVar[str] = "rsi"

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
    def outputs(self) -> tuple[str, ...]:
        """Outputs of a tool in packets."""
        return names_of(OUT, self.send)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Inputs of a tool in packets."""
        return names_of(IN, self.send)

    @property
    def summary(self) -> str:
        """SENTYPE and what a reply carries, for people."""
        carried = "read-only" if self.onlysend else f"channels {', '.join(self.receive)}"
        return f"SENTYPE {self.sentype}, {carried}"

    @property
    def expects_replies(self) -> bool:
        """False with ONLYSEND."""
        return not self.onlysend

    @property
    def stop(self) -> bool:
        """True when replies carry the `Stop` element."""
        return STOP in self.receive


def default_element(axis: str) -> str:
    """Return the usual name of the element that carries an axis' correction."""
    return "EK" if axis in EXTERNAL_AXES else "AK"

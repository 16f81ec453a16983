"""The telegrams of one controller, as an Ethernet XML declares them.

The channels of a tool, <name> as in the tool file:

RECEIVE  Set.<output>  BOOL   what the output shall be
RECEIVE  Set.Enable    BOOL   1 once the PC knows the outputs; while it is 0, the RSI context leaves them alone
SEND     Out.<output>         the output as read back, 0 or 1
SEND     In.<input>           the input, 0 or 1
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import ClassVar

from construction_twin.controller.port import ENABLE, ToolReading, is_tool_name
from construction_twin.core.errors import ConfigurationError

#: Elements of the channels.
SET, OUT, IN = "Set", "Out", "In"

_ATTRIBUTE = re.compile(rb"([A-Za-z][A-Za-z0-9_]*)\s*=\s*[\"']([^\"'<>]*)[\"']").findall
_VALUES = {b"0": False, b"1": True}


def is_set_channel(tag: str) -> bool:
    """Return whether a TAG of RECEIVE sets an output of a tool, or is the channel that enables them."""
    element, _, name = tag.partition(".")
    return element == SET and (name == ENABLE or is_tool_name(name))


def names_of(element: str, send: Iterable[str]) -> tuple[str, ...]:
    """Return the outputs (``Out``) or inputs (``In``) of a tool that a controller sends, in the order of its SEND."""
    parts = (tag.partition(".") for tag in send)
    return tuple(name for found, _, name in parts if found == element and is_tool_name(name))


class ToolReader:
    """Reads a tool's outputs and inputs from checked telegrams, in the order of their names."""

    def __init__(self, outputs: Sequence[str], inputs: Sequence[str]):
        self._wanted = [(element, tuple(names)) for element, names in ((OUT, outputs), (IN, inputs)) if names]
        self._finds = [re.compile(rb"<%b\s([^<>]*)>" % element.encode()).findall for element, _ in self._wanted]
        self._texts: list[list[bytes]] | None = None
        self._reading: ToolReading | None = None

    def read(self, data: bytes) -> ToolReading | None:
        """Return a telegram's signals; None unless each channel is there once, as 0 or 1."""
        texts = [find(data) for find in self._finds]
        if texts != self._texts:
            # the same for minutes
            self._texts, self._reading = texts, self._parse(texts)
        return self._reading

    def _parse(self, texts: list[list[bytes]]) -> ToolReading | None:
        values: dict[str, tuple[bool, ...]] = {OUT: (), IN: ()}
        for (element, names), found in zip(self._wanted, texts):
            attributes = _ATTRIBUTE(found[0]) if len(found) == 1 else []
            by_name = {name.decode(): _VALUES.get(value) for name, value in attributes}
            read = [by_name.get(name) for name in names]
            if len(by_name) != len(attributes) or None in read:
                return None
            values[element] = tuple([value is True for value in read])
        return ToolReading(values[OUT], values[IN])


def set_element(switched: Sequence[str], values: Sequence[bool]) -> str:
    """Return the element of a reply that sets a tool's outputs; "" without any. Without values every channel is 0."""
    values = values or (False,) * len(switched)
    if len(values) != len(switched):
        raise ConfigurationError(SET, tuple(values), f"a value for each of {', '.join(switched)}")
    attributes = " ".join(f'{name}="{int(value)}"' for name, value in zip(switched, values))
    return f"<{SET} {attributes}/>" if attributes else ""


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

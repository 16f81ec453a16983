"""The channels of a tool in an Ethernet XML and in telegrams; <name> as in the tool file.

RECEIVE  Set.<output>  BOOL   what the output shall be
RECEIVE  Set.Enable    BOOL   1 once the PC knows the outputs; while it is 0, the RSI context leaves them alone
SEND     Out.<output>         the output as read back, 0 or 1
SEND     In.<input>           the input, 0 or 1
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from construction_twin.controller.tool import ENABLE, ToolReading, is_tool_name
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
        """Return a telegram's signals; None when a channel is missing, there twice, or neither 0 nor 1."""
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

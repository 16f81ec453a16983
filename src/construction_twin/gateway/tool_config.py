"""What the gateway must know about a tool: part of its configuration, and so of the hash. Standard library only."""

from __future__ import annotations

from dataclasses import dataclass

from construction_twin.core.errors import ConfigurationError, EthernetXmlError
from construction_twin.rsi.ethernet_xml import tool_channels
from construction_twin.rsi.layout import RsiLayout
from construction_twin.rsi.tool_channels import ENABLE, IN, OUT, SET, is_tool_name, names_of

#: What may become of an output when RSI ends or a reply is missed, and the HOLDON that says so.
HOLDON = {"keep": True, "off": False}


@dataclass(frozen=True)
class ToolOutput:
    """An output.

    Attributes:
        on_stop: ``keep`` or ``off``: what becomes of it when RSI ends or a reply is missed.
        opens: The value that lets go of a workpiece; None: neither does.
    """

    name: str
    on_stop: str
    opens: bool | None = None


@dataclass(frozen=True)
class GatewayTool:
    """A tool.

    Attributes:
        name: Of the tool file.
    """

    name: str
    outputs: tuple[ToolOutput, ...]
    inputs: tuple[str, ...]

    def __post_init__(self):
        names = [*(output.name for output in self.outputs), *self.inputs]
        for name in (self.name, *names):
            if not isinstance(name, str) or not is_tool_name(name):
                raise ConfigurationError("tool", name, "a name of small letters, digits and '_', at most 24")
        for kind, found in (("outputs", names[: len(self.outputs)]), ("inputs", list(self.inputs))):
            if not found or len(set(found)) != len(found):
                raise ConfigurationError(f"tool {kind}", found, "at least one, each once")
        for output in self.outputs:
            if output.on_stop not in HOLDON or output.opens not in (True, False, None):
                expected = "on_stop keep or off, opens true, false or nothing"
                raise ConfigurationError(f"tool output {output.name}", (output.on_stop, output.opens), expected)
            if output.on_stop == "off" and output.opens is False:
                expected = "on_stop keep, or opens true: one missed reply would drop the part"
                raise ConfigurationError(f"tool output {output.name}", (output.on_stop, output.opens), expected)

    @classmethod
    def of_document(cls, document: dict) -> GatewayTool:
        """Return the tool of a configuration file; TypeError or KeyError when it is none."""
        outputs = tuple(ToolOutput(**output) for output in document["outputs"])
        return cls(**document | {"outputs": outputs, "inputs": tuple(document["inputs"])})


def check_tool(tool: GatewayTool | None, layout: RsiLayout, where: str) -> None:
    """Check that the channels of an Ethernet XML are those of a tool, held as the tool file says.

    Args:
        tool: None: no tool is configured.
        where: Name of the Ethernet XML, for messages.

    Raises:
        EthernetXmlError: Naming the first channel that does not fit.
    """
    if tool is None:
        if layout.switched:
            expected = "no such channel, or the tool file that it belongs to (launch argument tool)"
            raise EthernetXmlError(where, f"RECEIVE {SET}.{layout.switched[0]}", "no tool", expected)
        return
    declared = {
        SET: tuple(name for name in layout.switched if name != ENABLE),
        OUT: names_of(OUT, layout.send),
        IN: names_of(IN, layout.send),
    }
    outputs = tuple(output.name for output in tool.outputs)
    for element, section, wanted in (
        (SET, "RECEIVE", outputs),
        (OUT, "SEND", outputs),
        (IN, "SEND", tool.inputs),
    ):
        if element == SET and layout.onlysend:
            continue
        missing = [name for name in wanted if name not in declared[element]]
        foreign = [name for name in declared[element] if name not in wanted]
        if missing or foreign:
            name = (missing or foreign)[0]
            expected = f"{element}.{', '.join(wanted)}, as the tool file of {tool.name} has them"
            raise EthernetXmlError(where, f"{section} {element}.{name}", None if missing else name, expected)
    holdon = dict(zip(layout.switched, layout.switched_holdon))
    for output in tool.outputs:
        if output.name in holdon and holdon[output.name] is not HOLDON[output.on_stop]:
            found = str(int(holdon[output.name]))
            expected = f'"{int(HOLDON[output.on_stop])}": the tool file of {tool.name} says on_stop: {output.on_stop}'
            raise EthernetXmlError(where, f"RECEIVE {SET}.{output.name} HOLDON", found, expected)


def has_hands(layout: RsiLayout) -> bool:
    """Return whether an Ethernet XML declares any channel of a tool; without them a tool file is a tool without hands."""
    return bool(tool_channels(layout))

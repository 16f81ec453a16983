"""Whether the channels of an Ethernet XML are those of a tool. Standard library only."""

from __future__ import annotations

from construction_twin.controller.tool import ENABLE, HOLDON, GatewayTool
from construction_twin.core.sentences import Sentence
from construction_twin.rsi.ethernet_xml_error import EthernetXmlError
from construction_twin.rsi.layout import RsiLayout
from construction_twin.rsi.tool_channels import IN, OUT, SET, names_of


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
            expected = Sentence("expected.xml.no_tool")
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
            expected = Sentence("expected.xml.as_tool_file", channels=f"{element}.{', '.join(wanted)}", tool=tool.name)
            raise EthernetXmlError(where, f"{section} {element}.{name}", None if missing else name, expected)
    holdon = dict(zip(layout.switched, layout.switched_holdon))
    for output in tool.outputs:
        if output.name in holdon and holdon[output.name] is not HOLDON[output.on_stop]:
            found = str(int(holdon[output.name]))
            expected = Sentence(
                "expected.xml.on_stop", holdon=int(HOLDON[output.on_stop]), tool=tool.name, on_stop=output.on_stop
            )
            raise EthernetXmlError(where, f"RECEIVE {SET}.{output.name} HOLDON", found, expected)

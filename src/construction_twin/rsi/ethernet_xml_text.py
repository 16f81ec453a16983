"""Writes the RSI Ethernet XML of an arm with any axes: what `ethernet_xml` reads. Standard library only."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from construction_twin.controller.tool import ENABLE
from construction_twin.rsi.layout import EXTERNAL_AXES, STOP, default_element
from construction_twin.rsi.tool_channels import IN, OUT, SET

#: Address of the PC and its UDP port, and the `Type` of replies; the user edits the address.
ADDRESS, PORT, SENTYPE = "192.168.1.10", 49152, "ImFree"
NOTICE = (
    "construction_twin. Written from published facts, NOT TRIED ON A CONTROLLER: "
    "check every value before use (docs/controller.md)."
)


def receive_channels(axes: Sequence[str], holdon: Mapping[str, bool] | None = None) -> list[tuple[str, str, int]]:
    """Return TAG, TYPE and HOLDON of a reply's channels, in the order of their INDX, which counts from 1.

    Args:
        axes: RSI axes of the arm.
        holdon: Outputs of the tool; True: it keeps its value when a reply is missed.
    """
    corrections = [(f"{default_element(axis)}.{axis}", "DOUBLE", 1) for axis in sorted(axes)]
    outputs = [(f"{SET}.{name}", "BOOL", int(held)) for name, held in (holdon or {}).items()]
    return [(STOP, "BOOL", 0), *corrections, *([(f"{SET}.{ENABLE}", "BOOL", 1)] if outputs else []), *outputs]


def send_channels(outputs: Sequence[str], inputs: Sequence[str]) -> list[str]:
    """Return the TAGs by which a tool is read, in the order of their INDX, which counts from 1."""
    return [*(f"{OUT}.{name}" for name in outputs), *(f"{IN}.{name}" for name in inputs)]


def ethernet_xml_text(
    axes: Sequence[str],
    receives: bool = True,
    holdon: Mapping[str, bool] | None = None,
    inputs: Sequence[str] = (),
) -> str:
    """Return the text of an Ethernet XML.

    Args:
        axes: RSI axes of the arm, e.g. ``A1``; each gets a correction channel, in the order of RSI.
        receives: False: the controller sends only and takes no corrections.
        holdon: Outputs of the tool; True: it keeps its value when a reply is missed.
        inputs: Of the tool.
    """
    ordered = sorted(axes)
    external = ["EIPos", "ESPos"] if any(axis in EXTERNAL_AXES for axis in ordered) else []
    channels = receive_channels(ordered, holdon)
    lines = [
        "<ROOT>",
        f"  <!-- {NOTICE} -->",
        "  <!-- Gateway and mock read this very file: give them the copy that is on the controller. -->",
        "  <CONFIG>",
        "    <!-- EDIT: address of the PC that runs rsi_gateway, in the RSI subnet -->",
        f"    <IP_NUMBER>{ADDRESS}</IP_NUMBER>",
        f"    <PORT>{PORT}</PORT>",
        f"    <SENTYPE>{SENTYPE}</SENTYPE>",
        f"    <ONLYSEND>{'FALSE' if receives else 'TRUE'}</ONLYSEND>",
        "  </CONFIG>",
        "  <SEND>",
        "    <ELEMENTS>",
        *(
            f'      <ELEMENT TAG="DEF_{name}" TYPE="DOUBLE" INDX="INTERNAL"/>'
            for name in ("RIst", "RSol", "AIPos", "ASPos", *external)
        ),
        '      <ELEMENT TAG="DEF_Delay" TYPE="LONG" INDX="INTERNAL"/>',
        *(
            f'      <ELEMENT TAG="{tag}" TYPE="BOOL" INDX="{index}"/>'
            for index, tag in enumerate(send_channels(list(holdon or ()), inputs), 1)
        ),
        "    </ELEMENTS>",
        "  </SEND>",
        "  <RECEIVE>",
        "    <ELEMENTS>",
    ]
    for index, (tag, kind, held) in enumerate(channels if receives else [], 1):
        lines.append(f'      <ELEMENT TAG="{tag}" TYPE="{kind}" INDX="{index}" HOLDON="{held}"/>')
    return "\n".join([*lines, "    </ELEMENTS>", "  </RECEIVE>", "</ROOT>"]) + "\n"

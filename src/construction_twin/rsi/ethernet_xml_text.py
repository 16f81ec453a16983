"""Writes the RSI Ethernet XML of an arm with any axes: what `ethernet_xml` reads. Standard library only."""

from __future__ import annotations

from collections.abc import Sequence

from construction_twin.rsi.layout import EXTERNAL_AXES, STOP, default_element

#: Address of the PC and its UDP port, and the `Type` of replies; the user edits the address.
ADDRESS, PORT, SENTYPE = "192.168.1.10", 49152, "ImFree"
NOTICE = (
    "construction_twin. Written from published facts, NOT TRIED ON A CONTROLLER: "
    "check every value before use (docs/controller.md)."
)


def ethernet_xml_text(axes: Sequence[str], receives: bool = True) -> str:
    """Return the text of an Ethernet XML.

    Parameters
    ----------
    axes : sequence of str
        RSI axes of the arm, e.g. ``A1``; each gets a correction channel, in the order of RSI.
    receives : bool, optional
        False: the controller sends only and takes no corrections.
    """
    ordered = sorted(axes)
    external = ["EIPos", "ESPos"] if any(axis in EXTERNAL_AXES for axis in ordered) else []
    channels = [(STOP, "BOOL", 0), *((f"{default_element(axis)}.{axis}", "DOUBLE", 1) for axis in ordered)]
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
        "    </ELEMENTS>",
        "  </SEND>",
        "  <RECEIVE>",
        "    <ELEMENTS>",
    ]
    for index, (tag, kind, holdon) in enumerate(channels if receives else [], 1):
        lines.append(f'      <ELEMENT TAG="{tag}" TYPE="{kind}" INDX="{index}" HOLDON="{holdon}"/>')
    return "\n".join([*lines, "    </ELEMENTS>", "  </RECEIVE>", "</ROOT>"]) + "\n"

"""Reads KUKA's RSI Ethernet XML, the file that a user copies to the controller: the one source of what stands in the telegrams.

<ROOT>
  <CONFIG> IP_NUMBER, PORT, SENTYPE, ONLYSEND </CONFIG>
  <SEND> <ELEMENTS> <ELEMENT TAG TYPE INDX/> ... </ELEMENTS> </SEND>
  <RECEIVE> <ELEMENTS> <ELEMENT TAG TYPE INDX HOLDON/> ... </ELEMENTS> </RECEIVE>
</ROOT>
"""

from __future__ import annotations

import ipaddress
import re
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from xml.etree import ElementTree

from construction_twin.controller.tool import ENABLE
from construction_twin.core.errors import ConfigurationError
from construction_twin.rsi.layout import EXTERNAL_AXES, ROBOT_AXES, STOP, RsiLayout, default_element
from construction_twin.rsi.tool_channels import IN, OUT, SET, is_set_channel, names_of


class EthernetXmlError(ConfigurationError):
    """An RSI Ethernet XML cannot be used.

    Attributes:
        element: Path or TAG of the element that does not fit, e.g. ``CONFIG/PORT`` or ``RECEIVE AK.A1 HOLDON``.
    """

    def __init__(self, where: str, element: str, value: object, expected: str):
        self.element = element
        super().__init__(f"{where}: {element}", value, expected)


#: A file of this kind is a few kB [bytes].
MAX_BYTES = 256 * 1024

#: What gateway and mock read of SEND, TYPE DOUBLE (docs/rsi.md, section 2).
_POSES = ("DEF_RIst", "DEF_RSol", "DEF_AIPos", "DEF_ASPos", "DEF_EIPos", "DEF_ESPos")
_TAG = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}(?:\.[A-Za-z0-9_]{1,31})?").fullmatch
#: A digital output of the controller, as the file of ros-industrial's driver declares eight of them (docs/rsi.md, section 3).
_OUTPUT = re.compile(r"Out\.[0-9]{2}").fullmatch


@dataclass(frozen=True)
class EthernetXml:
    """What an Ethernet XML says.

    Attributes:
        address: IP_NUMBER: where the controller sends to.
        layout: Everything about the telegrams; `send` has the wire names, without ``DEF_``.
    """

    address: str
    layout: RsiLayout


@dataclass(frozen=True)
class _Element:
    tag: str
    type: str
    index: str
    holdon: str


def load_ethernet_xml(path: str | Path) -> EthernetXml:
    """Read a file; EthernetXmlError when it is missing, too large or does not fit."""
    try:
        with open(path, "rb") as file:
            text = file.read(MAX_BYTES + 1).decode("utf-8-sig")
    except OSError as error:
        raise EthernetXmlError(str(path), "file", error.strerror, "a readable RSI Ethernet XML") from error
    except UnicodeDecodeError as error:
        raise EthernetXmlError(str(path), "file", str(error), "text in UTF-8") from error
    return read_ethernet_xml(text, str(path))


def read_ethernet_xml(text: str, where: str) -> EthernetXml:
    """Read the text of an Ethernet XML."""
    root = _document(text, where)
    sections = root.findall("CONFIG")
    if len(sections) != 1:
        raise EthernetXmlError(where, "CONFIG", f"{len(sections)} of them", "one")
    config = sections[0]
    protocol = config.findtext("PROTOCOL", "UDP")
    if protocol.strip().upper() != "UDP":
        raise EthernetXmlError(where, "CONFIG/PROTOCOL", protocol, "UDP or no such element: a KR C4 talks UDP only")
    onlysend = _text(config, "ONLYSEND", where, "(?i:TRUE|FALSE)", "TRUE or FALSE").upper() == "TRUE"
    letters = "a letter, then letters, digits, '_', '.' or '-'"
    sentype = _text(config, "SENTYPE", where, "[A-Za-z][A-Za-z0-9_.-]{0,63}", letters)
    send, receive = _elements(root, "SEND", where), _elements(root, "RECEIVE", where)
    if not send:
        raise EthernetXmlError(where, "SEND/ELEMENTS", None, "the elements that the controller sends")
    switched = [element for element in receive if is_set_channel(element.tag)]
    outputs = [element for element in receive if element.type == "BOOL" and _OUTPUT(element.tag)]
    filled = [element for element in receive if element not in switched and element not in outputs]
    layout = RsiLayout(
        sentype=sentype,
        port=_port(config, where),
        onlysend=onlysend,
        send=tuple(element.tag.removeprefix("DEF_") for element in send),
        receive=tuple(element.tag for element in filled),
        holdon=tuple(element.holdon == "1" for element in filled),
        not_filled=tuple(element.tag for element in outputs),
        switched=tuple(element.tag.removeprefix(f"{SET}.") for element in switched),
        switched_holdon=tuple(element.holdon == "1" for element in switched),
    )
    return EthernetXml(_address(config, where), layout)


def check_axes(layout: RsiLayout, axes: Sequence[str], where: str) -> None:
    """Check that the corrections of an Ethernet XML are those of a robot's axes, in one element per kind of axis."""
    if layout.onlysend:
        return
    elements: dict[str, str] = {}
    for channel in layout.receive:
        element, _, axis = channel.partition(".")
        if channel == STOP:
            continue
        if axis not in (*ROBOT_AXES, *EXTERNAL_AXES):
            expected = (
                "axis corrections (e.g. AK.A1), Stop, a tool's outputs (Set.Enable and e.g. Set.vacuum) and "
                "outputs of type BOOL (Out.01) only: no other channel is filled; remove it from the file"
            )
            raise EthernetXmlError(where, f"RECEIVE {channel}", channel, expected)
        if axis in elements:
            raise EthernetXmlError(where, f"RECEIVE {channel}", f"a second channel for {axis}", "one channel per axis")
        if axis not in axes:
            raise EthernetXmlError(where, f"RECEIVE {channel}", axis, f"the robot's axes {', '.join(axes)} only")
        elements[axis] = element
    for axis in axes:
        if axis not in elements:
            example = f"{default_element(axis)}.{axis}"
            raise EthernetXmlError(where, f"RECEIVE {example}", None, f"a correction channel for {axis}, TYPE DOUBLE")
    for group in (ROBOT_AXES, EXTERNAL_AXES):
        names = sorted({element for axis, element in elements.items() if axis in group})
        if len(names) > 1:
            expected = f"one element for all of {group[0]} to {group[-1]}"
            raise EthernetXmlError(where, f"RECEIVE {names[1]}", names, expected)


#: What the gateway reads of the position blocks, by DEF_; those of external axes where there are any.
_MEANING = {
    "AIPos": "the measured axes",
    "ASPos": "the pose that corrections are relative to",
    "EIPos": "the measured external axes",
    "ESPos": "the external axes' programmed position",
}


def check_gateway(layout: RsiLayout, axes: Sequence[str], where: str) -> None:
    """Check that the gateway can serve a controller with this Ethernet XML."""
    check_axes(layout, axes, where)
    external = any(axis in EXTERNAL_AXES for axis in axes)
    for block in _MEANING:
        if block not in layout.send and (external or block.startswith("A")):
            expected = f'TAG="DEF_{block}" INDX="INTERNAL": {_MEANING[block]}'
            raise EthernetXmlError(where, f"SEND DEF_{block}", None, expected)
    if "Delay" not in layout.send and not layout.onlysend:
        expected = (
            'TAG="DEF_Delay" TYPE="LONG" INDX="INTERNAL": the count of late replies; without it '
            "the reply after one that did not arrive would be a step"
        )
        raise EthernetXmlError(where, "SEND DEF_Delay", None, expected)
    for channel, holdon in zip(layout.receive, layout.holdon):
        if channel != STOP and not holdon and not layout.onlysend:
            expected = '"1": with "0" one missed reply commands a jump back to the start pose'
            raise EthernetXmlError(where, f"RECEIVE {channel} HOLDON", "0", expected)
    _check_switched(layout, where)


def _check_switched(layout: RsiLayout, where: str) -> None:
    """Refuse channels by which a tool's outputs could be changed before they are known, or unseen."""
    holdon = dict(zip(layout.switched, layout.switched_holdon))
    if not holdon:
        return
    if not holdon.get(ENABLE, False):
        declared = '"1"' if ENABLE in holdon else f'TAG="{SET}.{ENABLE}" TYPE="BOOL" HOLDON="1"'
        expected = (
            f"{declared}: until it is 1 the RSI context leaves the outputs as they are; without it RSI_ON "
            "itself may open a grip"
        )
        raise EthernetXmlError(where, f"RECEIVE {SET}.{ENABLE}", "HOLDON 0" if ENABLE in holdon else None, expected)
    read_back = names_of(OUT, layout.send)
    for name in layout.switched:
        if name != ENABLE and name not in read_back:
            expected = (
                f'TAG="{OUT}.{name}" in SEND, the output as DIGOUT reads it: what is not read back is not switched'
            )
            raise EthernetXmlError(where, f"RECEIVE {SET}.{name}", None, expected)


def tool_channels(layout: RsiLayout) -> tuple[str, ...]:
    """Return the TAGs of a tool that an Ethernet XML declares; none: a context without hands."""
    sent = (f"{element}.{name}" for element in (OUT, IN) for name in names_of(element, layout.send))
    return (*(f"{SET}.{name}" for name in layout.switched), *sent)


def controller_sends_to(path: str | Path, layout: RsiLayout) -> str:
    """Check the file that was copied to a controller against the gateway's layout; return its IP_NUMBER."""
    ethernet = load_ethernet_xml(path)
    for field in fields(RsiLayout):
        found, ours = getattr(ethernet.layout, field.name), getattr(layout, field.name)
        if found != ours:
            expected = f"{ours} as in the configuration; export it again from this file"
            raise EthernetXmlError(str(path), field.name, found, expected)
    return ethernet.address


def _document(text: str, where: str) -> ElementTree.Element:
    if len(text) > MAX_BYTES:
        raise EthernetXmlError(where, "file", f"more than {MAX_BYTES} characters", "an RSI Ethernet XML of a few kB")
    # that rules out entity expansion
    if "<!DOCTYPE" in text:
        raise EthernetXmlError(where, "file", "<!DOCTYPE", "a plain XML without document type")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise EthernetXmlError(where, "file", str(error), "well-formed XML") from error
    if root.tag != "ROOT":
        raise EthernetXmlError(where, "file", root.tag[:64], "the root element ROOT")
    return root


def _text(config: ElementTree.Element, name: str, where: str, pattern: str, expected: str) -> str:
    texts = [(element.text or "").strip() for element in config.findall(name)]
    if len(texts) != 1 or not texts[0]:
        raise EthernetXmlError(where, f"CONFIG/{name}", texts or None, "one, with a value")
    if not re.fullmatch(pattern, texts[0]):
        raise EthernetXmlError(where, f"CONFIG/{name}", texts[0], expected)
    return texts[0]


def _port(config: ElementTree.Element, where: str) -> int:
    expected = "a UDP port from 1 to 65535"
    port = int(_text(config, "PORT", where, "[0-9]{1,5}", expected))
    if not 0 < port < 65536:
        raise EthernetXmlError(where, "CONFIG/PORT", port, expected)
    return port


def _address(config: ElementTree.Element, where: str) -> str:
    expected = "the IPv4 address of the PC"
    text = _text(config, "IP_NUMBER", where, "[0-9.]+", expected)
    try:
        return str(ipaddress.IPv4Address(text))
    except ipaddress.AddressValueError as error:
        raise EthernetXmlError(where, "CONFIG/IP_NUMBER", text, expected) from error


def _elements(root: ElementTree.Element, direction: str, where: str) -> list[_Element]:
    elements: dict[str, _Element] = {}
    for entry in root.findall(f"{direction}/ELEMENTS/ELEMENT"):
        element = _Element(*(entry.get(name, "").strip() for name in ("TAG", "TYPE", "INDX", "HOLDON")))
        place = f"{direction} {element.tag[:64]}"
        if not _TAG(element.tag):
            expected = 'a TAG of letters, digits and "_", at most one "." inside'
            raise EthernetXmlError(where, place, element.tag, expected)
        if element.tag in elements:
            raise EthernetXmlError(where, place, "it is there twice", "each TAG once")
        if (wanted := _type_of(element.tag)) and element.type != wanted:
            raise EthernetXmlError(where, f"{place} TYPE", element.type, wanted)
        if element.tag.startswith("DEF_") != (element.index == "INTERNAL"):
            expected = "INTERNAL for DEF_ elements, and for no others"
            raise EthernetXmlError(where, f"{place} INDX", element.index, expected)
        if element.index != "INTERNAL" and element.index in (other.index for other in elements.values()):
            raise EthernetXmlError(where, f"{place} INDX", element.index, "a channel that no other element has")
        if direction == "RECEIVE" and element.holdon not in ("0", "1"):
            raise EthernetXmlError(where, f"{place} HOLDON", element.holdon, '"0" or "1"')
        elements[element.tag] = element
    return list(elements.values())


def _type_of(tag: str) -> str:
    """Return the TYPE of what gateway and controller read of each other: another, or another's INDX, moves another axis."""
    if tag == "DEF_Delay":
        return "LONG"
    if tag == STOP or is_set_channel(tag):
        return "BOOL"
    is_axis = tag.partition(".")[2] in (*ROBOT_AXES, *EXTERNAL_AXES)
    return "DOUBLE" if is_axis or tag in _POSES else ""

"""Reads KUKA's RSI Ethernet XML, the file that a user copies to the controller: the one source of what stands in the telegrams.

`read_ethernet_xml` asks what the controller asks of the file; the mock is built from its answer. `check_gateway` asks what
the gateway needs beyond that. Both say in one sentence which element does not fit and what was expected.

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
from construction_twin.rsi.layout import EXTERNAL_AXES, ROBOT_AXES, STOP, RsiLayout
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
#: INTERNAL elements of SEND that gateway and mock know, with their TYPE (docs/rsi.md, section 2).
INTERNAL = {
    "DEF_RIst": "DOUBLE", "DEF_RSol": "DOUBLE", "DEF_AIPos": "DOUBLE", "DEF_ASPos": "DOUBLE", "DEF_EIPos": "DOUBLE",
    "DEF_ESPos": "DOUBLE", "DEF_MACur": "DOUBLE", "DEF_Delay": "LONG",
}  # fmt: skip
TYPES = ("BOOL", "STRING", "LONG", "DOUBLE")

_TAG = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}(?:\.[A-Za-z0-9_]{1,31})?").fullmatch
#: A digital output of the controller, as the file of ros-industrial's driver declares eight of them (docs/rsi.md, section 3).
_OUTPUT = re.compile(r"Out\.[0-9]{2}").fullmatch
_GENERATOR_1 = re.compile(r"DEF_Tech\.[CT]1").fullmatch


@dataclass(frozen=True)
class EthernetXml:
    """What an Ethernet XML says.

    Attributes:
        address: IP_NUMBER: where the controller sends to.
        layout: Everything about the telegrams; `send` has the wire names, without ``DEF_``.
    """

    where: str
    address: str
    layout: RsiLayout
    text: str


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
            data = file.read(MAX_BYTES + 1)
        text = data.decode("utf-8-sig")
    except OSError as error:
        raise EthernetXmlError(str(path), "file", error.strerror, "a readable RSI Ethernet XML") from error
    except UnicodeDecodeError as error:
        raise EthernetXmlError(str(path), "file", str(error), "text in UTF-8") from error
    return read_ethernet_xml(text, str(path))


def read_ethernet_xml(text: str, where: str) -> EthernetXml:
    """Read the text of an Ethernet XML as the controller would."""
    root = _document(text, where)
    sections = root.findall("CONFIG")
    if len(sections) != 1:
        raise EthernetXmlError(where, "CONFIG", f"{len(sections)} of them", "one")
    config = sections[0]
    protocol = config.findtext("PROTOCOL")
    if protocol is not None and protocol.strip().upper() != "UDP":
        raise EthernetXmlError(where, "CONFIG/PROTOCOL", protocol, "UDP or no such element: a KR C4 talks UDP only")
    onlysend = _text(config, "ONLYSEND", where).upper()
    if onlysend not in ("TRUE", "FALSE"):
        raise EthernetXmlError(where, "CONFIG/ONLYSEND", onlysend, "TRUE or FALSE")
    sentype = _text(config, "SENTYPE", where)
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_.-]{0,63}", sentype):
        raise EthernetXmlError(where, "CONFIG/SENTYPE", sentype, "a letter, then letters, digits, '_', '.' or '-'")
    send = _elements(root, "SEND", where)
    receive = _elements(root, "RECEIVE", where)
    for element in send:
        _check_internal(element, where)
    for element in receive:
        _check_channel(element, where)
    switched = [element for element in receive if is_set_channel(element.tag)]
    filled = [
        element
        for element in receive
        if element not in switched and not (element.type == "BOOL" and _OUTPUT(element.tag))
    ]
    layout = RsiLayout(
        sentype=sentype,
        port=_port(config, where),
        onlysend=onlysend == "TRUE",
        send=tuple(element.tag.removeprefix("DEF_") for element in send),
        receive=tuple(element.tag for element in filled),
        holdon=tuple(element.holdon == "1" for element in filled),
        not_filled=tuple(element.tag for element in receive if element not in filled and element not in switched),
        switched=tuple(element.tag.removeprefix(f"{SET}.") for element in switched),
        switched_holdon=tuple(element.holdon == "1" for element in switched),
    )
    return EthernetXml(where, _address(config, where), layout, text)


def check_axes(layout: RsiLayout, axes: Sequence[str], where: str) -> None:
    """Check that the corrections of an Ethernet XML are those of a robot's axes, in one element per kind of axis."""
    if layout.onlysend:
        return
    elements: dict[str, str] = {}
    for channel in layout.receive:
        element, _, axis = channel.partition(".")
        if channel == STOP:
            continue
        if axis not in ROBOT_AXES and axis not in EXTERNAL_AXES:
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
            example = f"{'EK' if axis in EXTERNAL_AXES else 'AK'}.{axis}"
            raise EthernetXmlError(where, f"RECEIVE {example}", None, f"a correction channel for {axis}, TYPE DOUBLE")
    for group in (ROBOT_AXES, EXTERNAL_AXES):
        names = sorted({element for axis, element in elements.items() if axis in group})
        if len(names) > 1:
            raise EthernetXmlError(
                where, f"RECEIVE {names[1]}", names, f"one element for all of {group[0]} to {group[-1]}"
            )


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
    # refused before the parser sees them, also in a comment: that rules out entity expansion
    for markup in ("<!DOCTYPE", "<!ENTITY"):
        if markup in text or "\0" in text:
            raise EthernetXmlError(where, "file", markup, "a plain XML without document type, entities or NUL")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise EthernetXmlError(where, "file", str(error), "well-formed XML") from error
    if root.tag != "ROOT":
        raise EthernetXmlError(where, "file", root.tag[:64], "the root element ROOT")
    return root


def _text(config: ElementTree.Element, name: str, where: str) -> str:
    found = config.findall(name)
    texts = [(element.text or "").strip() for element in found]
    if len(texts) != 1 or not texts[0]:
        raise EthernetXmlError(
            where, f"CONFIG/{name}", [element.text for element in found] or None, "one, with a value"
        )
    return texts[0]


def _port(config: ElementTree.Element, where: str) -> int:
    text = _text(config, "PORT", where)
    if not re.fullmatch(r"[0-9]{1,5}", text) or not 0 < int(text) < 65536:
        raise EthernetXmlError(where, "CONFIG/PORT", text, "a UDP port from 1 to 65535")
    return int(text)


def _address(config: ElementTree.Element, where: str) -> str:
    text = _text(config, "IP_NUMBER", where)
    try:
        return str(ipaddress.IPv4Address(text))
    except ipaddress.AddressValueError as error:
        raise EthernetXmlError(where, "CONFIG/IP_NUMBER", text, "the IPv4 address of the PC") from error


def _elements(root: ElementTree.Element, direction: str, where: str) -> list[_Element]:
    section = root.find(direction)
    listed = () if section is None else section.findall("ELEMENTS/ELEMENT")
    elements: list[_Element] = []
    seen: set[str] = set()
    for entry in listed:
        element = _Element(*(entry.get(name, "").strip() for name in ("TAG", "TYPE", "INDX", "HOLDON")))
        place = f"{direction} {element.tag[:64]}"
        if not _TAG(element.tag):
            raise EthernetXmlError(
                where, place, element.tag, 'a TAG of letters, digits and "_", at most one "." inside'
            )
        if element.type not in TYPES:
            raise EthernetXmlError(where, f"{place} TYPE", element.type, f"one of {', '.join(TYPES)}")
        if element.tag in (known.tag for known in elements):
            raise EthernetXmlError(where, place, "it is there twice", "each TAG once")
        _check_index(element, place, seen, where)
        if direction == "RECEIVE" and element.holdon not in ("0", "1"):
            raise EthernetXmlError(where, f"{place} HOLDON", element.holdon, '"0" or "1"')
        elements.append(element)
    if direction == "SEND" and not elements:
        raise EthernetXmlError(where, "SEND/ELEMENTS", None, "the elements that the controller sends")
    return elements


def _check_index(element: _Element, place: str, seen: set[str], where: str) -> None:
    if element.index == "INTERNAL":
        return
    if not re.fullmatch(r"[1-9][0-9]?", element.index) or int(element.index) > 64:
        raise EthernetXmlError(where, f"{place} INDX", element.index, "INTERNAL or a channel from 1 to 64")
    if element.index in seen:
        raise EthernetXmlError(where, f"{place} INDX", element.index, "a channel that no other element has")
    seen.add(element.index)


def _check_internal(element: _Element, where: str) -> None:
    place = f"SEND {element.tag}"
    internal = element.index == "INTERNAL"
    if element.tag.startswith("DEF_") != internal:
        raise EthernetXmlError(where, f"{place} INDX", element.index, "INTERNAL for DEF_ elements, and for no others")
    expected = INTERNAL.get(element.tag)
    if expected and element.type != expected:
        raise EthernetXmlError(where, f"{place} TYPE", element.type, expected)


def _check_channel(element: _Element, where: str) -> None:
    place = f"RECEIVE {element.tag}"
    if _GENERATOR_1(element.tag):
        raise EthernetXmlError(
            where,
            place,
            element.tag,
            ("another function generator: RSI uses number 1 itself, and the ETHERNET object would report RSIBad"),
        )
    if element.tag.startswith("DEF_") != (element.index == "INTERNAL"):
        raise EthernetXmlError(where, f"{place} INDX", element.index, "INTERNAL for DEF_ elements, and for no others")
    axis = element.tag.partition(".")[2]
    expected = (
        "DOUBLE"
        if axis in ROBOT_AXES or axis in EXTERNAL_AXES
        else "BOOL"
        if element.tag == STOP or is_set_channel(element.tag)
        else element.type
    )
    if element.type != expected:
        raise EthernetXmlError(where, f"{place} TYPE", element.type, expected)

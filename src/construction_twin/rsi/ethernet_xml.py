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

from construction_twin.controller.port import ENABLE
from construction_twin.core.errors import ConfigurationError
from construction_twin.rsi.layout import (
    EXTERNAL_AXES,
    IN,
    OUT,
    ROBOT_AXES,
    SET,
    STOP,
    RsiLayout,
    default_element,
    is_set_channel,
)


class EthernetXmlError(ConfigurationError):
    """An RSI Ethernet XML cannot be used; `element`: what does not fit, e.g. ``CONFIG/PORT`` or ``RECEIVE AK.A1 HOLDON``."""

    def __init__(self, where: str, element: str, value: object, expected: str):
        self.element = element
        super().__init__(f"{where}: {element}", value, expected)


#: A file of this kind is a few kB [bytes].
MAX_BYTES = 256 * 1024

#: What gateway and mock read of SEND, TYPE DOUBLE (docs/rsi.md, section 2).
_POSES = ("DEF_RIst", "DEF_RSol", "DEF_AIPos", "DEF_ASPos", "DEF_EIPos", "DEF_ESPos")
#: What the gateway reads of the position blocks, by DEF_; those of external axes where there are any.
_MEANING = {
    "AIPos": "the measured axes",
    "ASPos": "the pose that corrections are relative to, by which it also shows whether a session was joined while it ran; a file "
    "without it, as kuka_drivers', is for corrections relative to AIPos (`reference: AIPos`): add it, on the controller too",
    "EIPos": "the measured external axes",
    "ESPos": "the external axes' programmed position",
}
#: Expected of PORT and IP_NUMBER.
_PORT, _ADDRESS = "a UDP port from 1 to 65535", "the IPv4 address of the PC"
_TAG = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}(?:\.[A-Za-z0-9_]{1,31})?").fullmatch
#: A digital output of the controller, as the file of ros-industrial's driver declares eight of them (docs/rsi.md, section 3).
_OUTPUT = re.compile(r"Out\.[0-9]{2}").fullmatch


@dataclass(frozen=True)
class EthernetXml:
    """IP_NUMBER of an Ethernet XML, and its telegrams; `send` has the wire names, without ``DEF_``."""

    address: str
    layout: RsiLayout


def _need(holds: object, where: str, element: str, found: object, expected: str) -> None:
    if not holds:
        raise EthernetXmlError(where, element, found, expected)


def load_ethernet_xml(path: str | Path) -> EthernetXml:
    """Read a file; EthernetXmlError when it is missing, too large or does not fit."""
    try:
        with open(path, "rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise EthernetXmlError(str(path), "file", error.strerror, "a readable RSI Ethernet XML") from error
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        # windows-1252 and its like, declared or not: what is read of a file is ASCII, the rest stands in comments
        text = data.decode("latin-1")
    return read_ethernet_xml(text, str(path))


def read_ethernet_xml(text: str, where: str) -> EthernetXml:
    """Read the text of an Ethernet XML."""
    root = _document(text, where)
    sections = root.findall("CONFIG")
    _need(len(sections) == 1, where, "CONFIG", f"{len(sections)} of them", "one")
    config = sections[0]
    protocol = config.findtext("PROTOCOL", "UDP")
    udp = "UDP or no such element: a KR C4 talks UDP only"
    _need(protocol.strip().upper() == "UDP", where, "CONFIG/PROTOCOL", protocol, udp)
    letters = "a letter, then letters, digits, '_', '.' or '-'"
    sentype = _text(config, "SENTYPE", where, "[A-Za-z][A-Za-z0-9_.-]{0,63}", letters)
    port = int(_text(config, "PORT", where, "[0-9]{1,5}", _PORT))
    _need(0 < port < 65536, where, "CONFIG/PORT", port, _PORT)
    address = _text(config, "IP_NUMBER", where, "[0-9.]+", _ADDRESS)
    try:
        ipaddress.IPv4Address(address)
    except ipaddress.AddressValueError as error:
        raise EthernetXmlError(where, "CONFIG/IP_NUMBER", address, _ADDRESS) from error
    send, receive = _elements(root, "SEND", where), _elements(root, "RECEIVE", where)
    _need(send, where, "SEND/ELEMENTS", None, "the elements that the controller sends")
    switched = {tag: holdon for tag, (_, holdon) in receive.items() if is_set_channel(tag)}
    outputs = [tag for tag, (type_, _) in receive.items() if type_ == "BOOL" and _OUTPUT(tag)]
    filled = {tag: holdon for tag, (_, holdon) in receive.items() if tag not in switched and tag not in outputs}
    layout = RsiLayout(
        sentype=sentype,
        port=port,
        onlysend=_text(config, "ONLYSEND", where, "(?i:TRUE|FALSE)", "TRUE or FALSE").upper() == "TRUE",
        send=tuple(tag.removeprefix("DEF_") for tag in send),
        receive=tuple(filled),
        holdon=tuple(holdon == "1" for holdon in filled.values()),
        not_filled=tuple(outputs),
        switched=tuple(tag.removeprefix(f"{SET}.") for tag in switched),
        switched_holdon=tuple(holdon == "1" for holdon in switched.values()),
    )
    return EthernetXml(address, layout)


def check_axes(layout: RsiLayout, axes: Sequence[str], where: str) -> None:
    """Check that the corrections of an Ethernet XML are those of a robot's axes, in one element per kind of axis."""
    if layout.onlysend:
        return
    elements: dict[str, str] = {}
    for channel in layout.receive:
        element, _, axis = channel.partition(".")
        if channel == STOP:
            continue
        expected = (
            "axis corrections (e.g. AK.A1), Stop, a tool's outputs (Set.Enable and e.g. Set.vacuum) and "
            "outputs of type BOOL (Out.01) only: no other channel is filled; remove it from the file"
        )
        _need(axis in (*ROBOT_AXES, *EXTERNAL_AXES), where, f"RECEIVE {channel}", channel, expected)
        twice = f"a second channel for {axis}"
        _need(axis not in elements, where, f"RECEIVE {channel}", twice, "one channel per axis")
        _need(axis in axes, where, f"RECEIVE {channel}", axis, f"the robot's axes {', '.join(axes)} only")
        elements[axis] = element
    for axis in axes:
        example = f"RECEIVE {default_element(axis)}.{axis}"
        _need(axis in elements, where, example, None, f"a correction channel for {axis}, TYPE DOUBLE")
    for group in (ROBOT_AXES, EXTERNAL_AXES):
        names = sorted({element for axis, element in elements.items() if axis in group})
        expected = f"one element for all of {group[0]} to {group[-1]}"
        _need(len(names) < 2, where, f"RECEIVE {''.join(names[1:2])}", names, expected)


def check_gateway(layout: RsiLayout, axes: Sequence[str], where: str) -> None:
    """Check that the gateway can serve a controller with this Ethernet XML."""
    check_axes(layout, axes, where)
    external = any(axis in EXTERNAL_AXES for axis in axes)
    for block, meaning in _MEANING.items():
        needed = external or block.startswith("A")
        expected = f'TAG="DEF_{block}" INDX="INTERNAL": {meaning}'
        _need(block in layout.send or not needed, where, f"SEND DEF_{block}", None, expected)
    expected = (
        'TAG="DEF_Delay" TYPE="LONG" INDX="INTERNAL": the count of late replies; without it '
        "the reply after one that did not arrive would be a step"
    )
    _need("Delay" in layout.send or layout.onlysend, where, "SEND DEF_Delay", None, expected)
    for channel, held in zip(layout.receive, layout.holdon):
        expected = '"1": with "0" one missed reply commands a jump back to the start pose'
        _need(held or channel == STOP or layout.onlysend, where, f"RECEIVE {channel} HOLDON", "0", expected)
    _check_switched(layout, where)


def _check_switched(layout: RsiLayout, where: str) -> None:
    """Refuse channels by which a tool's outputs could be changed before they are known, or unseen."""
    holdon = dict(zip(layout.switched, layout.switched_holdon))
    if not holdon:
        return
    declared = ENABLE in holdon
    expected = (
        f"""{'"1"' if declared else f'TAG="{SET}.{ENABLE}" TYPE="BOOL" HOLDON="1"'}: until it is 1 the RSI context leaves """
        "the outputs as they are; without it RSI_ON itself may open a grip"
    )
    _need(holdon.get(ENABLE), where, f"RECEIVE {SET}.{ENABLE}", "HOLDON 0" if declared else None, expected)
    for name in layout.switched:
        expected = f'TAG="{OUT}.{name}" in SEND, the output as DIGOUT reads it: what is not read back is not switched'
        _need(name == ENABLE or name in layout.outputs, where, f"RECEIVE {SET}.{name}", None, expected)


def tool_channels(layout: RsiLayout) -> tuple[str, ...]:
    """Return the TAGs of a tool in an Ethernet XML; none: a context without a tool."""
    sent = *(f"{OUT}.{name}" for name in layout.outputs), *(f"{IN}.{name}" for name in layout.inputs)
    return (*(f"{SET}.{name}" for name in layout.switched), *sent)


def matching_address(path: str | Path, layout: RsiLayout) -> str:
    """Return the IP_NUMBER of a controller's Ethernet XML; EthernetXmlError where its layout is another than the gateway's."""
    ethernet = load_ethernet_xml(path)
    for field in fields(RsiLayout):
        found, ours = getattr(ethernet.layout, field.name), getattr(layout, field.name)
        expected = f"{ours} as in the configuration; export it again from this file"
        _need(found == ours, str(path), field.name, found, expected)
    return ethernet.address


def _document(text: str, where: str) -> ElementTree.Element:
    _need(len(text) <= MAX_BYTES, where, "file", f"more than {MAX_BYTES} characters", "an RSI Ethernet XML of a few kB")
    # that rules out entity expansion
    _need("<!DOCTYPE" not in text, where, "file", "<!DOCTYPE", "a plain XML without document type")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise EthernetXmlError(where, "file", str(error), "well-formed XML") from error
    _need(root.tag == "ROOT", where, "file", root.tag[:64], "the root element ROOT")
    return root


def _text(config: ElementTree.Element, name: str, where: str, pattern: str, expected: str) -> str:
    texts = [(element.text or "").strip() for element in config.findall(name)]
    _need(len(texts) == 1 and texts[0], where, f"CONFIG/{name}", texts or None, "one, with a value")
    _need(re.fullmatch(pattern, texts[0]), where, f"CONFIG/{name}", texts[0], expected)
    return texts[0]


def _elements(root: ElementTree.Element, direction: str, where: str) -> dict[str, tuple[str, str]]:
    """Return TYPE and HOLDON of the elements of a direction by their TAGs, in order."""
    elements: dict[str, tuple[str, str]] = {}
    taken: set[str] = set()
    for entry in root.findall(f"{direction}/ELEMENTS/ELEMENT"):
        tag, type_, index, holdon = (entry.get(name, "").strip() for name in ("TAG", "TYPE", "INDX", "HOLDON"))
        place, internal = f"{direction} {tag[:64]}", index == "INTERNAL"
        _need(_TAG(tag), where, place, tag, 'a TAG of letters, digits and "_", at most one "." inside')
        _need(tag not in elements, where, place, "it is there twice", "each TAG once")
        wanted = _type_of(tag)
        _need(type_ == wanted or not wanted, where, f"{place} TYPE", type_, wanted)
        expected = "INTERNAL for DEF_ elements, and for no others"
        _need(tag.startswith("DEF_") == internal, where, f"{place} INDX", index, expected)
        _need(internal or index not in taken, where, f"{place} INDX", index, "a channel that no other element has")
        taken.add(index)
        held = direction == "SEND" or holdon in ("0", "1")
        _need(held, where, f"{place} HOLDON", holdon, '"0" or "1"')
        elements[tag] = type_, holdon
    return elements


def _type_of(tag: str) -> str:
    """Return the required TYPE of a TAG that gateway and controller read; "" for any."""
    if tag == "DEF_Delay":
        return "LONG"
    if tag == STOP or is_set_channel(tag):
        return "BOOL"
    is_axis = tag.partition(".")[2] in (*ROBOT_AXES, *EXTERNAL_AXES)
    return "DOUBLE" if is_axis or tag in _POSES else ""

"""RSI telegrams as values, and what both directions share: strict reading of XML; names, channels and units.

A refused telegram raises `TelegramError` with one of these reasons: ``size``, ``encoding`` (not ASCII text), ``markup``
(declaration of types, entity, comment, processing instruction), ``xml`` (not well-formed), ``root``, ``sentype``, ``ipoc``,
``element`` (missing or twice), ``attribute`` (missing), ``number`` (not a finite decimal). What a controller sends may begin with
an XML declaration and have exponents; what it reads may not (docs/rsi.md, section 3).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from xml.etree import ElementTree

from construction_twin.controller.telegram import AxisUnit
from construction_twin.core.errors import TelegramError
from construction_twin.core.network import MAX_TELEGRAM
from construction_twin.rsi.layout import default_element

#: Matches fixed notation without exponent, infinity, underscore or white space; the digit limits keep every match finite.
_FIXED = r"[+-]?[0-9]{1,15}(?:\.[0-9]{1,32})?"
_is_fixed = re.compile(_FIXED).fullmatch
is_fixed_in_bytes = re.compile(_FIXED.encode()).fullmatch
#: The same with an exponent below 100 as well: every match is still finite. It takes longer, so it is asked second.
_NUMBER = _FIXED + r"(?:[eE](?:-[0-9]{1,3}|\+?0?[0-9]{1,2}))?"
is_number = re.compile(_NUMBER).fullmatch
is_number_in_bytes = re.compile(_NUMBER.encode()).fullmatch
#: An XML declaration that ASCII text cannot contradict.
_SPACE = r"[ \t\r\n]"
_DECLARATION = re.compile(
    rf"""<\?xml{_SPACE}+version{_SPACE}*={_SPACE}*(?:"1\.[0-9]"|'1\.[0-9]')"""
    rf"""(?:{_SPACE}+encoding{_SPACE}*={_SPACE}*(["'])(?i:utf-?8|(?:us-)?ascii|iso-8859-[0-9]{{1,2}}|windows-125[0-9])\1)?"""
    rf"""(?:{_SPACE}+standalone{_SPACE}*={_SPACE}*(?:"(?:yes|no)"|'(?:yes|no)'))?{_SPACE}*\?>{_SPACE}*""".encode()
).match
_COUNT = re.compile(r"[0-9]{1,20}").fullmatch
_UINT64_MAX = 2**64 - 1


def without_declaration(data: bytes) -> bytes:
    """Strip a leading XML declaration."""
    declared = _DECLARATION(data) if data.startswith(b"<?") and len(data) <= MAX_TELEGRAM else None
    return data[declared.end() :] if declared else data


def read_document(data: bytes, root_tag: str) -> ElementTree.Element:
    """Return the root of a telegram; TelegramError unless it is this document as XML of plain text and permitted size."""
    if not 0 < len(data) <= MAX_TELEGRAM:
        raise TelegramError("size", f"telegram of {len(data)} B; expected 1 to {MAX_TELEGRAM} B")
    # Without NUL, because "<" followed by NUL makes the parser read UTF-16, in which markup looks different from below.
    if not data.isascii() or b"\0" in data:
        raise TelegramError("encoding", "telegram holds bytes that are not ASCII text")
    # No controller sends any; refusing them before the parser sees them rules out entity expansion.
    if b"<!" in data or b"<?" in data:
        raise TelegramError("markup", "telegram holds a declaration, comment or processing instruction")
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as error:
        raise TelegramError("xml", f"telegram is not well-formed: {error}") from error
    if root.tag != root_tag:
        raise TelegramError("root", f"the telegram's root is {root.tag[:64]!r}; expected {root_tag}")
    return root


def find_children(root: ElementTree.Element, wanted: frozenset[str]) -> dict[str, ElementTree.Element]:
    """Return the wanted elements by name; ignore others, refuse doubles."""
    found = {}
    for child in root:
        tag = child.tag
        if tag in wanted:
            if tag in found:
                raise TelegramError("ipoc" if tag == "IPOC" else "element", f"the telegram has {tag} twice")
            found[tag] = child
    return found


def read_ipoc(found: dict[str, ElementTree.Element]) -> int:
    """Return the telegram's IPOC; TelegramError (``ipoc``) without one."""
    element = found.get("IPOC")
    if element is None:
        raise TelegramError("ipoc", "the telegram has no IPOC")
    if len(element):
        raise TelegramError("ipoc", "IPOC holds elements; expected a number")
    return read_count(element.text, "IPOC", "ipoc")


def read_count(text: str | None, name: str, reason: str) -> int:
    """Return a whole number of at most 64 bits."""
    if text is None or not _COUNT(text) or int(text) > _UINT64_MAX:
        shown = text if text is None else text[:32]
        raise TelegramError(reason, f"{name} is {shown!r}; expected a whole number from 0 to {_UINT64_MAX}")
    return int(text)


def read_number(element: ElementTree.Element, attribute: str, exponent: bool = False) -> float:
    """Return an attribute that is a decimal number; `exponent` says whether it may have one."""
    text = element.get(attribute)
    if text is None:
        raise TelegramError("attribute", f"{element.tag} has no {attribute}")
    if not (is_number if exponent else _is_fixed)(text):
        expected = "a decimal number" if exponent else "a plain decimal number"
        raise TelegramError("number", f"{element.tag} {attribute} is {text[:32]!r}; expected {expected}")
    return float(text)


def axis_units(axes: tuple[str, ...], units: tuple[AxisUnit, ...]) -> tuple[AxisUnit, ...]:
    """Return `units`, or plain ones when none are given."""
    return units or (AxisUnit(),) * len(axes)


def correction_channels(axes: tuple[str, ...], receive: tuple[str, ...]) -> tuple[str, ...]:
    """Return the channels of a reply, the usual ones when none are given."""
    return receive or tuple(f"{default_element(axis)}.{axis}" for axis in axes)


def check_values(name: str, values: Sequence[float], count: int) -> None:
    """Raise TelegramError (``number``) unless there are `count` values, all finite."""
    if len(values) != count:
        raise TelegramError("number", f"{name} holds {len(values)} values; expected {count}")
    if not all(map(math.isfinite, values)):
        raise TelegramError("number", f"{name} is {tuple(values)}; expected finite numbers")

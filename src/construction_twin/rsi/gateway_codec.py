"""RSI telegrams as bytes, the gateway's side: reads `Rob` (controller to PC), writes `Sen` (PC to controller).

The border where degrees and millimetres end. Telegrams are checked completely or refused, with the reasons of `telegram`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import partial

from construction_twin.controller.telegram import AxisUnit, Telegram
from construction_twin.core.errors import TelegramError
from construction_twin.core.network import MAX_TELEGRAM
from construction_twin.rsi.layout import EXTERNAL_AXES, STOP, RsiLayout, set_element
from construction_twin.rsi.telegram import (
    axis_units,
    check_values,
    correction_channels,
    find_children,
    is_fixed_in_bytes,
    is_number,
    is_number_in_bytes,
    read_count,
    read_document,
    read_ipoc,
    read_number,
    without_declaration,
)

#: What values may consist of, all of them together, so that they cannot change what is around them.
_is_plain = re.compile(rb"[-+.0-9A-Za-z]*").fullmatch
#: Matches whole numbers that fit into 64 bits whatever their digits.
is_count = re.compile(rb"[0-9]{1,19}").fullmatch
_TAG = re.compile(rb"<([A-Za-z]\w*)")
_ATTRIBUTE = re.compile(rb"\s([A-Za-z]\w*)=$").search

#: Decimals of a degree or mm in a correction, as every known driver sends them (docs/rsi.md, section 3).
CORRECTION_DECIMALS = 6
#: Telegrams between two attempts to learn a shape: an attempt costs as much as reading one.
RELEARN_AFTER = 250


_POSE = re.compile(rb"<RIst\s([^<>]*)/?>").findall
_VALUES = re.compile(rb"""\b([XYZABC])\s*=\s*["']([^"'<>]{1,48})["']""").findall


def read_tool_pose(data: bytes) -> tuple[float, ...] | None:
    """Return the tool pose `RIst` of a checked telegram, X, Y, Z [m], A, B, C [rad]; None unless it has six numbers, once."""
    found = _POSE(data)
    values = dict(_VALUES(found[0])) if len(found) == 1 else {}
    texts = [values.get(name, b"") for name in (b"X", b"Y", b"Z", b"A", b"B", b"C")]
    if not all(map(is_number_in_bytes, texts)):
        return None
    return (*[float(text) / 1e3 for text in texts[:3]], *[math.radians(float(text)) for text in texts[3:]])


def split_values(data: bytes) -> tuple[list[bytes], list[bytes], bytes]:
    """Split a telegram into its constant texts, the values of attributes, and IPOC."""
    parts = data.split(b'"')
    head, _, rest = parts[-1].partition(b"<IPOC>")
    ipoc, _, tail = rest.partition(b"</IPOC>")
    return [*parts[:-1:2], head, tail], parts[1::2], ipoc


def places_of(texts: Sequence[bytes], wanted: Sequence[tuple[str, str]]) -> list[int] | None:
    """Return the indices of the wanted values, by element and attribute, from `split_values`' constant texts; None: unclear."""
    keys, tag = [], ""
    for text in texts[:-2]:
        for found in _TAG.finditer(text):
            tag = found[1].decode()
        attribute = _ATTRIBUTE(text)
        if attribute is None:
            return None
        keys.append((tag, attribute[1].decode()))
    shown = b"'" not in b"".join(texts) and all(keys.count(key) == 1 for key in wanted)
    return [keys.index(key) for key in wanted] if shown else None


class RobotDecoder:
    """Reads the axes of one configuration from telegrams; default `units`: revolute axes with the controller's sign and zero.

    A telegram of the shape of one that was read as XML differs in its numbers alone, and needs no parser.
    """

    def __init__(self, axes: tuple[str, ...], units: tuple[AxisUnit, ...] = ()):
        self._scale = [(unit.reading_factor, unit.zero) for unit in axis_units(axes, units)]
        #: Element and attribute of each axis.
        self._measured, self._programmed = (
            [(f"{'E' if axis in EXTERNAL_AXES else 'A'}{block}", axis) for axis in axes] for block in ("IPos", "SPos")
        )
        self._wanted = frozenset((*(block for block, _ in (*self._measured, *self._programmed)), "Delay", "IPOC"))
        self._shape: list[bytes] = []
        self._places: list[int] | None = None
        self._relearn_in = 0
        self._setpoint: tuple[list[bytes], tuple[float, ...]] = [], ()

    def parse(self, data: bytes) -> Telegram:
        """Read a controller packet; one of IPOC alone is legal, and so are an XML declaration and exponents."""
        known = self._parse_known_shape(data) if self._places is not None else None
        if known:
            return known
        document = without_declaration(data)
        found = find_children(read_document(document, "Rob"), self._wanted)
        delay = found.get("Delay")
        telegram = Telegram(
            read_ipoc(found),
            self._positions(found, self._measured),
            self._positions(found, self._programmed),
            None if delay is None else read_count(delay.get("D"), "Delay D", "number"),
        )
        if self._relearn_in:
            self._relearn_in -= 1
        else:
            self._learn(document, telegram)
        return telegram

    def _learn(self, data: bytes, telegram: Telegram) -> None:
        self._relearn_in = RELEARN_AFTER
        self._shape = split_values(data)[0]
        self._places = places_of(self._shape, (*self._measured, *self._programmed, ("Delay", "D")))
        if self._places is not None and self._parse_known_shape(data) != telegram:
            # the same words stand elsewhere too, e.g. in an element of an element
            self._places = None

    def _parse_known_shape(self, data: bytes) -> Telegram | None:
        """Read a telegram of the known shape without XML; None: another shape, or an invalid one."""
        texts, values, ipoc = split_values(data)
        if texts != self._shape or not _is_plain(b"".join(values)) or len(data) > MAX_TELEGRAM or not is_count(ipoc):
            return None
        *numbers, delay = [values[place] for place in self._places or ()]
        if not is_count(delay) or not (all(map(is_fixed_in_bytes, numbers)) or all(map(is_number_in_bytes, numbers))):
            return None
        count = len(self._scale)
        if numbers[count:] != self._setpoint[0]:
            # it is the same for as long as the controller is only corrected
            self._setpoint = numbers[count:], self._si(numbers[count:])
        return Telegram(int(ipoc), self._si(numbers[:count]), self._setpoint[1], int(delay))

    def _si(self, texts: list) -> tuple[float, ...]:
        return tuple([float(text) * factor - zero for text, (factor, zero) in zip(texts, self._scale)])

    def _positions(self, found: dict, slots: list[tuple[str, str]]) -> tuple[float, ...] | None:
        missing = [block for block, _ in slots if block not in found]
        if len(missing) == len(slots):
            return None
        if missing:
            raise TelegramError("element", f"the telegram has no {missing[0]}, but another block of the same kind")
        texts = [found[block].get(axis) for block, axis in slots]
        for (block, axis), text in zip(slots, texts):
            if text is None or not is_number(text):
                # raises the error that names the axis
                read_number(found[block], axis, exponent=True)
        return self._si(texts)


class SensorEncoder:
    """Writes replies of one configuration; everything that stays the same is prepared once. Default: `AK` and `EK`, no `Stop`."""

    def __init__(
        self,
        sentype: str,
        axes: tuple[str, ...],
        receive: tuple[str, ...] = (),
        units: tuple[AxisUnit, ...] = (),
        switched: tuple[str, ...] = (),
    ):
        receive = correction_channels(axes, receive)
        self._count = len(axes)
        order = [axes.index(channel.partition(".")[2]) for channel in receive if channel != STOP]
        factors = [unit.correction_factor for unit in axis_units(axes, units)]
        #: Per number in a reply: index of the axis, and wire units per rad or m.
        self.order = tuple((index, factors[index]) for index in order)
        self._make = partial(_reply, sentype, receive, switched)
        #: By what `Stop` says and what a tool's outputs shall be; () leaves them alone.
        self._templates: dict[tuple[bool | None, tuple[bool, ...]], bytes] = {}
        self._plain = {stop: self.template(stop) for stop in (None, False, True)}

    @classmethod
    def of(cls, layout: RsiLayout, axes: tuple[str, ...], units: tuple[AxisUnit, ...] = ()) -> SensorEncoder:
        """Return the encoder for an Ethernet XML's replies."""
        return cls(layout.sentype, axes, layout.receive, units, layout.switched)

    def template(self, stop: bool | None, switched: tuple[bool, ...] = ()) -> bytes:
        """Return the %-template of a reply; it takes the numbers of `order`, and IPOC."""
        key = stop, switched
        if key not in self._templates:
            self._templates[key] = self._make(switched, stop)
        return self._templates[key]

    def encode(
        self, correction: Sequence[float], ipoc: int, stop: bool | None = None, switched: tuple[bool, ...] = ()
    ) -> bytes:
        """Write one reply: fixed point, six decimals of a degree or mm, never ``-0.000000``; see `Encoder`.

        Args:
            stop: Content of the `Stop` element. None: 0 where the element is declared, else no element.
        """
        check_values("correction", correction, self._count)
        values = [correction[index] * factor for index, factor in self.order]
        template = self.template(stop, switched) if switched else self._plain[stop]
        return (template % (*values, ipoc)).replace(b'"-0.000000"', b'"0.000000"')


def _reply(
    sentype: str, receive: tuple[str, ...], names: tuple[str, ...], switched: tuple[bool, ...], stop: bool | None
) -> bytes:
    """Return the template of a reply; the channels of one element stand together, where its first channel does."""
    elements: dict[str, list[str]] = {}
    if stop is not None and STOP not in receive:
        elements[STOP] = []
    for channel in receive:
        element, _, axis = channel.partition(".")
        elements.setdefault(element, []).append(axis)
    flag = f"<{STOP}>{int(bool(stop))}</{STOP}>"
    number = f'="%.{CORRECTION_DECIMALS}f"'
    body = "".join(
        flag if name == STOP else f"<{name} {' '.join(axis + number for axis in axes)}/>"
        for name, axes in elements.items()
    )
    return f'<Sen Type="{sentype}">{body}{set_element(names, switched)}<IPOC>%d</IPOC></Sen>'.encode()

"""RSI telegrams as bytes, the gateway's side: reads `Rob` (controller to PC), writes `Sen` (PC to controller).

The border where degrees and millimetres end. Telegrams are checked completely or refused, with the reasons of `telegram`; the other
side is `controller_codec`. Standard library only, and fast enough for every 4 ms cycle.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial

from construction_twin.controller.axis_unit import AxisUnit
from construction_twin.controller.telegram import Telegram
from construction_twin.core.errors import TelegramError
from construction_twin.core.udp import MAX_TELEGRAM
from construction_twin.rsi.layout import EXTERNAL_AXES, STOP, RsiLayout
from construction_twin.rsi.telegram import (
    attribute_template,
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
from construction_twin.rsi.tool_channels import set_element

#: What values may consist of, all of them together, so that they cannot change what is around them.
_is_plain = re.compile(rb"[-+.0-9A-Za-z]*").fullmatch
#: Whole numbers that fit into 64 bits whatever their digits.
is_count = re.compile(rb"[0-9]{1,19}").fullmatch
_TAG = re.compile(rb"<([A-Za-z]\w*)")
_ATTRIBUTE = re.compile(rb"\s([A-Za-z]\w*)=$").search
#: The end of a telegram, behind the last attribute.
_END = re.compile(rb"([^\"]*<IPOC>)[0-9]+(</IPOC></[A-Za-z]+>\s*)").fullmatch


class TelegramShape:
    """One telegram's shape; made by `of`. The next telegram of it needs no XML parser: it differs in its numbers alone."""

    def __init__(self, texts: list[bytes], end: tuple[bytes, bytes], places: list[int]):
        self._texts = texts
        self._before, self._behind = end
        self._places = places

    @classmethod
    def of(cls, data: bytes, wanted: Sequence[tuple[str, str]]) -> TelegramShape | None:
        """Return the shape of a telegram that was read as XML; wanted are values by element and attribute.

        None where the text does not show what its values stand for: a wanted one is missing or there twice, IPOC is not the last.
        """
        if b"'" in data:
            return None
        *texts, last = data.split(b'"')[0::2]
        end = _END(last)
        keys, tag = [], ""
        for text in texts:
            for found in _TAG.finditer(text):
                tag = found[1].decode()
            attribute = _ATTRIBUTE(text)
            if attribute is None:
                return None
            keys.append((tag, attribute[1].decode()))
        if end is None or any(keys.count(key) != 1 for key in wanted):
            return None
        return cls(texts, (end[1], end[2]), [keys.index(key) for key in wanted])

    def read(self, data: bytes) -> tuple[int, list[bytes]] | None:
        """Return IPOC and the wanted values of a telegram; None when it has another shape."""
        parts = data.split(b'"')
        texts, values = parts[0::2], parts[1::2]
        last = texts.pop()
        if texts != self._texts or not _is_plain(b"".join(values)) or len(data) > MAX_TELEGRAM:
            return None
        if not (last.startswith(self._before) and last.endswith(self._behind)):
            return None
        ipoc = last[len(self._before) : len(last) - len(self._behind)]
        if not is_count(ipoc):
            return None
        return int(ipoc), [values[place] for place in self._places]


#: Decimals of a degree or mm in a correction, as every known driver sends them (docs/rsi.md, section 3).
CORRECTION_DECIMALS = 6
#: Telegrams between two attempts to learn a shape: an attempt costs as much as reading one.
RELEARN_AFTER = 250


class RobotDecoder:
    """Reads the axes of one configuration from controller packets; without `units` all are revolute, in the controller's own."""

    def __init__(self, axes: tuple[str, ...], units: tuple[AxisUnit, ...] = ()):
        units = axis_units(axes, units)
        self._scale = [(unit.reading_factor, unit.zero) for unit in units]
        external = [axis in EXTERNAL_AXES for axis in axes]
        self._measured_blocks = _blocks("AIPos", "EIPos", external)
        self._setpoint_blocks = _blocks("ASPos", "ESPos", external)
        #: Per axis: which of the blocks, and the attribute in it.
        self._slots = [(int(out and not all(external)), axis) for out, axis in zip(external, axes)]
        self._wanted = frozenset((*self._measured_blocks, *self._setpoint_blocks, "Delay", "IPOC"))
        positions = [
            (blocks[block], axis)
            for blocks in (self._measured_blocks, self._setpoint_blocks)
            for block, axis in self._slots
        ]
        self._in_shape = (*positions, ("Delay", "D"))
        self._shape: TelegramShape | None = None
        self._relearn_in = 0
        self._setpoint: tuple[list[bytes], tuple[float, ...]] = [], ()

    def parse(self, data: bytes) -> Telegram:
        """Read a controller packet; one of IPOC alone is legal, and so are an XML declaration and exponents."""
        known = self._of_shape(self._shape, data) if self._shape is not None else None
        if known:
            return known
        document = without_declaration(data)
        found = find_children(read_document(document, "Rob"), self._wanted)
        delay = found.get("Delay")
        telegram = Telegram(
            read_ipoc(found),
            self._positions(found, self._measured_blocks),
            self._positions(found, self._setpoint_blocks),
            None if delay is None else read_count(delay.get("D"), "Delay D", "number"),
        )
        if self._relearn_in:
            self._relearn_in -= 1
        else:
            self._learn(document, telegram)
        return telegram

    def _learn(self, data: bytes, telegram: Telegram) -> None:
        self._relearn_in = RELEARN_AFTER
        self._shape = TelegramShape.of(data, self._in_shape)
        if self._shape is not None and self._of_shape(self._shape, data) != telegram:
            # the same words stand elsewhere too, e.g. in an element of an element
            self._shape = None

    def _of_shape(self, shape: TelegramShape, data: bytes) -> Telegram | None:
        """Read a telegram of the same shape as the last one; None when it does not, or when it is to be refused."""
        found = shape.read(data)
        if found is None:
            return None
        ipoc, (*texts, delay) = found
        if not is_count(delay) or not (all(map(is_fixed_in_bytes, texts)) or all(map(is_number_in_bytes, texts))):
            return None
        count = len(self._scale)
        if texts[count:] != self._setpoint[0]:
            # it is the same for as long as the controller is only corrected
            self._setpoint = texts[count:], self._si(texts[count:])
        return Telegram(ipoc, self._si(texts[:count]), self._setpoint[1], int(delay))

    def _si(self, texts: list) -> tuple[float, ...]:
        return tuple([float(text) * factor - zero for text, (factor, zero) in zip(texts, self._scale)])

    def _positions(self, found: dict, blocks: tuple[str, ...]) -> tuple[float, ...] | None:
        elements = [found[block] for block in blocks if block in found]
        if len(elements) != len(blocks):
            if not elements:
                return None
            missing = next(block for block in blocks if block not in found)
            raise TelegramError("element", f"the telegram has no {missing}, but another block of the same kind")
        texts = [elements[block].get(axis) for block, axis in self._slots]
        for text in texts:
            if text is None or not is_number(text):
                for block, axis in self._slots:
                    read_number(elements[block], axis, exponent=True)
        return self._si(texts)


def _blocks(robot: str, external: str, is_external: list[bool]) -> tuple[str, ...]:
    if not any(is_external):
        return (robot,)
    return (external,) if all(is_external) else (robot, external)


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
        """Write one reply: fixed point, six decimals of a degree or mm, never ``-0.000000``.

        Args:
            correction: Length n. [rad] ([m] for a linear axis)
            stop: Content of the `Stop` element. None: 0 where the element is declared, else no element.
            switched: One per name of `RsiLayout.switched`. (): all 0, which leaves the outputs alone.
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
    body = "".join(
        flag if name == STOP else f"<{name} {attribute_template(axes, CORRECTION_DECIMALS)}/>"
        for name, axes in elements.items()
    )
    return f'<Sen Type="{sentype}">{body}{set_element(names, switched)}<IPOC>%d</IPOC></Sen>'.encode()

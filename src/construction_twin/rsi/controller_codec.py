"""RSI telegrams as the controller writes and reads them, for the mock and the tests; rad and m on this side."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType

from construction_twin.controller.telegram import AxisUnit, Reply
from construction_twin.core.errors import ConfigurationError, TelegramError
from construction_twin.rsi.layout import EXTERNAL_AXES, IN, OUT, ROBOT_AXES, SET, STOP, names_of
from construction_twin.rsi.status_channels import ATTRIBUTE, NAMES, RsiStatus, status_channels
from construction_twin.rsi.telegram import (
    axis_units,
    correction_channels,
    find_children,
    read_document,
    read_ipoc,
    read_number,
)

_POSE = ("X", "Y", "Z", "A", "B", "C")
#: Attributes of a packet's blocks.
BLOCKS = {
    **{"RIst": _POSE, "RSol": _POSE, "AIPos": ROBOT_AXES, "ASPos": ROBOT_AXES},
    **{"EIPos": EXTERNAL_AXES, "ESPos": EXTERNAL_AXES},
}
#: What an optional channel sends of a status.
_STATUS_VALUES = {"Mode": "mode", "ProgStatus": "program", "OvPro": "override"}
_NO_STATUS = RsiStatus()


class RobotEncoder:
    """Writes controller packets; the blocks always have six attributes, and an axis that is not there reads 0.

    `precision` is that of the ETHERNET object: decimals of every value, 1 to 32.
    """

    def __init__(
        self,
        axes: tuple[str, ...],
        precision: int,
        send: tuple[str, ...] = ("RIst", "RSol", "AIPos", "ASPos", "Delay"),
        units: tuple[AxisUnit, ...] = (),
    ):
        self._units = [(unit.feedback_factor, unit.zero) for unit in axis_units(axes, units)]
        #: Blocks and attributes of the axes: measured, programmed.
        self._measured, self._programmed = (
            [f"{'E' if axis in EXTERNAL_AXES else 'A'}{block}.{axis}" for axis in axes] for block in ("IPos", "SPos")
        )
        elements: dict[str, list[str]] = {}
        for tag in send:
            # what stands in one element stands together, where its first channel does
            elements.setdefault(tag.partition(".")[0], []).extend(_channels(tag))
        self._channels = [channel for channels in elements.values() for channel in channels]
        body = "".join(_element(name, channels, precision) for name, channels in elements.items())
        self._template = f'<Rob Type="KUKA">{body}<IPOC>%d</IPOC></Rob>'.encode()
        zero = f"{0:.{precision}f}".encode()
        self._negative_zero, self._zero = b'"-' + zero + b'"', b'"' + zero + b'"'

    def encode(
        self,
        ipoc: int,
        measured: Sequence[float],
        setpoint: Sequence[float],
        measured_pose: Sequence[float],
        setpoint_pose: Sequence[float],
        delay: int,
        status: RsiStatus = _NO_STATUS,
        signals: Mapping[str, bool] = MappingProxyType({}),
    ) -> bytes:
        """Write one packet; unknown status and signals are sent as 0.

        Args:
            measured_pose, setpoint_pose: Length 6. X, Y, Z [m] and A, B, C [rad], for RIst and RSol.
            signals: By their TAGs, e.g. ``Out.vacuum``.
        """
        values: dict[str, float] = {"Delay.D": delay, **signals}
        for channels, q in ((self._measured, measured), (self._programmed, setpoint)):
            values.update(zip(channels, [(x + zero) * factor for x, (factor, zero) in zip(q, self._units)]))
        for block, pose in (("RIst", measured_pose), ("RSol", setpoint_pose)):
            on_wire = *(1e3 * value for value in pose[:3]), *map(math.degrees, pose[3:])
            values.update(zip(_channels(block), on_wire))
        for name, field in _STATUS_VALUES.items():
            values[name] = values[f"{name}.{ATTRIBUTE}"] = getattr(status, field) or 0
        found = [values.get(channel, 0) for channel in self._channels]
        return (self._template % (*found, ipoc)).replace(self._negative_zero, self._zero)


def _channels(tag: str) -> list[str]:
    """Return the channels of a TAG: those of a whole block, or itself."""
    if tag in BLOCKS:
        return [f"{tag}.{attribute}" for attribute in BLOCKS[tag]]
    if tag == "Delay":
        return ["Delay.D"]
    if not (names_of(OUT, [tag]) or names_of(IN, [tag]) or status_channels([tag])):
        known = (*BLOCKS, "Delay", *NAMES, "Out.<output>", "In.<input>")
        raise ConfigurationError("SEND", tag, f"one of {', '.join(known)}")
    return [tag]


def _element(name: str, channels: Sequence[str], precision: int) -> str:
    """Return the %-template of an element of a packet."""
    number = f"%.{precision}f" if name in BLOCKS else "%g" if name in NAMES else "%d"
    if channels == [name]:
        return f"<{name}>{number}</{name}>"
    attributes = " ".join(f'{channel.partition(".")[2]}="{number}"' for channel in channels)
    return f"<{name} {attributes}/>"


class SensorDecoder:
    """Reads replies, as a controller with this Ethernet configuration does; declared channels but `Stop` must be there."""

    def __init__(
        self,
        sentype: str,
        axes: tuple[str, ...],
        receive: tuple[str, ...] = (),
        units: tuple[AxisUnit, ...] = (),
        switched: tuple[str, ...] = (),
    ):
        self._sentype = sentype
        self._switched = switched
        element_of = {
            axis: element for element, _, axis in (tag.partition(".") for tag in correction_channels(axes, receive))
        }
        factors = [unit.correction_reading_factor for unit in axis_units(axes, units)]
        self._slots = [(element_of[axis], axis, factor) for axis, factor in zip(axes, factors)]
        self._needed = [*(element for element, *_ in self._slots), *([SET] if switched else [])]
        #: `Stop` counts where it is declared, or nothing is.
        self._wanted = frozenset((*self._needed, "IPOC", *([STOP] if STOP in receive or not receive else [])))

    def parse(self, data: bytes) -> Reply:
        """Read a reply; its `stop` is None where the element is undeclared or absent."""
        root = read_document(data, "Sen")
        if root.get("Type") != self._sentype:
            raise TelegramError(
                "sentype", f"the reply's Type is {root.get('Type', '')[:64]!r}; expected the SENTYPE {self._sentype!r}"
            )
        found = find_children(root, self._wanted)
        for element in self._needed:
            if element not in found:
                raise TelegramError("element", f"the reply has no {element} element")
        target = tuple([read_number(found[element], axis) * factor for element, axis, factor in self._slots])
        switched = tuple([_is_on(found[SET].get(name), f"{SET} {name}") for name in self._switched])
        stop = found.get(STOP)
        return Reply(read_ipoc(found), target, None if stop is None else _is_on(stop.text or "", STOP), switched)


def _is_on(text: str | None, name: str) -> bool:
    if text is None:
        raise TelegramError("attribute", f"the reply has no {name}")
    if text not in ("0", "1"):
        raise TelegramError("number", f"{name} is {text[:32]!r}; expected 0 or 1")
    return text == "1"

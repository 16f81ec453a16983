"""RSI telegrams as the controller writes and reads them, for the mock and the tests; rad and m on this side."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from xml.etree import ElementTree

from construction_twin.controller.axis_unit import AxisUnit
from construction_twin.controller.telegram import Reply
from construction_twin.core.errors import ConfigurationError, TelegramError
from construction_twin.rsi.layout import EXTERNAL_AXES, ROBOT_AXES, STOP
from construction_twin.rsi.status_channels import NAMES, RsiStatus, status_channels
from construction_twin.rsi.telegram import (
    attribute_template,
    axis_units,
    correction_channels,
    find_children,
    read_document,
    read_ipoc,
    read_number,
)
from construction_twin.rsi.tool_channels import SET, grouped, is_signal, signal_texts

#: Blocks of a packet that hold an axis each, with the axes in them.
AXIS_BLOCKS = {"AIPos": ROBOT_AXES, "ASPos": ROBOT_AXES, "EIPos": EXTERNAL_AXES, "ESPos": EXTERNAL_AXES}
#: Blocks of a packet that hold a Cartesian pose.
POSE_BLOCKS = ("RIst", "RSol")
#: What an optional channel sends of a status.
_STATUS_VALUES = {"Mode": "mode", "ProgStatus": "program", "OvPro": "override"}
_NO_STATUS = RsiStatus()


class RobotEncoder:
    """Writes controller packets; the blocks always have six attributes, and an axis that is not there reads 0.

    Args:
        precision: Decimals of every sent value, 1 to 32 (the ETHERNET object's `Precision`).
        send: Blocks in the order of the Ethernet XML, see `RsiLayout`.
        units: Default: every axis is revolute, and in the controller's own units.
    """

    def __init__(
        self,
        axes: tuple[str, ...],
        precision: int,
        send: tuple[str, ...] = (*POSE_BLOCKS, "AIPos", "ASPos", "Delay"),
        units: tuple[AxisUnit, ...] = (),
    ):
        self._units = [(unit.feedback_factor, unit.zero) for unit in axis_units(axes, units)]
        blocks = grouped(send)
        self._blocks = [
            (tags[0], [axes.index(a) if a in axes else None for a in AXIS_BLOCKS.get(tags[0], ())]) for tags in blocks
        ]
        self._status = {tag: _STATUS_VALUES[tag.partition(".")[0]] for tag in status_channels(send)}
        #: TAGs of a tool by the first one of their element.
        self._signals = {tags[0]: tags for tags in blocks if is_signal(tags[0])}
        elements = "".join(_block(tags, precision) for tags in blocks)
        self._template = f'<Rob Type="KUKA">{elements}<IPOC>%d</IPOC></Rob>'.encode()
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
        """Write one packet; what is not known of status and signals is sent as 0.

        Args:
            measured, setpoint: Length n. For AIPos and EIPos, ASPos and ESPos [rad] ([m] for a linear axis).
            measured_pose, setpoint_pose: Length 6. X, Y, Z [m] and A, B, C [rad], for RIst and RSol.
            signals: Outputs and inputs of a tool by their TAGs, e.g. ``Out.vacuum``.
        """
        axes = {"I": self._positions(measured), "S": self._positions(setpoint)}
        values: list[float] = []
        for name, slots in self._blocks:
            if name in POSE_BLOCKS:
                values.extend(_pose_on_wire(measured_pose if name == "RIst" else setpoint_pose))
            elif name == "Delay":
                values.append(delay)
            elif name in self._status:
                values.append(getattr(status, self._status[name]) or 0)
            elif name in self._signals:
                values.extend(signal_texts(self._signals[name], signals))
            else:
                values.extend(0.0 if slot is None else axes[name[1]][slot] for slot in slots)
        return (self._template % (*values, ipoc)).replace(self._negative_zero, self._zero)

    def _positions(self, q: Sequence[float]) -> list[float]:
        return [(value + zero) * factor for value, (factor, zero) in zip(q, self._units)]


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
        self._switched = switched
        self._stop_ignored = bool(receive) and STOP not in receive
        receive = correction_channels(axes, receive)
        element_of = {axis: element for element, _, axis in (channel.partition(".") for channel in receive)}
        self._sentype = sentype
        self._slots = [(element_of[axis], axis) for axis in axes]
        self._factors = [unit.correction_reading_factor for unit in axis_units(axes, units)]
        self._wanted = frozenset(
            (*(element for element, _ in self._slots), STOP, "IPOC", *((SET,) if switched else ()))
        )

    def parse(self, data: bytes) -> Reply:
        """Read a reply; its `stop` is None where the element is not declared, or not there."""
        root = read_document(data, "Sen")
        if root.get("Type") != self._sentype:
            raise TelegramError(
                "sentype", f"the reply's Type is {root.get('Type', '')[:64]!r}; expected the SENTYPE {self._sentype!r}"
            )
        found = find_children(root, self._wanted)
        for element, _ in self._slots:
            if element not in found:
                raise TelegramError("element", f"the reply has no {element} element")
        values = [read_number(found[element], axis) for element, axis in self._slots]
        correction = tuple([value * factor for value, factor in zip(values, self._factors)])
        switched = self._switches(found.get(SET)) if self._switched else ()
        return Reply(read_ipoc(found), correction, self._stop(found.get(STOP)), switched)

    def _switches(self, element: ElementTree.Element | None) -> tuple[bool, ...]:
        if element is None:
            raise TelegramError("element", f"the reply has no {SET} element")
        texts = [element.get(name) for name in self._switched]
        for name, text in zip(self._switched, texts):
            if text is None:
                raise TelegramError("attribute", f"{SET} has no {name}")
            if text not in ("0", "1"):
                raise TelegramError("number", f"{SET} {name} is {text[:32]!r}; expected 0 or 1")
        return tuple([text == "1" for text in texts])

    def _stop(self, element: ElementTree.Element | None) -> bool | None:
        if element is None or self._stop_ignored:
            return None
        if element.text not in ("0", "1"):
            raise TelegramError("number", f"{STOP} is {(element.text or '')[:32]!r}; expected 0 or 1")
        return element.text == "1"


def _block(tags: tuple[str, ...], precision: int) -> str:
    name = tags[0]
    if is_signal(name):
        attributes = " ".join(f'{tag.partition(".")[2]}="%d"' for tag in tags)
        return f"<{name.partition('.')[0]} {attributes}/>"
    if name in POSE_BLOCKS:
        return f"<{name} {attribute_template(('X', 'Y', 'Z', 'A', 'B', 'C'), precision)}/>"
    if name in AXIS_BLOCKS:
        return f"<{name} {attribute_template(AXIS_BLOCKS[name], precision)}/>"
    if name == "Delay":
        return '<Delay D="%d"/>'
    if status_channels((name,)):
        element, _, attribute = name.partition(".")
        return f'<{element} {attribute}="%g"/>' if attribute else f"<{element}>%g</{element}>"
    known = (*POSE_BLOCKS, *AXIS_BLOCKS, "Delay", *NAMES, "Out.<output>", "In.<input>")
    raise ConfigurationError("SEND", name, f"one of {', '.join(known)}")


def _pose_on_wire(pose: Sequence[float]) -> tuple[float, ...]:
    return (*(1e3 * value for value in pose[:3]), *map(math.degrees, pose[3:]))

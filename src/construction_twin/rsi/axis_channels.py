"""The optional channels by which a controller tells quantities of its axes: torques and motor currents.

Torques are ``GearTorque.A1`` to ``GearTorque.A6`` [N m]: none of them is built in, somebody wires an object GEARTORQUE to channels
of SEND. Motor currents are built in: ``DEF_MACur`` sends all six in the element `MACur` (docs/rsi.md, section 2). An external axis
has neither. Read beside the telegram and after it, as `tool_channels` is, so that a file without them costs nothing, and one that
cannot be read ends no answers. Standard library only.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence

from construction_twin.core.axis_quantities import CURRENT, QUANTITIES, TORQUE, AxisQuantity
from construction_twin.rsi.layout import ROBOT_AXES
from construction_twin.rsi.telegram import is_number_in_bytes

#: Element of each quantity.
ELEMENTS = {TORQUE: "GearTorque", CURRENT: "MACur"}
#: Those that the controller sends as one block of all its axes.
BLOCKS = (CURRENT,)

_ATTRIBUTE = re.compile(rb"([A-Za-z][A-Za-z0-9_]*)\s*=\s*[\"']([^\"'<>]*)[\"']").findall


def quantity_of(tag: str) -> AxisQuantity | None:
    """Return which quantity a TAG of SEND, without ``DEF_``, tells; None: it tells none."""
    element, dot, axis = tag.partition(".")
    for quantity in QUANTITIES:
        if element == ELEMENTS[quantity]:
            return quantity if (not dot if quantity in BLOCKS else axis in ROBOT_AXES) else None
    return None


def told_axes(quantity: AxisQuantity, send: Iterable[str]) -> tuple[str, ...]:
    """Return the axes of which a controller tells a quantity, in the order of its SEND."""
    tags = [tag for tag in send if quantity_of(tag) is quantity]
    return ROBOT_AXES if tags and quantity in BLOCKS else tuple(tag.partition(".")[2] for tag in tags)


class AxisReader:
    """Reads one quantity from telegrams that were read as ones before.

    Args:
        axes: Length n. Those of the robot, in the order wanted.
        told: Axes whose channels the file declares.
    """

    def __init__(self, quantity: AxisQuantity, axes: Sequence[str], told: Sequence[str]):
        self._most = quantity.most
        self._places = [(place, axis.encode()) for place, axis in enumerate(axes) if axis in told]
        self._count = len(axes)
        self._find = re.compile(rb"<%b\s([^<>]*)>" % ELEMENTS[quantity].encode()).findall

    def read(self, data: bytes) -> tuple[float, ...] | None:
        """Return what a telegram tells, shape (n,), nan for an axis without a channel.

        None when a declared channel is missing, there twice, or no number that the quantity can have.
        """
        found = self._find(data)
        attributes = _ATTRIBUTE(found[0]) if len(found) == 1 else []
        told = dict(attributes)
        if len(told) != len(attributes):
            return None
        read = [math.nan] * self._count
        for place, axis in self._places:
            text = told.get(axis)
            if text is None or not is_number_in_bytes(text):
                return None
            read[place] = value = float(text)
            if not abs(value) <= self._most:
                return None
        return tuple(read)

"""The optional channels by which a controller tells the torque of its axes: ``GearTorque.A1`` to ``GearTorque.A6`` [N m].

None of them is built in: somebody wires an object GEARTORQUE to channels of SEND (docs/rsi.md). An external axis has none. Read
beside the telegram and after it, as `tool_channels` is, so that a file without them costs nothing, and one that cannot be read ends
no answers. Standard library only.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence

from construction_twin.rsi.layout import ROBOT_AXES
from construction_twin.rsi.telegram import is_number_in_bytes

#: Element of the channels.
TORQUE = "GearTorque"
#: More than this no gear can carry [N m]: it is another quantity, or another unit.
MOST = 1e6

_ATTRIBUTE = re.compile(rb"([A-Za-z][A-Za-z0-9_]*)\s*=\s*[\"']([^\"'<>]*)[\"']").findall


def is_torque(tag: str) -> bool:
    """Return whether a TAG of SEND is the torque of an axis."""
    element, _, axis = tag.partition(".")
    return element == TORQUE and axis in ROBOT_AXES


def torque_axes(send: Iterable[str]) -> tuple[str, ...]:
    """Return the axes whose torque a controller sends, in the order of its SEND."""
    return tuple(tag.partition(".")[2] for tag in send if is_torque(tag))


class TorqueReader:
    """Reads torques from telegrams that were read as ones before.

    Args:
        axes: Length n. Those of the robot, in the order wanted.
        told: Axes whose channels the file declares.
    """

    def __init__(self, axes: Sequence[str], told: Sequence[str]):
        self._places = [(place, axis.encode()) for place, axis in enumerate(axes) if axis in told]
        self._count = len(axes)
        self._find = re.compile(rb"<%b\s([^<>]*)>" % TORQUE.encode()).findall

    def read(self, data: bytes) -> tuple[float, ...] | None:
        """Return what a telegram tells, shape (n,) [N m], nan for an axis without a channel.

        None when a declared channel is missing, there twice, or no number that a torque can have.
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
            if not abs(value) <= MOST:
                return None
        return tuple(read)

"""Quantities that a controller may tell per axis, beside where the axes are. Standard library only.

All of them go the same way: from a telegram to a message beside the arm's pose, and on to a topic of ROS. What tells them apart
stands here; how a make of controller calls them, it knows itself.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class AxisQuantity:
    """One of them.

    Attributes:
        name: The last level of its MQTT topic, and the beginning of its counters.
        key: Of the values in its messages, with their unit.
        most: A larger one, of either sign, is another quantity, or in another unit.
    """

    name: str
    key: str
    most: float


#: The torque that an axis gives [N m]; more no gear can carry.
TORQUE = AxisQuantity("torque", "torque_nm", 1e6)
#: The current of an axis' motor, in the unit of KUKA's ``$CURR_ACT``: percent of the most that its amplifier gives (docs/rsi.md).
#: So 100 should never be exceeded; ten times that much is in another unit.
CURRENT = AxisQuantity("current", "current_percent", 1e3)
#: All of them, in the order in which they are told.
QUANTITIES = (TORQUE, CURRENT)

"""The names of what an attempt to place an element goes through."""

from __future__ import annotations

from construction_twin.work.process import REACH

#: Names of the segments of a plan, in their order.
TO_STOCK, APPROACH, LIFT, CARRY, SET_DOWN, RETREAT = "to stock", "approach", "lift", "carry", "set down", "retreat"
#: Before the first segment: what is looked at to choose a grip.
GRIP = "grip"
#: In the order in which an attempt gets there.
STAGES = (GRIP, REACH, APPROACH, LIFT, TO_STOCK, SET_DOWN, RETREAT, CARRY)

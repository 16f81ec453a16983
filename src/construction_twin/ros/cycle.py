"""A 4 ms grid of nominal stamps, paced by absolute deadlines."""

from __future__ import annotations

import time
from collections.abc import Iterator

import rospy

from construction_twin.ros.joint_stream import now_ns
from construction_twin.units import CYCLE_NS

#: Setpoints that are late by no more than this are sent one after the other, so that none is missing [ns]. Below the gateway's
#: `silence` of 0.1 s: what the gateway bridges need not end a plan.
CATCH_UP = 80_000_000


def cycles() -> Iterator[tuple[int, int]]:
    """Yield once per cycle until ROS shuts down.

    The grid starts on ROS time and advances with the monotonic clock, so a correction of the wall clock does not disturb it.

    Yields
    ------
    stamp : int
        The cycle's nominal stamp [ns], a multiple of 4 ms.
    stalled : int
        0, or for how long the grid was interrupted because this process was not run for more than `CATCH_UP` [ns].
    """
    stamp = now_ns() // CYCLE_NS * CYCLE_NS
    offset = now_ns() - time.monotonic_ns()
    while not rospy.is_shutdown():
        stamp += CYCLE_NS
        remaining = stamp - (time.monotonic_ns() + offset)
        stalled = 0
        if remaining > 0:
            time.sleep(remaining / 1e9)
        elif -remaining > CATCH_UP:
            stalled = -remaining
            # never back: on a clock that was set back meanwhile the grid would stand still until the clock has caught up
            offset = max(offset, now_ns() - time.monotonic_ns())
            stamp = max(stamp, (time.monotonic_ns() + offset) // CYCLE_NS * CYCLE_NS)
        yield stamp, stalled

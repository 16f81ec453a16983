"""A 4 ms grid of nominal stamps, paced by absolute deadlines."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import rospy

from construction_twin.core.units import CYCLE_NS
from construction_twin.ros.transport.joint_stream import now_ns

#: Setpoints that are late by no more than this are sent one after the other, so that none is missing [ns]. Below the gateway's
#: `silence` of 0.1 s: what the gateway bridges need not end a plan.
CATCH_UP = 80_000_000


class Cycles:
    """A grid from ROS time on, by the monotonic clock. One thread takes the cycles; others may ask and set its time."""

    def __init__(self):
        self._lock = threading.Lock()
        self._stamp = now_ns() // CYCLE_NS * CYCLE_NS
        self._offset = now_ns() - time.monotonic_ns()

    def now(self) -> int:
        """Return the grid's time [ns]."""
        return time.monotonic_ns() + self._offset

    def reach(self, stamp: int) -> int:
        """Never lag behind a stamp that another node's grid has reached [ns], on a clock that was set since; return `now`."""
        with self._lock:
            self._offset = max(self._offset, stamp - time.monotonic_ns())
            return self.now()

    def begin_at(self, stamp: int) -> None:
        """Go on from a stamp [ns], also an earlier one: another node's grid has begun there, on a clock that was set back."""
        with self._lock:
            self._stamp, self._offset = stamp // CYCLE_NS * CYCLE_NS, stamp - time.monotonic_ns()

    def skip(self) -> None:
        """Leave out the cycles that have passed."""
        with self._lock:
            self._stamp = max(self._stamp, self.now() // CYCLE_NS * CYCLE_NS)

    def __iter__(self) -> Iterator[tuple[int, int]]:
        """Wait for one cycle after the other; yield its stamp, and how long the grid stood, this process not being run [ns]."""
        while not rospy.is_shutdown():
            with self._lock:
                self._stamp += CYCLE_NS
                remaining = self._stamp - self.now()
            stalled = 0
            if remaining > 0:
                time.sleep(remaining / 1e9)
            elif -remaining > CATCH_UP:
                stalled = -remaining
                # never back: on a clock that was set back meanwhile the grid would stand still until the clock has caught up
                self.reach(now_ns())
                self.skip()
            yield self._stamp, stalled

"""The kinematic twin: executes commands exactly, after it has taken over the arm's pose.

Pure; angles in rad, stamps in ns.
"""

from __future__ import annotations

import math

from construction_twin.limits import outside_tolerance
from construction_twin.units import NANOSECONDS

#: The first command may differ this much from the pose taken over [rad] (design, law 5).
START_TOLERANCE = math.radians(0.05)
#: After this long without a command the held pose is repeated by the clock [ns]; executor.TWIN_TIMEOUT must be longer.
SILENCE = NANOSECONDS // 4


class VirtualRobot:
    """A robot that is where it was told to be.

    Parameters
    ----------
    home : tuple, shape (n,) or None
        Pose to start at [rad]; None waits for `take_over`, so that a twin of a physical arm never shows a pose it made up.
    """

    def __init__(self, home: tuple[float, ...] | None):
        self.pose: tuple[float, ...] | None = home
        self.stamp = 0
        self._executing = False

    def restart(self) -> None:
        """Forget the pose and wait for the next `take_over`."""
        self.pose, self.stamp, self._executing = None, 0, False

    def take_over(self, q: tuple[float, ...]) -> bool:
        """Take the physical arm's pose [rad] if none is held; return whether it was taken."""
        if self.pose is not None:
            return False
        self.pose = q
        return True

    def execute(self, stamp: int, q: tuple[float, ...]) -> bool:
        """Execute a command; return whether it was executed.

        Refused is a command while no pose is held, one that is not newer than the last, and a first one away from the pose taken
        over: it belongs to the stream before the restart, still on its way.
        """
        if self.pose is None or stamp <= self.stamp:
            return False
        if not self._executing and outside_tolerance(q, self.pose, START_TOLERANCE) is not None:
            return False
        self.pose, self.stamp, self._executing = q, stamp, True
        return True


class TwinClock:
    """Decides which stamps the twin's poses are published with: those of its commands, and the clock's while there are none.

    Stamps always increase. A command whose stamp is not newer than what was published (it was delayed by more than `SILENCE`)
    is executed, but its stamp belongs to the past and is not published.
    """

    def __init__(self):
        self.restart()

    def restart(self) -> None:
        """Forget everything; the clock may be another."""
        self._published = 0
        self._heard: int | None = None

    def on_command(self, stamp: int, now: int) -> bool:
        """Take a command that was executed, by stamp and reception [ns]; return whether to publish its pose with its stamp."""
        self._heard = now
        return self._is_newer(stamp)

    def on_cycle(self, now: int) -> bool:
        """Return whether to publish the held pose with the stamp `now` [ns]: no command came yet, or the stream fell silent."""
        return (self._heard is None or now - self._heard >= SILENCE) and self._is_newer(now)

    def _is_newer(self, stamp: int) -> bool:
        if stamp <= self._published:
            return False
        self._published = stamp
        return True

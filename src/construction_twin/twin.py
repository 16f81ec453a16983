"""The kinematic twin: executes commands exactly, after it has taken over the arm's pose.

Pure; angles in rad, stamps in ns.
"""

from __future__ import annotations

import math

from construction_twin.limits import outside_tolerance

#: The first command may differ this much from the pose taken over [rad] (design, law 5).
START_TOLERANCE = math.radians(0.05)


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

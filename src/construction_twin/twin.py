"""The kinematic twin: executes commands exactly, after it has taken over the arm's pose.

Pure; angles in rad, stamps in ns.
"""

from __future__ import annotations


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

    def restart(self) -> None:
        """Forget the pose and wait for the next `take_over`."""
        self.pose = None

    def take_over(self, q: tuple[float, ...]) -> bool:
        """Take the physical arm's pose [rad] if none is held; return whether it was taken."""
        if self.pose is not None:
            return False
        self.pose = q
        return True

    def execute(self, stamp: int, q: tuple[float, ...]) -> bool:
        """Execute a command; return False, and do nothing, while no pose is held or the command is not newer than the last."""
        if self.pose is None or stamp <= self.stamp:
            return False
        self.pose, self.stamp = q, stamp
        return True

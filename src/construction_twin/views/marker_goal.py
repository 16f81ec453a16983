"""The goal of the marker at the tool: where it was dragged to; none while it follows the tool. Poses are ``base_T_tool``."""

from __future__ import annotations

import threading

import numpy as np

from construction_twin.kinematics.chain import Pose

#: A tool that has moved less is not followed [m, and elements of the rotation].
STILL = 1e-6
#: A plan that ends within this of the goal was the plan to this goal [m, and elements of the rotation].
REACHED = 1e-3


class MarkerGoal:
    """Where the marker was dragged to; may be used by several threads."""

    def __init__(self):
        self._lock = threading.Lock()
        self._pose: Pose | None = None

    @property
    def pose(self) -> Pose | None:
        """The goal; None while the marker follows the tool."""
        return self._pose

    def drag(self, pose: Pose) -> None:
        """Take a new goal."""
        with self._lock:
            self._pose = pose

    def drop(self) -> None:
        """Let the marker follow the tool again."""
        with self._lock:
            self._pose = None

    def reached(self, end: Pose) -> None:
        """Drop the goal if a motion has ended there; a goal that was dragged further meanwhile stays."""
        with self._lock:
            if self._pose is not None and not moved(self._pose, end, REACHED):
                self._pose = None


def moved(before: Pose, after: Pose, tolerance: float = STILL) -> bool:
    """Return whether two poses differ by more than a tolerance [m, and elements of the rotation]."""
    position, rotation = np.abs(after.position - before.position), np.abs(after.rotation - before.rotation)
    return bool(position.max() > tolerance or rotation.max() > tolerance)

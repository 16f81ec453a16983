"""Poses at a low rate: which of a stream are shown (all while they change, a few a second at rest), and their velocities.

Each pose in tf costs `robot_state_publisher` three questions to the master, and whoever hears tf the reading of all its frames.
Pure.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Generic, TypeVar

from construction_twin.core.units import NANOSECONDS

#: Time between two poses that are shown at rest [s].
REST_PERIOD = 0.2
#: A joint that is no further than this from where it was shown last has not moved [rad], [m]: 25 µm at the end of an arm of 2.5 m.
#: A measured pose is never quite still.
STILL = 1e-5
#: A pose that is further from the last one than the joints' speed limits allow, by this factor, was not moved to: the twin has
#: taken the arm's pose over. Rounding to three decimals of a degree adds a few percent at 20 ms.
_JUMP = 1.1

Shown = TypeVar("Shown")


class ShownPoses(Generic[Shown]):
    """Takes one pose after the other."""

    def __init__(self):
        self._names: tuple[str, ...] = ()
        self._q: tuple[float, ...] = ()
        self._at = 0.0
        self._left_out: Shown | None = None

    def take(self, now: float, names: Sequence[str], q: Sequence[float], shown: Shown) -> Shown | None:
        """Return what is shown now: the pose, at the end of a rest the one before, or None.

        Args:
            now: On the monotonic clock [s].
            names: Of the joints.
            q: Their positions [rad], [m], of the same length.
            shown: The pose, as the caller shows it.
        """
        same_joints = tuple(names) == self._names
        moved = not same_joints or any(abs(value - before) > STILL for value, before in zip(q, self._q))
        if not moved and now - self._at < REST_PERIOD:
            self._left_out = shown
            return None
        left_out, self._left_out, self._at = self._left_out, None, now
        if moved and same_joints and left_out is not None:
            # tf draws a line from one frame to the next: a motion begins where the rest ended, not up to `REST_PERIOD` before
            return left_out
        self._names, self._q = tuple(names), tuple(q)
        return shown


class JointVelocities:
    """Velocities of a chain's joints.

    Args:
        largest: Length n. The joints' speed limits [rad/s], [m/s].
    """

    def __init__(self, largest: Sequence[float]):
        self._largest = tuple(_JUMP * velocity for velocity in largest)
        self._rest = (0.0,) * len(self._largest)
        self._last: tuple[int, tuple[float, ...]] | None = None

    def of(self, stamp: int, q: tuple[float, ...]) -> tuple[float, ...]:
        """Return the mean velocities since the pose of the last call, shape (n,) [rad/s], [m/s].

        0 for the first pose, for a stamp that is not newer, and for a pose that no joint could have moved to since: the twin took
        the arm's pose over.

        Args:
            stamp: Of the pose [ns].
            q: Shape (n,). [rad], [m]
        """
        before, self._last = self._last, (stamp, q)
        if before is None or stamp <= before[0]:
            return self._rest
        period = (stamp - before[0]) / NANOSECONDS
        moved = tuple([(value - was) / period for value, was in zip(q, before[1])])
        if all(abs(speed) <= largest for speed, largest in zip(moved, self._largest)):
            return moved
        return self._rest

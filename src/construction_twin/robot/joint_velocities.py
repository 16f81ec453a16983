"""Velocities of joints, as differences of poses that come one after the other. Positions in rad, m; stamps in ns."""

from __future__ import annotations

from collections.abc import Sequence

from construction_twin.core.units import NANOSECONDS

#: A pose that is further from the last one than the joints' speed limits allow, by this factor, was not moved to: the twin has
#: taken the arm's pose over. Rounding to three decimals of a degree adds a few percent at 20 ms.
_JUMP = 1.1


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

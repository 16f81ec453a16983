"""The twin while the arm leads: it follows the measured pose inside the limits, so it never jumps.

Pure; angles in rad, prismatic joints in m, stamps in ns.
"""

from __future__ import annotations

from construction_twin.core.follower import Follower
from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import CYCLE_NS

#: Decimals of a measured pose whose rounding is no motion of its own: the format's default.
DECIMALS = 3
#: The motion of more cycles than this is not made up for at once [cycles]: 0.25 s.
MOST_CYCLES = 62


class MirrorTwin:
    """Follows measured poses, from a pose at rest.

    A pose that the limits allow is met exactly. Another one is approached inside the limits, cycle by cycle, as the gateway
    follows its targets: the twin may stand elsewhere when mirroring begins, and poses may be lost.

    Args:
        pose: Shape (n,). Where the twin stands [rad], [m].
    """

    def __init__(self, limits: MotionLimits, pose: tuple[float, ...]):
        self._follower = Follower(limits, DECIMALS, pose)
        self._target = pose
        self._stamp = 0

    @property
    def arrived(self) -> bool:
        """True while the twin is where the arm was measured."""
        return not self._follower.settling

    def follow(self, stamp: int, q: tuple[float, ...]) -> tuple[float, ...] | None:
        """Follow a measured pose.

        Args:
            stamp: Of the measurement [ns]. How many cycles have gone by since the last one says how far the twin may move.
            q: Shape (n,). [rad], [m]

        Returns:
            Shape (n,). The twin's pose [rad], [m]; None when the measurement is not newer than the last one.
        """
        if stamp <= self._stamp:
            return None
        cycles = min(max(1, round((stamp - self._stamp) / CYCLE_NS)), MOST_CYCLES) if self._stamp else 1
        last, self._target, self._stamp = self._target, q, stamp
        for cycle in range(1, cycles + 1):
            fraction = cycle / cycles
            pose = self._follower.follow(
                q if cycle == cycles else tuple([a + fraction * (b - a) for a, b in zip(last, q)])
            )
        return pose

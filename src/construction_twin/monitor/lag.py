"""How long the arm trails its commands, estimated while it moves.

Pure. One lag for all joints, as the controller interpolates them together and as the evaluation estimates it.
"""

from __future__ import annotations

import math

from construction_twin.core.units import NANOSECONDS

#: Samples in motion over which the estimate forgets: 1 s.
MEMORY = 250
#: Samples in motion after which it counts as known: 0.2 s.
ENOUGH = 50
#: Slower than this no lag can be told from rounding: 3 decimals of a degree, 0.4 ms [rad/s].
SLOWEST = 0.02


class LagEstimate:
    """Recursive least squares with forgetting for one unknown, the lag.

    A pose measured L after its command differs from the commanded one by -L times the velocity. Each difference between the
    arm and the twin at the present estimate so corrects it, weighted by velocity squared.

    Args:
        most: Largest lag that is believed [s]: a joint at rest must not be taken for one that is late.
    """

    def __init__(self, most: float):
        self.most = most
        self._lag = 0.0
        self._weight = 0.0
        self._samples = 0

    @property
    def known(self) -> bool:
        """True when the arm has moved long enough."""
        return self._samples >= ENOUGH

    @property
    def seconds(self) -> float:
        """The lag [s]; nan until it is known."""
        return self._lag if self.known else math.nan

    @property
    def nanoseconds(self) -> int:
        """The lag to compare by [ns]: the best that is known so far, 0 at first."""
        return round(self._lag * NANOSECONDS)

    def learn(self, difference: tuple[float, ...], velocity: tuple[float, ...]) -> None:
        """Take one sample; a sample at rest is ignored.

        Args:
            difference: Shape (n,). Physical pose minus the twin's pose at the present estimate [rad].
            velocity: Shape (n,). Of the twin there [rad/s].
        """
        power = sum(v * v for v in velocity)
        if power < SLOWEST * SLOWEST:
            return
        self._weight = self._weight * (1.0 - 1.0 / MEMORY) + power
        correction = sum(d * v for d, v in zip(difference, velocity)) / self._weight
        self._lag = min(max(self._lag - correction, 0.0), self.most)
        if self._samples < ENOUGH:
            self._samples += 1

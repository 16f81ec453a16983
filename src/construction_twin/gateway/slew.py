"""Moving playout time without a step: a shift in whole nanoseconds, with a bounded rate that itself changes slowly.

Standard library only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from construction_twin.core.units import CYCLE_NS


@dataclass(frozen=True)
class SlewLimit:
    """How fast playout time may be moved.

    Played at a rate 1 + r, a motion's velocity is multiplied by 1 + r and its acceleration by (1 + r)^2, and a change of r adds
    velocity times dr/dt. How much of that the motion leaves room for in a cycle is `target_changes`' to say.

    Attributes:
        back, ahead: Largest shift per cycle [ns], backwards and forwards.
        change: Largest change of that shift from one cycle to the next [ns].
    """

    back: int
    ahead: int
    change: int

    @classmethod
    def of(cls, back: float, ahead: float, slope: float) -> SlewLimit:
        """Return the limit of these rates and of their largest change, `slope` [1/s]."""
        return cls(round(back * CYCLE_NS), round(ahead * CYCLE_NS), round(slope * CYCLE_NS * CYCLE_NS / 1_000_000_000))

    def of_cycle(self, cycle_ns: int) -> SlewLimit:
        """Return the same rates per cycle of another length [ns]; this one's are per cycle of 4 ms."""
        times = cycle_ns / CYCLE_NS
        return SlewLimit(round(self.back * times), round(self.ahead * times), round(self.change * times * times))


#: For clock drift, and to shrink a delay: 0.5 %, changing by 0.005 per second. At 2 rad/s that adds 0.01 rad/s^2; it takes 1.8 s
#: to move a cycle.
CALM = SlewLimit.of(0.005, 0.005, 0.005)
#: For a delay that has become too short: 5 %, changing by 0.1 per second. At 2 rad/s that adds 0.2 rad/s^2, 8 % of what axis 1 may,
#: so it changes more slowly where the motion itself brakes at its limit. It takes 1.1 s to gain 30 ms.
URGENT = SlewLimit.of(0.05, 0.005, 0.1)

#: To make up for what a speed limit has put off: 0.8 %, changing by 0.1 per second. A motion at 0.992 of its velocity and 0.98 of
#: its acceleration limits keeps inside them.
CATCH_UP = SlewLimit.of(0.05, 0.008, 0.1)


class Slew:
    """Carries a shift out, cycle by cycle, beginning and ending at rate zero.

    Args:
        cycle_ns: Length of a cycle [ns]; limits are per such cycle.
    """

    def __init__(self, cycle_ns: int = CYCLE_NS) -> None:
        self._cycle = cycle_ns
        self.clear()

    def clear(self) -> None:
        """Stand still, with nothing left to do."""
        #: What remains to be shifted [ns].
        self.remaining = 0
        #: The shift of the last cycle [ns].
        self.shift = 0

    @property
    def moving(self) -> bool:
        """True while something is shifted."""
        return bool(self.remaining or self.shift)

    @property
    def rate(self) -> float:
        """Present deviation of playout time's rate from 1."""
        return self.shift / self._cycle

    def step(self, limit: SlewLimit) -> int:
        """Return the shift of this cycle [ns], at most `limit` allows; the sum of all is exactly what was asked for."""
        distance = abs(self.remaining)
        # the largest shift after which slowing down still ends in time
        cycles = (math.isqrt(1 + 8 * distance // limit.change) - 1) // 2
        wanted = (distance + limit.change * cycles * (cycles + 1) // 2) // (cycles + 1)
        wanted = min(wanted, limit.ahead) if self.remaining > 0 else -min(wanted, limit.back)
        shift = min(max(wanted, self.shift - limit.change), self.shift + limit.change)
        self.remaining -= shift
        self.shift = shift
        return shift

    def replace(self, shift: int) -> None:
        """Carry out another shift [ns] in place of the last step's; what it leaves remains."""
        self.remaining += self.shift - shift
        self.shift = shift

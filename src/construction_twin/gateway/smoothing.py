"""Smoothing of played targets: takes out the ripple that few decimals leave; off unless asked for.

Standard library only; rad.
"""

from __future__ import annotations

from collections import deque

from construction_twin.core.units import CYCLE_NS


def henderson_weights(half: int) -> list[float]:
    """Return the symmetric weights of 2 * `half` + 1 values that pass cubics unchanged and change least from one to the next.

    Args:
        half: At least 2; with 1 only the value in the middle would count.

    References:
        R. Henderson, Note on graduation by adjusted average, Transactions of the Actuarial Society of America 17 (1916).
    """
    n = half + 2
    scale = 8 * n * (n**2 - 1) * (4 * n**2 - 1) * (4 * n**2 - 9) * (4 * n**2 - 25)
    return [
        315 * ((n - 1) ** 2 - k**2) * (n**2 - k**2) * ((n + 1) ** 2 - k**2) * (3 * n**2 - 16 - 11 * k**2) / scale
        for k in range(-half, half + 1)
    ]


class Smoother:
    """A weighted average over the targets of the last cycles.

    2 M + 1 targets delay the motion by M cycles. The ripple in acceleration that rounding causes falls to 34, 17, 10, 7, 5 %
    for M = 2 to 6. Velocity and acceleration pass unchanged: only what changes within a few cycles is smoothed. At rest
    the result is the target itself, to the last bit.

    Args:
        cycles: M, the delay in cycles; at least 2.
        cycle_ns: Length of a cycle [ns].
    """

    def __init__(self, cycles: int, cycle_ns: int = CYCLE_NS):
        self.delay = cycles * cycle_ns
        self._weights = henderson_weights(cycles)
        self._targets: deque[tuple[float, ...]] = deque(maxlen=2 * cycles + 1)
        self._stamps: deque[int] = deque(maxlen=2 * cycles + 2)

    def clear(self) -> None:
        """Forget everything; the next target stands for all before it."""
        self._targets.clear()
        self._stamps.clear()

    def stamp(self, before: bool) -> int:
        """Return the average of the stamps of the targets in the last average, or in the one before it [ns]."""
        stamps = list(self._stamps)
        stamps = stamps[:-1] if before else stamps[1:]
        return stamps[-1] + round(sum([weight * (stamp - stamps[-1]) for weight, stamp in zip(self._weights, stamps)]))

    def smooth(self, target: tuple[float, ...], stamp: int) -> tuple[float, ...]:
        """Take a cycle's target [rad] with its stamp [ns] and return the average [rad]."""
        targets = self._targets
        if not targets:
            targets.extend([target] * len(self._weights))
            self._stamps.extend([stamp] * (len(self._weights) + 1))
            return target
        targets.append(target)
        self._stamps.append(stamp)
        # as differences from the newest: equal targets give exactly that target
        return tuple(
            [
                value + sum([weight * (other - value) for weight, other in zip(self._weights, column)])
                for value, column in zip(target, zip(*targets))
            ]
        )

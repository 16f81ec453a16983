"""A cycle's step in parts, for telegrams that come faster than one a cycle.

A controller that is switched to a shorter cycle is noticed after some telegrams only, and an arm that is braked then is still
moving. A whole step of the longer cycle in each of them would be several times the speed, and many times the braking. Standard
library only; rad and ns.
"""

from __future__ import annotations

from collections.abc import Callable


class PartSteps:
    """Spreads the steps of whole cycles over the telegrams within them."""

    def __init__(self, cycle_ns: int):
        self._cycle = cycle_ns
        #: Controller time interpolated so far in the present step [ns]; 0: all of it.
        self.interpolated = 0
        self._before: tuple[float, ...] = ()

    def restart(self) -> None:
        """Begin with a whole step."""
        self.interpolated = 0

    def position(
        self, elapsed: int, now: tuple[float, ...], step: Callable[[], tuple[float, ...]]
    ) -> tuple[float, ...]:
        """Return where to be after `elapsed` more controller time [ns].

        The present step ends at `now`, shape (n,); `step` takes that of one cycle and returns where it ends.
        """
        begun = self.interpolated > 0
        self.interpolated += elapsed
        if not begun:
            self._before, now = now, step()
        while self.interpolated > self._cycle:
            self._before, now = now, step()
            self.interpolated -= self._cycle
        part = self.interpolated / self._cycle
        if self.interpolated == self._cycle:
            self.interpolated = 0
            return now
        return tuple([start + part * (end - start) for start, end in zip(self._before, now)])

"""Whether a cycle's target keeps the acceleration limits after the two before it, as the follower will ask.

Standard library only; positions in rad (m for prismatic joints).
"""

from __future__ import annotations

from collections.abc import Callable

from construction_twin.core.interpolation import Pose
from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import CYCLE_NS, NANOSECONDS

#: Halvings with which a cycle's advance is brought into the acceleration limits.
HALVINGS = 5


class TargetChanges:
    """The last two targets, and how much the step to the next one may differ from the step between them.

    That is each joint's acceleration limit with the format's allowance (docs/conventions.md, limits).

    Args:
        decimals: Decimals on the wire.
        cycle_ns: The controller's cycle [ns].
    """

    def __init__(self, limits: MotionLimits, decimals: int, cycle_ns: int = CYCLE_NS):
        cycle = cycle_ns / NANOSECONDS
        allowances = limits.allowances(decimals, cycle)
        self._largest = tuple((a + extra) * cycle * cycle for a, extra in zip(limits.acceleration, allowances))
        self.clear()

    def clear(self) -> None:
        """Begin anew: the next two targets can be compared with nothing."""
        self._before: Pose | None = None
        #: The last target; None: there is none to compare with.
        self.last: Pose | None = None

    def note(self, target: Pose) -> None:
        """Remember the target of a cycle, one cycle after the one before it."""
        self._before, self.last = self.last, target

    def allow(self, target: Pose) -> bool:
        """Return whether a target comes within every joint's acceleration limit after the last two."""
        before, last = self._before, self.last
        if before is None or last is None:
            return True
        return all([abs(c - 2.0 * b + a) <= most for a, b, c, most in zip(before, last, target, self._largest)])

    def fit(self, wanted: int, steady: int, target: Callable[[int], Pose]) -> int:
        """Return an advance [ns] whose target keeps the limits: `wanted`, or as near to it as halving finds.

        Args:
            wanted, steady: Advances [ns]; `steady` is the one that changes nothing, and is not asked about.
            target: From an advance [ns] to the target there.
        """
        if wanted == steady or self.allow(target(wanted)):
            return wanted
        refused, accepted = wanted, steady
        for _ in range(HALVINGS):
            middle = (refused + accepted) // 2
            if self.allow(target(middle)):
                accepted = middle
            else:
                refused = middle
        return accepted

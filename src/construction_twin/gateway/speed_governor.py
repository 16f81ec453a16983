"""Playing more slowly, on the same path: how far playout time may advance so that no joint exceeds its fraction of the speed.

Time is slowed for all joints together, never a joint by itself. Its rate changes only so fast that the joints' acceleration limits
hold meanwhile. Standard library only; stamps in ns, positions in rad (m for prismatic joints).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from construction_twin.core.interpolation import Pose
from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import CYCLE_NS, NANOSECONDS

#: Halvings with which a cycle's advance is brought into the acceleration limits.
HALVINGS = 5


class TargetChanges:
    """The last two targets, and how much the step to the next one may differ from the step between them.

    That is each joint's acceleration limit with the format's allowance (docs/conventions.md, limits).
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
        """Return an advance [ns] whose `target` keeps the limits: `wanted`, or as near to it as halving finds.

        `steady` is the advance that changes nothing, and is not asked about.
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


#: Fraction of the acceleration limits for slowing time down; what the motion itself needs of it counts.
BRAKING_FRACTION = 0.95
#: The same for letting it run again.
RISING_FRACTION = 0.5
#: This fraction of the acceleration limits is always available for slowing time: what a plan leaves.
LEAST_FRACTION = 0.02
#: Largest growth of the rate per second.
LARGEST_RISE = 1.0
#: The same after the arm has stood: as fast as it may, because what it trails meanwhile is made up for slowly.
STARTING_FRACTION = 0.8
#: Largest growth of the rate in a cycle after the arm has stood: it bounds what the motion's own acceleration grows by.
LARGEST_START = 0.1
#: How much a step may exceed the limit because of the wire's rounding, as a fraction of the limit.
ROUNDING_FRACTION = 0.1


class Governor:
    """Bounds the rate of playout time."""

    def __init__(self, limits: MotionLimits, decimals: int, cycle_ns: int = CYCLE_NS):
        self._cycle_ns = cycle_ns
        self._cycle = cycle_ns / NANOSECONDS
        self._velocity = limits.velocity
        self._acceleration = limits.acceleration
        self._digit = limits.last_digits(decimals)
        #: Of the targets played, whether a limit is in force or not; who plays them notes them.
        self.changes = TargetChanges(limits, decimals, cycle_ns)
        self._steps: tuple[float, ...] = ()
        self.fraction = 1.0
        self.restart()

    def restart(self) -> None:
        """Begin with another stream, at rest; the fraction stays."""
        #: False while the rate of time needs no control.
        self.active = self.fraction < 1.0
        #: Rate of playout time in the last cycle; None: whatever it would be without a limit.
        self.rate: float | None = None
        self._starting = False

    def stand(self) -> None:
        """Let time begin to run anew from a standstill, as fast as the acceleration limits allow."""
        self.active = self._starting = True
        self.rate = 0.0
        self.changes.clear()

    def limit(self, fraction: float) -> None:
        """Allow every joint this fraction of its velocity limit from now on, 0 to 1."""
        self.fraction = fraction
        self._steps = tuple([fraction * v * self._cycle for v in self._velocity])
        if fraction < 1.0 and not self.active:
            self.restart()

    def advance(
        self, commands: Sequence[tuple[int, Pose]], wanted: int, elapsed: int, target: Callable[[int], Pose]
    ) -> int:
        """Return how far playout time may advance in this cycle [ns], at most `wanted`.

        Args:
            commands: Stamps [ns] and poses [rad]; playout time lies between the first two.
            wanted: How far it would advance without a limit [ns].
            elapsed: Controller time since the last cycle [ns].
            target: From an advance [ns] to the target there [rad].
        """
        free = wanted / elapsed
        last = free if self.rate is None else min(self.rate, free)
        goal, fall, rise = self._bounds(commands, free, last, elapsed / NANOSECONDS)
        rate = min(max(goal, last - fall, 0.0), last + rise, free)
        if rate >= min(goal, free):
            self._starting = False
        step = self._fit(round(rate * elapsed), last, fall, elapsed, target)
        if step >= wanted and self.fraction >= 1.0:
            self.active = False
        self.rate = step / elapsed
        return step

    def _bounds(
        self, commands: Sequence[tuple[int, Pose]], free: float, rate: float, period: float
    ) -> tuple[float, float, float]:
        """Return the rate to strive for, and by how much it may fall and rise in this cycle."""
        goal, fall, rise, rising = free, math.inf, LARGEST_RISE * period, RISING_FRACTION
        if self._starting:
            rise, rising = LARGEST_START, STARTING_FRACTION
        last = min(len(commands) - 1, 4)
        if last == 0:
            return goal, fall, math.inf
        (stamp0, q0), (stamp2, q2) = commands[0], commands[last]
        span = (stamp2 - stamp0) / NANOSECONDS
        q1 = commands[last // 2][1] if last == 4 else None
        moves = False
        for j, (start, end) in enumerate(zip(q0, q2)):
            if start == end:
                continue
            moves = True
            speed = abs(end - start) / span
            goal = min(goal, self.fraction * self._velocity[j] / speed)
            limit, own = self._acceleration[j], 0.0
            if q1 is not None:
                own = math.copysign(rate * rate * 4.0, end - start) * (end - 2.0 * q1[j] + start) / (span * span)
            fall = min(fall, max(LEAST_FRACTION * limit, BRAKING_FRACTION * limit + own) * period / speed)
            rise = min(rise, max(0.0, rising * limit - own) * period / speed)
        return goal, fall, rise if moves else math.inf

    def _fit(self, step: int, last: float, fall: float, elapsed: int, target: Callable[[int], Pose]) -> int:
        """Return `step` [ns], changed as far as this very cycle's poses ask for it."""
        old_target = self.changes.last
        if old_target is None or self.fraction >= 1.0:
            return step
        cycles = elapsed / self._cycle_ns
        excess = 1.0
        for new, old, allowed, digit in zip(target(step), old_target, self._steps, self._digit):
            allowed = (allowed + min(digit, ROUNDING_FRACTION * allowed)) * cycles
            if allowed and abs(new - old) > excess * allowed:
                excess = abs(new - old) / allowed
        if excess > 1.0:
            step = min(step, max(math.floor(step / excess), math.ceil((last - fall) * elapsed) if fall < last else 0))
        return self.changes.fit(step, round(last * elapsed), target)

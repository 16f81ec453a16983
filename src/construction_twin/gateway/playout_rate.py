"""The rate at which playout time runs: 1, but for another delay, drifting clocks, a speed limit and a start from a standstill.

Time is moved for all joints together, never for a joint by itself, so the path stays what it is. Played at a rate 1 + r, a
motion's velocity is multiplied by 1 + r and its acceleration by (1 + r)^2, and a change of r adds velocity times dr/dt: the rate
changes only as far as the joints' limits leave room for. ns; rad, m for prismatic joints.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from construction_twin.core.interpolation import Pose
from construction_twin.core.limits import MotionLimits
from construction_twin.core.units import CYCLE_NS, NANOSECONDS


class Pace(NamedTuple):
    """How far the rate may be from 1 while time is moved, backwards and ahead, and its largest change [1/s]."""

    back: float
    ahead: float
    change: float


#: For clock drift, and to shrink a delay. At 2 rad/s that adds 0.01 rad/s^2; it takes 1.8 s to move a cycle.
CALM = Pace(0.005, 0.005, 0.005)
#: For a delay that has become too short. At 2 rad/s that adds 0.2 rad/s^2, 8 % of what axis 1 may. It takes 1.1 s to gain 30 ms.
URGENT = Pace(0.05, 0.005, 0.1)
#: To make up for what was put off. A motion at 0.992 of its velocity and 0.98 of its acceleration limits keeps inside them.
CATCH_UP = Pace(0.05, 0.008, 0.1)

#: Halvings with which a cycle's advance is brought into the acceleration limits.
HALVINGS = 5
#: Fraction of the acceleration limits for slowing time down; what the motion itself needs of it counts.
BRAKING_FRACTION = 0.95
#: The same for letting it run again; and after the arm has stood, because what it trails meanwhile is made up for slowly.
RISING_FRACTION, STARTING_FRACTION = 0.5, 0.8
#: This fraction of the acceleration limits is always available for slowing time: what a plan leaves.
LEAST_FRACTION = 0.02
#: Largest growth of the rate per second; and in a cycle after the arm has stood.
LARGEST_RISE, LARGEST_START = 1.0, 0.1
#: How much a step may exceed the limit because of the wire's rounding, as a fraction of the limit.
ROUNDING_FRACTION = 0.1

#: Stamps [ns] and poses.
Commands = Sequence[tuple[int, Pose]]


class PlayoutRate:
    """How far playout time advances, cycle by cycle.

    Attributes:
        remaining: What playout time is still to be moved by [ns]; ahead is positive.
        shift: What it was moved by in the last cycle [ns].
        put_off: How much of `remaining` a speed limit or a standstill has put off [ns].
    """

    def __init__(self, limits: MotionLimits, decimals: int, cycle_ns: int = CYCLE_NS):
        self.cycle_ns = cycle_ns
        self._cycle = cycle_ns / NANOSECONDS
        self._velocity, self._acceleration = limits.velocity, limits.acceleration
        self._digit = limits.last_digits(decimals)
        # each joint's acceleration limit with the format's allowance (docs/conventions.md, limits)
        allowances = limits.allowances(decimals, self._cycle)
        self._largest = [(a + extra) * self._cycle * self._cycle for a, extra in zip(limits.acceleration, allowances)]
        slope = cycle_ns * self._cycle
        self._paces = {
            pace: (round(pace.back * cycle_ns), round(pace.ahead * cycle_ns), round(pace.change * slope))
            for pace in (CALM, URGENT, CATCH_UP)
        }
        self._steps: tuple[float, ...] = ()
        self._fraction = 1.0
        self.clear()

    def clear(self) -> None:
        """Begin with another stream, at rest; the speed limit stays."""
        self.remaining = self.shift = self.put_off = 0
        self._pace = self._paces[CALM]
        # the last two targets
        self._before: Pose | None = None
        self._last: Pose | None = None
        self._free()

    def _free(self) -> None:
        self._limits = self._fraction < 1.0
        # in the last cycle; None: whatever it would be without a limit
        self._rate: float | None = None
        self._starting = False

    @property
    def steady(self) -> bool:
        """Whether playout time runs at the controller's rate, neither moved nor limited."""
        return not (self.remaining or self.shift or self._limits)

    def record_target(self, target: Pose) -> None:
        """Store the target of a cycle, one cycle after the one before it."""
        self._before, self._last = self._last, target

    def limit(self, fraction: float) -> None:
        """Allow every joint this fraction of its velocity limit from now on, 0 to 1."""
        self._fraction = fraction
        self._steps = tuple([fraction * v * self._cycle for v in self._velocity])
        if fraction < 1.0 and not self._limits:
            self._free()

    def move(self, by: int, urgent: bool) -> None:
        """Begin to move playout time [ns]; a move under way keeps its pace."""
        if urgent or not (self.remaining or self.shift):
            self._pace = self._paces[URGENT if urgent else CALM]
        self.remaining += by

    def skip(self, by: int) -> None:
        """Drop rest that was put off."""
        self.put_off -= by
        self.remaining -= by

    def restart_from_rest(self, put_off: int) -> None:
        """Put off what was not played; time begins anew from a standstill, as fast as the acceleration limits allow."""
        self._put_off(put_off)
        self._limits = self._starting = True
        self._rate, self._before, self._last = 0.0, None, None

    def _put_off(self, time: int) -> None:
        self.remaining += time
        self.put_off += time
        self._pace = self._paces[CATCH_UP]

    def advance(self, elapsed: int, commands: Commands, begun: bool, rests: bool, target: Callable[[int], Pose]) -> int:
        """Return how far playout time advances in this cycle.

        Args:
            elapsed: Controller time.
            commands: Playout time lies between the first two, once it has `begun`.
            rests: They and the last pose played are one pose.
            target: Pose at an advance.
        """
        if elapsed != self.cycle_ns:
            # what comes after missed telegrams cannot be compared with what was before them
            self._before = self._last = None
        before, advance = self.shift, elapsed
        if rests:
            # every stamp has the same pose: time can be set at once
            advance += self.remaining
            self.remaining = self.shift = 0
        elif self.remaining or before:
            advance += self._step()
        if self.put_off:
            self.put_off = max(0, min(self.put_off, self.remaining))
        if self._limits and (rests or not begun):
            self._free()
        elif self._limits:
            allowed = self._limited(commands, advance, elapsed, target)
            if allowed < advance:
                self._put_off(advance - allowed)
                advance = allowed
        # what a speed limit has held back is inside the acceleration limits already
        if self.shift != before and advance == elapsed + self.shift:
            advance = self._fit(advance, elapsed + before, target)
            self.remaining += self.shift - (advance - elapsed)
            self.shift = advance - elapsed
        return advance

    def _step(self) -> int:
        """Return the shift of this cycle [ns]; the rate returns to 1 where all has been moved."""
        back, ahead, change = self._pace
        distance = abs(self.remaining)
        # the largest shift after which slowing down still ends in time
        cycles = (math.isqrt(1 + 8 * distance // change) - 1) // 2
        wanted = (distance + change * cycles * (cycles + 1) // 2) // (cycles + 1)
        wanted = min(wanted, ahead) if self.remaining > 0 else -min(wanted, back)
        self.shift = min(max(wanted, self.shift - change), self.shift + change)
        self.remaining -= self.shift
        return self.shift

    def _limited(self, commands: Commands, wanted: int, elapsed: int, target: Callable[[int], Pose]) -> int:
        """Return how much of an advance `wanted` the speed limit allows [ns]."""
        free = wanted / elapsed
        last = free if self._rate is None else min(self._rate, free)
        goal, fall, rise = self._bounds(commands, free, last, elapsed / NANOSECONDS)
        rate = min(max(goal, last - fall, 0.0), last + rise, free)
        if rate >= min(goal, free):
            self._starting = False
        step = round(rate * elapsed)
        if self._last is not None and self._fraction < 1.0:
            # as far as this very cycle's poses ask for it
            cycles, excess = elapsed / self.cycle_ns, 1.0
            for new, old, allowed, digit in zip(target(step), self._last, self._steps, self._digit):
                allowed = (allowed + min(digit, ROUNDING_FRACTION * allowed)) * cycles
                if allowed and abs(new - old) > excess * allowed:
                    excess = abs(new - old) / allowed
            if excess > 1.0:
                slowest = math.ceil((last - fall) * elapsed) if fall < last else 0
                step = min(step, max(math.floor(step / excess), slowest))
            step = self._fit(step, round(last * elapsed), target)
        if step >= wanted and self._fraction >= 1.0:
            self._limits = False
        self._rate = step / elapsed
        return step

    def _bounds(self, commands: Commands, free: float, rate: float, period: float) -> tuple[float, float, float]:
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
            goal = min(goal, self._fraction * self._velocity[j] / speed)
            limit, own = self._acceleration[j], 0.0
            if q1 is not None:
                own = math.copysign(rate * rate * 4.0, end - start) * (end - 2.0 * q1[j] + start) / (span * span)
            fall = min(fall, max(LEAST_FRACTION * limit, BRAKING_FRACTION * limit + own) * period / speed)
            rise = min(rise, max(0.0, rising * limit - own) * period / speed)
        return goal, fall, rise if moves else math.inf

    def _fit(self, wanted: int, steady: int, target: Callable[[int], Pose]) -> int:
        """Return an advance [ns] inside the acceleration limits: `wanted`, or as near to it from `steady` as halving finds."""
        if wanted == steady or self._is_within_limits(target(wanted)):
            return wanted
        refused, accepted = wanted, steady
        for _ in range(HALVINGS):
            middle = (refused + accepted) // 2
            if self._is_within_limits(target(middle)):
                accepted = middle
            else:
                refused = middle
        return accepted

    def _is_within_limits(self, target: Pose) -> bool:
        before, last = self._before, self._last
        if before is None or last is None:
            return True
        return all([abs(c - 2.0 * b + a) <= most for a, b, c, most in zip(before, last, target, self._largest)])

"""The last stage before the corrections: a position that follows targets and never leaves the joint limits, or comes into them.

One step per controller cycle. A target within the limits is met exactly, any other is chased until it is met (`settling`); law 3 of
docs/architecture.md. Joint values in rad and rad per cycle, m for prismatic joints.
"""

from __future__ import annotations

import math

from construction_twin.core.limits import RANGE_SLACK, MotionLimits, braking_distance
from construction_twin.core.units import CYCLE


def braking_step(distance: float, deceleration: float) -> float:
    """Return the largest step per cycle after which braking ends within `distance`: the inverse of step + `braking_distance`."""
    if distance <= 0.0:
        return 0.0
    cycles = math.floor((math.sqrt(1.0 + 8.0 * distance / deceleration) - 1.0) / 2.0)
    return (distance + deceleration * cycles * (cycles + 1) / 2.0) / (cycles + 1)


class Follower:
    """Per-joint target following inside the limits, from rest at `q`; one call per `cycle` [s]."""

    def __init__(self, limits: MotionLimits, decimals: int, q: tuple[float, ...], cycle: float = CYCLE):
        self.cycle = cycle
        # an arm that stands outside its range is not moved by itself
        self._lower, self._upper = tuple(map(min, limits.lower, q)), tuple(map(max, limits.upper, q))
        self._speed = tuple(v * cycle for v in limits.velocity)
        self._budget = tuple(a * cycle * cycle for a in limits.acceleration)
        self._wide_budget = tuple(
            (a + allowance) * cycle * cycle
            for a, allowance in zip(limits.acceleration, limits.allowances(decimals, cycle))
        )
        self._rounding = limits.last_digits(decimals)
        self._chasing_speed = self._speed
        self._target = list(q)
        self._step = [0.0] * len(q)
        self.position: tuple[float, ...] = tuple(q)
        self._before = self.position
        #: True while a joint has not met its target yet.
        self.settling = False

    @property
    def at_rest(self) -> bool:
        """Whether the last step was zero."""
        return not any(self._step)

    def limit(self, fraction: float) -> None:
        """Limit the chase of a target to this fraction of the velocity limits, 0 to 1, or to the target's own speed."""
        self._chasing_speed = tuple(fraction * speed for speed in self._speed)

    def follow(self, target: tuple[float, ...]) -> tuple[float, ...]:
        """Step towards `target` [rad] and return the new position [rad]."""
        position = []
        settling = False
        self._before = self.position
        for index, goal in enumerate(target):
            last = self.position[index]
            if self._allowed(index, goal, goal - last):
                self._step[index] = goal - last
                position.append(goal)
            else:
                settling = True
                goal = min(max(goal, self._lower[index]), self._upper[index])
                self._step[index] = self._chase(index, last, goal)
                position.append(last + self._step[index])
            self._target[index] = goal
        self.settling = settling
        self.position = tuple(position)
        return self.position

    def braking(self) -> tuple[tuple[float, ...], int]:
        """Return the distance of each joint to rest [rad], at most, and the cycles, if `brake` is called in each from now on."""
        distances = tuple([braking_distance(abs(step), budget) for step, budget in zip(self._step, self._budget)])
        return distances, max(math.ceil(abs(step) / budget) for step, budget in zip(self._step, self._budget))

    def rest(self) -> None:
        """Set rest at the present position: the arm stands there."""
        self._step = [0.0] * len(self._step)
        self._target = list(self.position)

    def undo_step(self) -> None:
        """Undo the last step, whose reply was lost, and rest there."""
        self.position = self._before
        self.rest()

    def brake(self) -> tuple[float, ...]:
        """Brake by one step within the limits and return the new position [rad]."""
        self._before = self.position
        for index, step in enumerate(self._step):
            slower = max(0.0, abs(step) - self._budget[index])
            self._step[index] = self._leave_braking_room(index, math.copysign(slower, step))
        self.position = tuple(last + step for last, step in zip(self.position, self._step))
        self._target = list(self.position)
        return self.position

    def _allowed(self, index: int, goal: float, step: float) -> bool:
        lower, upper = self._lower[index], self._upper[index]
        if not lower - RANGE_SLACK <= goal <= upper + RANGE_SLACK:
            return False
        if abs(step) > self._speed[index] + self._rounding[index]:
            return False
        # a target is met at its own speed as well: a faster joint would overshoot, and with few decimals oscillate for ever
        drift = goal - self._target[index]
        if max(abs(step - self._step[index]), abs(step - drift)) > self._wide_budget[index] * (1 + 1e-9):
            return False
        if step != drift and not self._can_stop_with(index, step, drift):
            return False
        # rounding can make a step larger than the motion's; the wide budget takes that out in the first braking cycle
        speed = abs(step) - self._rounding[index]
        room = upper - goal if step > 0.0 else goal - lower
        return speed <= 0.0 or braking_distance(speed, self._budget[index]) <= room + RANGE_SLACK

    def _can_stop_with(self, index: int, step: float, drift: float) -> bool:
        """Return whether a joint that meets a target, which moves by `drift`, with `step` can stop where the target can.

        The target may brake as hard as the joint, so a joint that is faster overshoots by the excess in every cycle of braking:
        allowed are one cycle's budget, and what rounding adds to a step.
        """
        if step * drift <= 0.0:
            return True
        budget, excess = self._budget[index], abs(step) - self._rounding[index]
        return excess <= abs(drift) or (
            braking_distance(excess, budget) - braking_distance(abs(drift), budget) <= budget
        )

    def _chase(self, index: int, last: float, goal: float) -> float:
        budget, speed = self._budget[index], self._speed[index]
        drift = goal - self._target[index]
        behind = self._target[index] - last
        if drift * behind > 0.0:
            # a target that runs ahead may brake as hard as the joint can: a chase that expects its present speed to last overshoots
            ahead = abs(behind) + abs(drift) + braking_distance(abs(drift), budget)
            wanted = math.copysign(braking_step(ahead, budget), behind)
        else:
            wanted = drift + math.copysign(braking_step(abs(behind), budget), behind)
        previous = self._step[index]
        # a limit on the chase is no reason to brake harder, or to fall behind a target that moves faster
        most = min(speed, max(self._chasing_speed[index], abs(drift), abs(previous) - budget))
        wanted = min(max(wanted, -most), most)
        return self._leave_braking_room(index, min(max(wanted, previous - budget), previous + budget))

    def _leave_braking_room(self, index: int, step: float) -> float:
        """Return `step`, slowed as far as the wide budget allows when it would leave no room to brake inside the range."""
        last, previous, wide = self.position[index], self._step[index], self._wide_budget[index]
        if step > 0.0:
            return max(min(step, braking_step(self._upper[index] - last, self._budget[index])), previous - wide)
        return min(max(step, -braking_step(last - self._lower[index], self._budget[index])), previous + wide)

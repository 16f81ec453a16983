"""The mock controller's own motions: the ramp of the E-stop, programs of the controller, and the speed limit of T1.

Pure: one step per cycle. Angles in rad, plain tuples, standard library only.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.units import CYCLE
from construction_twin.mock.servo import Chase

#: Speed of the tool in T1 [m/s] (docs/rsi.md, section 7: the standard value, without a source there).
T1_SPEED = 0.25
#: Fraction of the velocity and acceleration limits that a program of the controller uses unless it is given a time.
JOG_FRACTION = 0.3
#: Largest velocity and acceleration of the quintic rest-to-rest profile over a unit distance in unit time.
_PEAK_VELOCITY, _PEAK_ACCELERATION = 15.0 / 8.0, 10.0 / math.sqrt(3.0)


class EmergencyBrake:
    """The STOP ramp: all axes come to rest at the same time, along a straight line, within the slowest axis' limit.

    `distance` is that of the arm to rest, including its lag behind the setpoint [rad].
    """

    def __init__(
        self,
        position: Sequence[float],
        step: Sequence[float],
        acceleration: Sequence[float],
        measured: Sequence[float],
        period: float = CYCLE,
    ):
        self.position = tuple(position)
        self._step = tuple(step)
        budgets = [limit * period * period for limit in acceleration]
        self.cycles = math.ceil(max(abs(s) / budget for s, budget in zip(step, budgets)) - 1e-9)
        self._left = self.cycles
        fraction = (self.cycles - 1) / 2.0 if self.cycles else 0.0
        self.distance = tuple(q + s * fraction - now for q, s, now in zip(position, step, measured))

    @property
    def done(self) -> bool:
        """True at rest."""
        return self._left <= 0

    def advance(self) -> tuple[float, ...]:
        """Return the setpoint of the next cycle [rad]; at rest always the same."""
        if self._left > 0:
            self._left -= 1
            fraction = self._left / self.cycles
            self.position = tuple([q + s * fraction for q, s in zip(self.position, self._step)])
        return self.position


class Program:
    """A motion of the controller's own from rest to rest, straight in joint space; duration 0: by `JOG_FRACTION` of the limits."""

    def __init__(
        self,
        start: Sequence[float],
        goal: Sequence[float],
        velocity: Sequence[float],
        acceleration: Sequence[float],
        duration: float = 0.0,
        period: float = CYCLE,
    ):
        self._start, self._goal = tuple(start), tuple(goal)
        distances = [abs(b - a) for a, b in zip(start, goal)]
        quickest = _shortest(distances, velocity, acceleration, 1.0)
        if duration and duration < quickest:
            raise ConfigurationError(
                "jog duration", duration, f"at least {quickest:.3f} s: a shorter motion exceeds the limits"
            )
        self.cycles = max(
            1, math.ceil((duration or _shortest(distances, velocity, acceleration, JOG_FRACTION)) / period)
        )
        self._cycle = 0

    @property
    def done(self) -> bool:
        """True at the goal."""
        return self._cycle >= self.cycles

    def advance(self) -> tuple[float, ...]:
        """Return the pose of the next cycle [rad]."""
        self._cycle += 1
        if self.done:
            return self._goal
        u = self._cycle / self.cycles
        fraction = u * u * u * (10.0 + u * (6.0 * u - 15.0))
        return tuple([a + fraction * (b - a) for a, b in zip(self._start, self._goal)])


class ToolSpeedLimit:
    """T1: the setpoint follows the corrected one within the axes' limits, and with the tool no faster than a limit.

    What a KR C4 really does about fast corrections in T1 is not known (docs/rsi.md, section 14): it may as well end the session.
    """

    def __init__(
        self,
        position: Sequence[float],
        step: Sequence[float],
        velocity: Sequence[float],
        acceleration: Sequence[float],
        tool_position: Callable[[tuple[float, ...]], Sequence[float]],
        speed: float = T1_SPEED,
        period: float = CYCLE,
    ):
        self._chases = [Chase(q, q, s, v, a, period) for q, s, v, a in zip(position, step, velocity, acceleration)]
        self._tool_position = tool_position
        self._longest_step = speed * period
        self._ending = False

    @property
    def done(self) -> bool:
        """True when it was lifted and every axis has met its setpoint since."""
        return self._ending and all(chase.met for chase in self._chases)

    def lift(self) -> None:
        """Let the arm catch up within its own limits."""
        self._ending = True

    def follow(self, setpoint: Sequence[float]) -> tuple[float, ...]:
        """Return the setpoint of this cycle in place of `setpoint` [rad]."""
        steps = [chase.aim(goal) for chase, goal in zip(self._chases, setpoint)]
        if self._ending or not any(steps):
            return tuple([chase.move() for chase in self._chases])
        here = tuple([chase.position for chase in self._chases])
        there = tuple([q + s for q, s in zip(here, steps)])
        distance = math.dist(self._tool_position(here), self._tool_position(there))
        if distance <= self._longest_step:
            return tuple([chase.move() for chase in self._chases])
        fraction = self._longest_step / distance
        return tuple([chase.move(chase.within_budget(fraction * step)) for chase, step in zip(self._chases, steps)])


def _shortest(
    distances: Sequence[float], velocity: Sequence[float], acceleration: Sequence[float], fraction: float
) -> float:
    """Return the shortest time of a quintic motion over `distances` [rad] at a fraction of the limits [s]."""
    by_velocity = max(_PEAK_VELOCITY * d / (fraction * v) for d, v in zip(distances, velocity))
    by_acceleration = max(math.sqrt(_PEAK_ACCELERATION * d / (fraction * a)) for d, a in zip(distances, acceleration))
    return max(by_velocity, by_acceleration)

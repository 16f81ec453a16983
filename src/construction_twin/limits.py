"""The motion check that the gate and the gateway share: what a stream of setpoints may do from one to the next.

Pure and per joint; standard library only, because the gateway on the cell PC runs it. Angles in rad, stamps in ns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from construction_twin.errors import MotionRefused
from construction_twin.units import CYCLE, NANOSECONDS, format_allowance

#: Slack of the range check [rad]: what a conversion between degrees and radians may add at a range's end.
RANGE_SLACK = 1e-9


@dataclass(frozen=True)
class MotionLimits:
    """What each joint may do.

    Attributes
    ----------
    names : tuple of str
        Joint names, in the order of every other tuple.
    lower, upper : tuple of float, shape (n,)
        Range [rad].
    velocity, acceleration : tuple of float, shape (n,)
        [rad/s], [rad/s^2], both positive.
    """

    names: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]

    @classmethod
    def of(cls, robot) -> MotionLimits:
        """Return the limits of a `RobotModel`."""
        return cls(robot.joint_names, robot.lower, robot.upper, robot.velocity, robot.acceleration)

    def check_range(self, q: tuple[float, ...]) -> None:
        """Raise MotionRefused naming the first joint of `q` [rad] that is not a number inside its range."""
        if len(q) != len(self.names) or not all(map(math.isfinite, q)):
            raise MotionRefused("values", "", math.nan, math.nan)
        for name, value, lower, upper in zip(self.names, q, self.lower, self.upper):
            if not lower - RANGE_SLACK <= value <= upper + RANGE_SLACK:
                raise MotionRefused("range", name, value, upper if value > upper else lower)


def outside_tolerance(q: tuple[float, ...], reference: tuple[float, ...], tolerance: float) -> int | None:
    """Return the index of the first joint further than `tolerance` [rad] from `reference`, or None."""
    for index, (value, expected) in enumerate(zip(q, reference)):
        if abs(value - expected) > tolerance:
            return index
    return None


def braking_distance(step: float, deceleration: float) -> float:
    """Return how far braking goes on after a step.

    Discrete and exact: the sum of step - deceleration, step - 2 deceleration, ... as long as they are positive. The textbook's
    v^2 / 2a is half a step longer and would refuse a motion that ends at the end of its range at full deceleration.

    Parameters
    ----------
    step : float
        [rad] per cycle, not negative.
    deceleration : float
        Change of the step per cycle [rad], positive.

    Returns
    -------
    distance : float
        [rad]
    """
    cycles = math.floor(step / deceleration)
    return cycles * step - deceleration * cycles * (cycles + 1) / 2


class MotionCheck:
    """Checks each setpoint of a stream against the one before: range, velocity, acceleration, room to brake.

    A step may be anything between standing still and the previous step, widened by one cycle's acceleration budget: slowing
    down harder than the limits is the follower's to absorb (design, law 3), speeding up or turning round harder is refused.
    The budget includes what rounding to the wire's decimals adds.

    Parameters
    ----------
    limits : MotionLimits
    decimals : int
        Decimals of a degree on the wire.
    """

    def __init__(self, limits: MotionLimits, decimals: int):
        self.limits = limits
        self._allowance = format_allowance(decimals)
        self._rounding = math.radians(10.0**-decimals)
        self._stamp = 0
        self._period = CYCLE
        self._position: tuple[float, ...] = ()
        self._velocity: tuple[float, ...] = ()

    @property
    def position(self) -> tuple[float, ...]:
        """The last setpoint accepted [rad]."""
        return self._position

    def start(self, stamp: int, q: tuple[float, ...]) -> None:
        """Begin a stream at rest at `q` [rad] with stamp [ns]; the first step is checked against it."""
        self._stamp = stamp
        self._period = CYCLE
        self._position = tuple(q)
        self._velocity = (0.0,) * len(q)

    def accept(self, stamp: int, q: tuple[float, ...]) -> None:
        """Check the next setpoint and remember it; on refusal nothing is remembered.

        Parameters
        ----------
        stamp : int
            Nominal time of the setpoint [ns]; must be later than the last one's.
        q : tuple, shape (n,)
            Joint angles [rad].

        Raises
        ------
        MotionRefused
            Reason ``values``, ``range``, ``order``, ``velocity``, ``acceleration`` or ``braking_room``.
        """
        self.limits.check_range(q)
        period = (stamp - self._stamp) / NANOSECONDS
        if period <= 0.0:
            raise MotionRefused("order", "", period, 0.0, "s")
        velocity = tuple((value - last) / period for value, last in zip(q, self._position))
        mean_period = (period + self._period) / 2
        for index in range(len(q)):
            self._check_joint(index, q[index], velocity[index], period, mean_period)
        self._stamp, self._period = stamp, period
        self._position, self._velocity = tuple(q), velocity

    def _check_joint(self, index: int, value: float, velocity: float, period: float, mean_period: float) -> None:
        limits = self.limits
        noise = self._rounding / period
        if abs(velocity) > limits.velocity[index] + noise:
            raise MotionRefused("velocity", limits.names[index], velocity, limits.velocity[index], "rad/s")
        acceleration = limits.acceleration[index]
        budget = acceleration * mean_period + self._allowance * CYCLE * CYCLE / period
        last = self._velocity[index]
        if not min(0.0, last) - budget <= velocity <= max(0.0, last) + budget:
            measured = (velocity - last) / mean_period
            raise MotionRefused("acceleration", limits.names[index], measured, acceleration, "rad/s^2")
        speed = abs(velocity) - noise
        if speed > 0.0:
            room = limits.upper[index] - value if velocity > 0.0 else value - limits.lower[index]
            needed = braking_distance(speed * CYCLE, acceleration * CYCLE * CYCLE)
            if needed > room + RANGE_SLACK:
                raise MotionRefused("braking_room", limits.names[index], needed, room)

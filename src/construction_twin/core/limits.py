"""The motion check of gate and gateway, per joint. Angles in rad, prismatic joints in m, stamps in ns."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from construction_twin.core.errors import MotionRefused
from construction_twin.core.sentences import Quantity, Sentence
from construction_twin.core.units import CYCLE, NANOSECONDS, format_allowance, last_digit

#: Slack of the range check [rad], [m]: what a conversion of units may add at a range's end.
RANGE_SLACK = 1e-9
#: An arm may stand this far outside its range, as its encoders read it, and come in from there [rad], of a prismatic joint [m].
OUTSIDE = (math.radians(0.05), 1e-4)


@dataclass(frozen=True)
class MotionLimits:
    """What each joint may do: range [rad], velocity [rad/s], acceleration [rad/s^2]; m for rad where `linear` is True."""

    names: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]
    linear: tuple[bool, ...] = ()

    def __post_init__(self) -> None:
        if not self.linear:
            object.__setattr__(self, "linear", (False,) * len(self.names))

    @classmethod
    def of(cls, robot) -> MotionLimits:
        """Return the limits of a `RobotModel`."""
        return cls(robot.joint_names, robot.lower, robot.upper, robot.velocity, robot.acceleration, robot.linear)

    def last_digits(self, decimals: int) -> tuple[float, ...]:
        """Return the value of the last decimal on the wire, per joint [rad], [m]."""
        return tuple(last_digit(decimals, slides) for slides in self.linear)

    def allowances(self, decimals: int, cycle: float = CYCLE) -> tuple[float, ...]:
        """Return the format's allowance per joint [rad/s^2], [m/s^2], for values one `cycle` [s] apart."""
        return tuple(format_allowance(decimals, slides, cycle) for slides in self.linear)

    def refusal(self, reason: str, index: int, value: float, limit: float, per: str = "") -> MotionRefused:
        """Return the refusal of joint `index`, in its unit; `per` is appended to it, e.g. ``/s``."""
        unit = "m" if self.linear[index] else "rad"
        return MotionRefused(reason, self.names[index], value, limit, unit + per)

    def check_range(self, q: tuple[float, ...], last: tuple[float, ...] = ()) -> None:
        """Raise MotionRefused naming the first joint of `q` [rad], [m] that is not a number inside its range.

        From `last` on, up to `OUTSIDE` out of the range, a joint may stay or come in.
        """
        if len(q) != len(self.names) or not all(map(math.isfinite, q)):
            raise MotionRefused("values", "", math.nan, math.nan)
        for index, (value, lower, upper) in enumerate(zip(q, self.lower, self.upper)):
            if not lower - RANGE_SLACK <= value <= upper + RANGE_SLACK:
                most, before = OUTSIDE[self.linear[index]], last[index] if last else lower
                if not max(lower - most, min(lower, before)) <= value <= min(upper + most, max(upper, before)):
                    raise self.refusal("range", index, value, upper if value > upper else lower)


def outside_tolerance(
    q: tuple[float, ...], reference: tuple[float, ...], tolerance: float | Sequence[float]
) -> int | None:
    """Return the index of the first joint beyond its tolerance, or the one for all [rad], [m]; None: every joint is within."""
    tolerances = (tolerance,) * len(q) if isinstance(tolerance, float) else tolerance
    for index, (value, expected, allowed) in enumerate(zip(q, reference, tolerances)):
        if abs(value - expected) > allowed:
            return index
    return None


def distance_off(
    q: tuple[float, ...], reference: tuple[float, ...], limits: MotionLimits, tolerances: Sequence[float]
) -> str:
    """Return how far the first joint beyond its tolerance [rad], [m] is from its reference, for people; "" when none is."""
    off = outside_tolerance(q, reference, tolerances)
    if off is None:
        return ""
    distance = Quantity(q[off] - reference[off], "m" if limits.linear[off] else "rad")
    return Sentence("{joint} is {distance:.6q}", joint=limits.names[off], distance=distance)


def braking_distance(step: float, deceleration: float) -> float:
    """Return the distance to rest after a cycle's step, which falls by the deceleration, > 0, in each further cycle [rad].

    Exact: the textbook's v^2 / 2a is half a step longer and would refuse to end at the end of a range at full deceleration.
    """
    cycles = math.floor(step / deceleration)
    return cycles * step - deceleration * cycles * (cycles + 1) / 2


class MotionCheck:
    """Checks each setpoint of a stream against the one before: range, velocity, acceleration, room to brake.

    A step lies between standing still and the previous step, widened by one cycle's acceleration and the wire's rounding: braking
    harder is the follower's to absorb (law 3), speeding up or turning round harder is refused.
    """

    def __init__(self, limits: MotionLimits, decimals: int):
        self.limits = limits
        self._allowance = limits.allowances(decimals)
        self._rounding = limits.last_digits(decimals)
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
        """Check and store the next setpoint, by its nominal time [ns]; MotionRefused leaves the stream as it was."""
        self.limits.check_range(q, self._position)
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
        noise = self._rounding[index] / period
        if abs(velocity) > limits.velocity[index] + noise:
            raise limits.refusal("velocity", index, velocity, limits.velocity[index], "/s")
        acceleration = limits.acceleration[index]
        budget = acceleration * mean_period + self._allowance[index] * CYCLE * CYCLE / period
        last = self._velocity[index]
        if not min(0.0, last) - budget <= velocity <= max(0.0, last) + budget:
            measured = (velocity - last) / mean_period
            raise limits.refusal("acceleration", index, measured, acceleration, "/s^2")
        speed = abs(velocity) - noise
        if speed > 0.0:
            room = limits.upper[index] - value if velocity > 0.0 else value - limits.lower[index]
            needed = braking_distance(speed * CYCLE, acceleration * CYCLE * CYCLE)
            if needed > room + RANGE_SLACK:
                raise limits.refusal("braking_room", index, needed, room)

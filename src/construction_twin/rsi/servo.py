"""Servo models of the mock controller: what the axes really do about their setpoints, one step per 4 ms cycle.

Timing: reply k sets the setpoint of cycle k, and `step` turns it into the position at the end of that cycle, which
packet k + 1 reports. With `IdealServo(delay_cycles=3)` packet k + 3 reports exactly the setpoint of cycle k. Angles in
rad, plain tuples, standard library only, no clock.
"""

from __future__ import annotations

import cmath
import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence

from construction_twin.rsi.follower import braking_step
from construction_twin.units import CYCLE


class Servo(ABC):
    """A servo model with joints that can be stalled.

    A stalled joint's measured position stands still whatever its setpoint does. Released, its reference sets out from there
    at rest and approaches the setpoint within velocity and acceleration limits; once it has met the setpoint, position and
    speed, it follows it directly again.
    """

    def __init__(self) -> None:
        self._measured: tuple[float, ...] = ()
        self._setpoint: tuple[float, ...] = ()
        self._stalled: set[int] = set()
        self._catching_up: dict[int, _CatchUp] = {}

    @property
    def measured(self) -> tuple[float, ...]:
        """Measured position [rad], shape (n,)."""
        return self._measured

    @property
    def stalled(self) -> frozenset[int]:
        """Indices of the joints that are stalled now."""
        return frozenset(self._stalled)

    def reset(self, q: Sequence[float]) -> None:
        """Start at rest at `q` [rad], shape (n,); stalled joints stay stalled, there."""
        self._catching_up.clear()
        self._setpoint = tuple(q)
        self._start(self._setpoint)
        self._measured = self._respond(self._setpoint)

    def step(self, setpoint: Sequence[float]) -> tuple[float, ...]:
        """Advance one cycle.

        Parameters
        ----------
        setpoint : sequence of float, length n
            Setpoint of this cycle [rad].

        Returns
        -------
        measured : tuple of float, length n
            Measured position at the end of the cycle [rad].
        """
        reference = list(setpoint)
        for joint in self._stalled:
            reference[joint] = self._measured[joint]
        for joint, catch_up in tuple(self._catching_up.items()):
            reference[joint] = catch_up.step(setpoint[joint])
            if catch_up.done:
                del self._catching_up[joint]
        self._setpoint = tuple(setpoint)
        self._measured = self._respond(tuple(reference))
        return self._measured

    def stall(self, joint: int) -> None:
        """Freeze the measured position of the joint with index `joint`."""
        self._catching_up.pop(joint, None)
        self._stalled.add(joint)
        self._freeze(joint, self._measured[joint])

    def release(self, joint: int, velocity: float, acceleration: float) -> None:
        """Let a stalled joint catch up with its setpoint; no effect on a joint that is not stalled.

        Parameters
        ----------
        joint : int
            Index of the joint.
        velocity, acceleration : float
            Limits of the approach [rad/s], [rad/s^2].
        """
        if joint in self._stalled:
            self._stalled.remove(joint)
            self._catching_up[joint] = _CatchUp(self._measured[joint], self._setpoint[joint], velocity, acceleration)

    @abstractmethod
    def _start(self, q: tuple[float, ...]) -> None:
        """Set the model's state to rest at `q`."""

    @abstractmethod
    def _respond(self, reference: tuple[float, ...]) -> tuple[float, ...]:
        """Advance the model one cycle and return the measured position."""

    @abstractmethod
    def _freeze(self, joint: int, position: float) -> None:
        """Set one joint's state to rest at `position`, forgetting the references it has not acted on yet."""


class IdealServo(Servo):
    """A pure delay: the arm is exactly where it was told to be, some cycles later.

    Parameters
    ----------
    delay_cycles : int, optional
        Cycles from the packet whose reply carries a setpoint to the packet that reports it as reached; at least 1,
        default 3.
    """

    def __init__(self, delay_cycles: int = 3):
        if delay_cycles < 1:
            raise ValueError(f"delay_cycles is {delay_cycles}; expected at least 1")
        super().__init__()
        self._line: deque[list[float]] = deque(maxlen=delay_cycles)

    def _start(self, q: tuple[float, ...]) -> None:
        self._line.extend(list(q) for _ in range(self._line.maxlen))

    def _respond(self, reference: tuple[float, ...]) -> tuple[float, ...]:
        self._line.append(list(reference))
        return tuple(self._line[0])

    def _freeze(self, joint: int, position: float) -> None:
        for reference in self._line:
            reference[joint] = position


class RealisticServo(Servo):
    """A second-order lag per joint, exactly discretised for a setpoint held during the cycle, read by an encoder.

    Following a ramp it trails by 2 zeta / omega seconds (27 ms with the defaults) plus half a cycle of holding.

    Parameters
    ----------
    omega : float, optional
        Natural frequency [rad/s].
    zeta : float, optional
        Damping ratio.
    resolution : float, optional
        Encoder step [rad]; 0 for an exact reading.
    """

    def __init__(self, omega: float = 60.0, zeta: float = 0.8, resolution: float = math.radians(3e-5)):
        if not (omega > 0.0 and zeta > 0.0 and resolution >= 0.0):
            raise ValueError(f"omega {omega}, zeta {zeta}, resolution {resolution}; expected > 0, > 0, >= 0")
        super().__init__()
        self._transition = _transition(omega, zeta, CYCLE)
        self._resolution = resolution
        self._position: list[float] = []
        self._velocity: list[float] = []

    def _start(self, q: tuple[float, ...]) -> None:
        self._position = list(q)
        self._velocity = [0.0] * len(q)

    def _respond(self, reference: tuple[float, ...]) -> tuple[float, ...]:
        (xx, xv), (vx, vv) = self._transition
        for joint, goal in enumerate(reference):
            error, velocity = self._position[joint] - goal, self._velocity[joint]
            self._position[joint] = goal + xx * error + xv * velocity
            self._velocity[joint] = vx * error + vv * velocity
        return tuple(map(self._read, self._position))

    def _freeze(self, joint: int, position: float) -> None:
        self._position[joint] = position
        self._velocity[joint] = 0.0

    def _read(self, position: float) -> float:
        if not self._resolution:
            return position
        return round(position / self._resolution) * self._resolution


class _CatchUp:
    """A reference that approaches a moving setpoint within limits; angles in rad, one step per cycle."""

    def __init__(self, position: float, setpoint: float, velocity: float, acceleration: float):
        self._position = position
        self._setpoint = setpoint
        self._speed = velocity * CYCLE
        self._budget = acceleration * CYCLE * CYCLE
        self._last_step = 0.0
        self.done = False

    def step(self, setpoint: float) -> float:
        drift = setpoint - self._setpoint
        self._setpoint = setpoint
        ahead = setpoint - self._position
        meets = abs(ahead - self._last_step) <= self._budget and abs(ahead - drift) <= self._budget
        if meets and abs(ahead) <= self._speed:
            self.done = True
            self._position = setpoint
            return setpoint
        behind = ahead - drift
        wanted = drift + math.copysign(braking_step(abs(behind), self._budget), behind)
        wanted = min(max(wanted, -self._speed), self._speed)
        self._last_step = min(max(wanted, self._last_step - self._budget), self._last_step + self._budget)
        self._position += self._last_step
        return self._position


def _transition(omega: float, zeta: float, period: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return exp(A * period) of (x - u, x') for x'' = -omega^2 (x - u) - 2 zeta omega x', u constant, any damping."""
    centre = -zeta * omega
    root = omega * cmath.sqrt(zeta * zeta - 1.0)
    even = cmath.cosh(root * period).real
    odd = (cmath.sinh(root * period) / root).real if root else period
    scale = math.exp(centre * period)
    return (
        (scale * (even - centre * odd), scale * odd),
        (-scale * omega * omega * odd, scale * (even + centre * odd)),
    )

"""Servo models of the mock controller: how the axes follow their setpoints, one step per cycle; timing: see `controller`."""

from __future__ import annotations

import math
import random
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from typing import Any

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.follower import braking_step
from construction_twin.core.units import CYCLE
from construction_twin.servo.model import transition_matrix


class Servo(ABC):
    """A servo model with joints that can be stalled or slow.

    A stalled joint stands; after its release it approaches its setpoint within limits (`Chase`) until position and speed match.
    A slow joint does so all the time, with a lower velocity limit.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._measured: tuple[float, ...] = ()
        self._setpoint: tuple[float, ...] = ()
        self._last_setpoint: tuple[float, ...] = ()
        self._stalled: set[int] = set()
        self._slow: dict[int, float] = {}
        self._chases: dict[int, Chase] = {}

    @property
    def measured(self) -> tuple[float, ...]:
        """Measured position [rad], shape (n,)."""
        return self._measured

    def reset(self, q: Sequence[float]) -> None:
        """Start at rest at `q` [rad], shape (n,); stalled joints stay stalled, there, and slow ones slow."""
        self._setpoint = self._last_setpoint = tuple(q)
        self._chases = {
            joint: Chase(q[joint], q[joint], 0.0, self._slow[joint], chase.acceleration, self._period)
            for joint, chase in self._chases.items()
            if joint in self._slow
        }
        self._start(self._setpoint)
        self._measured = self._respond(self._setpoint)

    def step(self, setpoint: Sequence[float]) -> tuple[float, ...]:
        """Advance one cycle to this setpoint; return the measured position at its end, both of length n [rad]."""
        reference = list(setpoint)
        for joint in self._stalled:
            reference[joint] = self._measured[joint]
        for joint, chase in tuple(self._chases.items()):
            chase.aim(setpoint[joint])
            reference[joint] = chase.move()
            if chase.met and joint not in self._slow:
                del self._chases[joint]
        self._last_setpoint, self._setpoint = self._setpoint, tuple(setpoint)
        self._measured = self._respond(tuple(reference))
        return self._measured

    def stall(self, joint: int) -> None:
        """Freeze the measured position of the joint with index `joint`."""
        self._chases.pop(joint, None)
        self._stalled.add(joint)
        self._freeze(joint, self._measured[joint])

    def release(self, joint: int, velocity: float, acceleration: float) -> None:
        """Let a stalled joint catch up with its setpoint within limits, of a slow joint its own velocity; no effect on another."""
        if joint in self._stalled:
            self._stalled.remove(joint)
            velocity = self._slow.get(joint, velocity)
            begin = self._measured[joint], self._setpoint[joint], 0.0
            self._chases[joint] = Chase(*begin, velocity, acceleration, self._period)

    def limit(self, joint: int, velocity: float, acceleration: float) -> None:
        """Make a joint slow: its reference follows the setpoint within these limits [rad/s], [rad/s^2]."""
        self._slow[joint] = velocity
        if joint not in self._stalled:
            self._chase(joint, velocity, acceleration)

    def unlimit(self, joint: int, velocity: float, acceleration: float) -> None:
        """Let a slow joint catch up with its setpoint within limits [rad/s], [rad/s^2]; other joints go on."""
        if self._slow.pop(joint, None) is not None and joint in self._chases:
            self._chase(joint, velocity, acceleration)

    def push(self, joint: int, torque: float) -> None:
        """Apply an external torque to an axis, in its own sense, until it is 0 again [N m]."""
        raise ConstructionTwinError("a collision needs a mock arm with mass: start it with servo:=physics")

    def _chase(self, joint: int, velocity: float, acceleration: float) -> None:
        """Begin a chase, from the present reference and at its present speed."""
        setpoint = self._setpoint[joint]
        position, step = setpoint, setpoint - self._last_setpoint[joint]
        if joint in self._chases:
            position, step = self._chases[joint].position, self._chases[joint].step
        self._chases[joint] = Chase(position, setpoint, step, velocity, acceleration, self._period)

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
    """A pure delay: a setpoint is reported as reached so many cycles, at least 1, after the packet whose reply set it."""

    def __init__(self, delay_cycles: int = 3, period: float = CYCLE):
        super().__init__(period)
        self._delay = delay_cycles
        self._line: deque[list[float]] = deque(maxlen=delay_cycles)

    def _start(self, q: tuple[float, ...]) -> None:
        self._line.extend(list(q) for _ in range(self._delay))

    def _respond(self, reference: tuple[float, ...]) -> tuple[float, ...]:
        self._line.append(list(reference))
        return tuple(self._line[0])

    def _freeze(self, joint: int, position: float) -> None:
        for reference in self._line:
            reference[joint] = position


class RealisticServo(Servo):
    """A second-order lag per joint, exactly discretised for a setpoint held during the cycle, read by an encoder.

    On a ramp it lags by 2 zeta / omega seconds (27 ms with the defaults) plus half a cycle. Resolution 0: exact reading.
    """

    def __init__(
        self, omega: float = 60.0, zeta: float = 0.8, resolution: float = math.radians(3e-5), period: float = CYCLE
    ):
        super().__init__(period)
        self._transition = transition_matrix(omega, zeta, period)
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
        return tuple([read_encoder(position, self._resolution) for position in self._position])

    def _freeze(self, joint: int, position: float) -> None:
        self._position[joint] = position
        self._velocity[joint] = 0.0


def read_encoder(position: float, resolution: float) -> float:
    """Return the reading of a position [rad] by an encoder with this step [rad]; step 0: exact."""
    return round(position / resolution) * resolution if resolution else position


class Chase:
    """A reference that approaches a moving setpoint within limits [rad/s], [rad/s^2]; one `aim` and one `move` per cycle.

    `met` is True when the last `aim` matched the setpoint in position and speed.
    """

    def __init__(
        self, position: float, setpoint: float, step: float, velocity: float, acceleration: float, period: float
    ):
        self.position, self.step = position, step
        self.acceleration = acceleration
        self.met = False
        self._setpoint = setpoint
        self._aimed = 0.0
        self._speed = velocity * period
        self._budget = acceleration * period * period

    def aim(self, setpoint: float) -> float:
        """Set the setpoint of this cycle [rad]; return the permitted step towards it [rad]."""
        drift = setpoint - self._setpoint
        self._setpoint = setpoint
        ahead = setpoint - self.position
        self.met = (
            abs(ahead - self.step) <= self._budget
            and abs(ahead - drift) <= self._budget
            and abs(ahead) <= self._speed * (1 + 1e-9)
        )
        self._aimed = ahead
        if not self.met:
            behind = ahead - drift
            wanted = drift + math.copysign(braking_step(abs(behind), self._budget), behind)
            self._aimed = self.within_budget(min(max(wanted, -self._speed), self._speed))
        return self._aimed

    def within_budget(self, step: float) -> float:
        """Return `step` [rad], brought within one cycle's acceleration of the last one."""
        return min(max(step, self.step - self._budget), self.step + self._budget)

    def move(self, step: float | None = None) -> float:
        """Apply the step of `aim`, or another one [rad]; return the new position [rad]."""
        if step is not None:
            self.met = False
        elif self.met:
            # assign the setpoint itself, because position + step could differ from it in the last bit
            self.step, self.position = self._aimed, self._setpoint
            return self.position
        self.step = self._aimed if step is None else step
        self.position += self.step
        return self.position


class Encoders:
    """From measured angles to reported ones, one `read` per cycle; `slip`: errors that the controller took as its pose [rad]."""

    def __init__(self, count: int, period: float = CYCLE):
        self._period = period
        self.random = random.Random(0)
        self.offset = [0.0] * count
        self.slip = [0.0] * count
        self._drift: dict[int, float] = {}
        self._play: dict[int, list[float]] = {}
        self._noise: dict[int, float] = {}

    @property
    def active(self) -> bool:
        """Whether a reading differs from the measured angle."""
        return bool(any(self.offset) or self._drift or self._play or self._noise)

    def disturb(self, kind: str, joint: int, value: float, measured: float) -> None:
        """Disturb the reading of an axis whose angle is `measured` [rad], as `faults.KINDS` says; 0 ends it."""
        if kind == "offset" or kind == "drift" and not value:
            self.offset[joint] = value
        kinds: dict[str, dict[int, Any]] = {"drift": self._drift, "backlash": self._play, "noise": self._noise}
        disturbed = kinds.get(kind, {})
        disturbed.pop(joint, None)
        if value:
            disturbed[joint] = [value / 2.0, measured] if kind == "backlash" else value

    def read(self, measured: Sequence[float]) -> tuple[float, ...]:
        """Return what the encoders report for the measured angles [rad], shape (n,); one cycle passes."""
        reading = list(measured)
        for joint, play in self._play.items():
            half, position = play
            play[1] = min(max(position, reading[joint] - half), reading[joint] + half)
            reading[joint] = play[1]
        for joint, rate in self._drift.items():
            self.offset[joint] += rate * self._period
        for joint, deviation in self._noise.items():
            reading[joint] += self.random.gauss(0.0, deviation)
        return tuple([angle + offset for angle, offset in zip(reading, self.offset)])

    def absorb(self) -> None:
        """Let the controller take its readings as its pose, as at a restart: the offsets become slip."""
        self.slip = [slip + offset for slip, offset in zip(self.slip, self.offset)]
        self.offset = [0.0] * len(self.offset)

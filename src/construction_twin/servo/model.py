"""Where a servo has its joint: a lag of second order behind a delayed target, with feed-forward and backlash.

The target of a cycle is held during it, and what counts is the position at its end: as the controller's next telegram tells it.
Of a delay that is not a whole number of cycles, the cycle's first part still has the target before. Angles in rad, prismatic joints
in m.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import pydantic
import yaml

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.units import NANOSECONDS
from construction_twin.validation import StrictModel

#: A playout that is slower or faster than its stream by more than one part in so many does not move the arm as commanded.
PACE = 20
#: What disturbs a motion shows for so long after it [ns]: by then a servo has forgotten it.
STEADY = NANOSECONDS // 5


def keeps_pace(advance: int, elapsed: int) -> bool:
    """Return whether a stream advanced as far as the time that elapsed, within one part in `PACE` [ns]."""
    return abs(advance - elapsed) <= elapsed // PACE


_Matrix = tuple[tuple[float, float], tuple[float, float]]


def transition_matrix(omega: float, zeta: float, period: float) -> _Matrix:
    """Return exp(A * period) of (x - u, x') for x'' = -omega^2 (x - u) - 2 zeta omega x', u constant, any damping."""
    centre = -zeta * omega
    root = omega * cmath.sqrt(zeta * zeta - 1.0)
    even = cmath.cosh(root * period).real
    odd = (cmath.sinh(root * period) / root).real if root else period
    scale = math.exp(centre * period)
    return ((scale * (even - centre * odd), scale * odd), (-scale * omega * omega * odd, scale * (even + centre * odd)))


@dataclass(frozen=True)
class JointServo:
    """How one joint answers its targets.

    Attributes:
        omega, zeta: Natural frequency [rad/s] and damping [1] of the lag, both > 0.
        delay: From a target to its effect [cycles], not below 0.
        velocity: Feed-forward of the target's velocity [s].
        acceleration: Feed-forward of the target's acceleration [s^2].
        backlash: How far the joint may lie behind in each change of direction [rad], [m], not below 0.
    """

    omega: float
    zeta: float
    delay: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0
    backlash: float = 0.0

    def lag(self, period: float) -> float:
        """Return the lag behind a target of constant speed [s]."""
        # a held target is half a cycle ahead on average
        return 2.0 * self.zeta / self.omega + (self.delay - 0.5) * period - self.velocity

    def parts(self, period: float) -> tuple[int, _Matrix, _Matrix]:
        """Return the whole cycles of the delay, and a cycle's transitions before and after its target takes effect."""
        whole = int(self.delay)
        first = (self.delay - whole) * period
        return (
            whole,
            transition_matrix(self.omega, self.zeta, first),
            transition_matrix(self.omega, self.zeta, period - first),
        )


@dataclass(frozen=True)
class ServoModel:
    """The servos of an arm, by joint name, as identified for a controller's cycle [ns]."""

    names: tuple[str, ...]
    servos: tuple[JointServo, ...]
    cycle_ns: int

    @property
    def period(self) -> float:
        """Length of a cycle [s]."""
        return self.cycle_ns / NANOSECONDS

    def slower(self, lags: Sequence[float]) -> ServoModel:
        """Return the same servos with more lag each, length n [s]."""
        servos = [replace(servo, velocity=servo.velocity - lag) for servo, lag in zip(self.servos, lags)]
        return replace(self, servos=tuple(servos))


class ServoState:
    """Where the model has the arm, from rest at `q`; one target per cycle."""

    def __init__(self, model: ServoModel, q: Sequence[float]):
        self._joints = [_Joint(servo, model.period, start) for servo, start in zip(model.servos, q)]

    def configure(self, model: ServoModel) -> None:
        """Replace the servos and drop pending targets; to be called at rest."""
        for joint, servo in zip(self._joints, model.servos):
            joint.configure(servo, model.period)

    def advance(self, target: Sequence[float]) -> tuple[float, ...]:
        """Advance by one cycle to a target, shape (n,); return the position at its end, shape (n,) [rad]."""
        return tuple([joint.advance(goal) for joint, goal in zip(self._joints, target)])


class _Joint:
    """One joint of a `ServoState`."""

    __slots__ = ("_last_target", "_target_before", "_waiting", "_x", "configured", "position", "speed")

    def __init__(self, servo: JointServo, period: float, start: float):
        self.position = self._x = start
        self.speed = 0.0
        self._last_target = self._target_before = start
        self.configure(servo, period)

    def configure(self, servo: JointServo, period: float) -> None:
        """Continue with another servo."""
        whole, (first_x, first_v), (second_x, second_v) = servo.parts(period)
        self.configured = (
            *first_x,
            *first_v,
            *second_x,
            *second_v,
            servo.velocity / period,
            servo.acceleration / (period * period),
            servo.backlash / 2.0,
        )
        #: References that have no effect yet, the oldest first.
        self._waiting = [self._last_target] * (whole + 1)

    def advance(self, target: float) -> float:
        """Advance by one cycle to a target; return the position at its end."""
        axx, axv, avx, avv, bxx, bxv, bvx, bvv, velocity, acceleration, play = self.configured
        step = target - self._last_target
        reference = target + velocity * step + acceleration * (step - self._last_target + self._target_before)
        self._target_before, self._last_target = self._last_target, target
        waiting = self._waiting
        waiting.append(reference)
        old, new = waiting[0], waiting[1]
        del waiting[0]
        error, speed = self._x - old, self.speed
        error, speed = old + axx * error + axv * speed - new, avx * error + avv * speed
        self._x, self.speed = new + bxx * error + bxv * speed, bvx * error + bvv * speed
        self.position = min(max(self.position, self._x - play), self._x + play) if play else self._x
        return self.position


# -- the file: YAML, written by `identify` and read by the monitor

_Number = Annotated[float, pydantic.Field(allow_inf_nan=False)]


class _FileJoint(StrictModel):
    """One joint of the file; what was measured beside the servo is for people."""

    omega: Annotated[float, pydantic.Field(gt=0, le=5000)]
    zeta: Annotated[float, pydantic.Field(gt=0, le=20)]
    delay: Annotated[float, pydantic.Field(ge=0, le=25)] = 0.0
    velocity: Annotated[float, pydantic.Field(ge=-0.5, le=0.5)] = 0.0
    acceleration: Annotated[float, pydantic.Field(ge=-0.1, le=0.1)] = 0.0
    backlash: Annotated[float, pydantic.Field(ge=0, le=0.1)] = 0.0
    lag_error_ms: _Number = 0.0
    residual_rms: _Number = 0.0
    residual_max: _Number = 0.0


class _File(StrictModel):
    """The whole file."""

    cycle_ms: Annotated[int, pydantic.Field(ge=1, le=100, strict=True)]
    source: str = ""
    joints: dict[str, _FileJoint]


def read_servos(path: str | Path, names: Sequence[str]) -> ServoModel:
    """Return the servos of a file, of joints with these names, in their order."""
    path = Path(path).expanduser()
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    # brackets nested by the thousand are a RecursionError, other bytes than UTF-8 and dates that do not exist a ValueError
    except (OSError, yaml.YAMLError, ValueError, RecursionError) as error:
        problem = f"YAML ({' '.join(str(error).split())})"
        raise ConfigurationError("servo_model", str(path), problem) from error
    file = _File.read(content, "servo_model")
    if set(file.joints) != set(names):
        expected = f"those of this arm: {', '.join(names)}"
        raise ConfigurationError("servo_model", ", ".join(file.joints), expected)
    servos = [file.joints[name] for name in names]
    keys = JointServo.__match_args__
    return ServoModel(
        tuple(names),
        tuple(JointServo(**{key: getattr(servo, key) for key in keys}) for servo in servos),
        file.cycle_ms * 1_000_000,
    )

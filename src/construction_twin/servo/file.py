"""The file of an arm's servos: YAML, written by `identify` and read by the monitor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import pydantic
import yaml

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.validation import configuration_error
from construction_twin.servo.model import JointServo, ServoModel

_Number = Annotated[float, pydantic.Field(allow_inf_nan=False)]


class _Joint(pydantic.BaseModel):
    """One joint of the file; what was measured beside the servo is for people."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    omega: Annotated[float, pydantic.Field(gt=0, le=5000)]
    zeta: Annotated[float, pydantic.Field(gt=0, le=20)]
    delay: Annotated[float, pydantic.Field(ge=0, le=25)] = 0.0
    velocity: Annotated[float, pydantic.Field(ge=-0.5, le=0.5)] = 0.0
    acceleration: Annotated[float, pydantic.Field(ge=-0.1, le=0.1)] = 0.0
    backlash: Annotated[float, pydantic.Field(ge=0, le=0.1)] = 0.0
    lag_error_ms: _Number = 0.0
    residual_rms: _Number = 0.0
    residual_max: _Number = 0.0


class _File(pydantic.BaseModel):
    """The whole file."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    cycle_ms: Annotated[int, pydantic.Field(ge=1, le=100, strict=True)]
    source: str = ""
    joints: dict[str, _Joint]


def read_servos(path: str | Path, names: Sequence[str]) -> ServoModel:
    """Return the servos of a file, of joints with these names, in their order."""
    path = Path(path).expanduser()
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    # brackets nested by the thousand are a RecursionError, other bytes than UTF-8 and dates that do not exist a ValueError
    except (OSError, yaml.YAMLError, ValueError, RecursionError) as error:
        problem = f"YAML ({' '.join(str(error).split())})"
        raise ConfigurationError("servo_model", str(path), problem) from error
    try:
        file = _File.model_validate(content)
    except pydantic.ValidationError as error:
        raise configuration_error(error, _File) from error
    if set(file.joints) != set(names):
        expected = f"those of this arm: {', '.join(names)}"
        raise ConfigurationError("servo_model", ", ".join(file.joints), expected)
    servos = [file.joints[name] for name in names]
    kept = JointServo.__match_args__
    return ServoModel(
        tuple(names),
        tuple(JointServo(**{key: getattr(servo, key) for key in kept}) for servo in servos),
        file.cycle_ms * 1_000_000,
    )

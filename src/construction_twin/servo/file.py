"""The file of an arm's servos: YAML, written by `identify` and read by the monitor."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import pydantic
import yaml

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.validation import configuration_error
from construction_twin.servo.model import JointServo, ServoModel

if TYPE_CHECKING:
    # the monitor reads files, and has no use for what finds servos
    from construction_twin.servo.identification import IdentifiedJoint

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


def servo_file(joints: Sequence[IdentifiedJoint], cycle_ns: int, source: str) -> str:
    """Return the text of a file: the servos as they were identified, and by what residual; `source` names the recording."""
    content = {
        "cycle_ms": cycle_ns // 1_000_000,
        "source": source,
        "joints": {
            joint.name: {key: _rounded(getattr(joint.servo, key)) for key in JointServo.__match_args__}
            | {
                "lag_error_ms": _rounded(1e3 * joint.lag_error),
                "residual_rms": _rounded(joint.residual_rms),
                "residual_max": _rounded(joint.residual_max),
            }
            for joint in joints
        },
    }
    head = "# How the arm's servos answer: written by `identify`, read by the launch argument servo_model.\n"
    return head + yaml.safe_dump(content, sort_keys=False)


def _rounded(value: float) -> float:
    return float(f"{value:.9g}")

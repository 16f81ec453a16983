"""The gate's settings as a person writes them: read from YAML, checked as a whole, changed at rest."""

from __future__ import annotations

from typing import Annotated, Literal

import pydantic
import yaml

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.validation import configuration_error
from construction_twin.monitor.gate import GateSettings

#: A difference of poses [rad], [m]: above 1 the gate would compare nothing.
_Threshold = Annotated[float, pydantic.Field(gt=0, le=1, strict=True)]


class Behaviour(pydantic.BaseModel):
    """How strict the gate is: what the service `configure_gate` can change at rest; see config/pca_monitor.yaml."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    threshold: _Threshold
    threshold_linear: _Threshold
    thresholds: dict[str, _Threshold] = {}
    comparison: Literal["aligned", "instant"]
    lag_allowance: float = pydantic.Field(ge=0, le=1, strict=True)
    lag_margin: float = pydantic.Field(ge=0, le=1, strict=True)
    feedback_timeout: float = pydantic.Field(gt=0, le=10, strict=True)
    agree_share: float = pydantic.Field(gt=0, le=1, strict=True)
    agree_time: float = pydantic.Field(ge=0, le=60, strict=True)
    policy: Literal["replan", "resume", "stop"]
    give_up_time: float = pydantic.Field(gt=0, le=3600, strict=True)
    escalate_count: int = pydantic.Field(ge=1, le=1000, strict=True)
    escalate_time: float = pydantic.Field(gt=0, le=3600, strict=True)

    def gate_settings(self, compares: bool) -> GateSettings:
        """Return the same for the gate; `compares` is False without a physical arm."""
        values = {name: getattr(self, name) for name in Behaviour.model_fields if name in GateSettings.__match_args__}
        return GateSettings(**values, aligned=self.comparison == "aligned", compares=compares)

    def changed(self, text: str) -> Behaviour:
        """Return the behaviour with some settings changed.

        Args:
            text: YAML, as in config/pca_monitor.yaml: ``{policy: resume, thresholds: {joint_a3: 0.02}}``.
        """
        try:
            changes = yaml.safe_load(text)
        # a date that does not exist is a ValueError, brackets nested by the thousand are a RecursionError
        except (yaml.YAMLError, ValueError, RecursionError) as error:
            raise ConfigurationError("settings", text[:200], f"YAML ({' '.join(str(error).split())})") from error
        if not isinstance(changes, dict):
            raise ConfigurationError("settings", text, "a YAML mapping, e.g. {policy: resume}")
        try:
            return Behaviour.model_validate(self.model_dump() | changes)
        except pydantic.ValidationError as error:
            raise configuration_error(error, Behaviour) from error

    def difference(self, other: Behaviour) -> str:
        """Return what another behaviour changes, as words; empty when nothing."""
        return ", ".join(
            f"{name} {getattr(self, name)} -> {getattr(other, name)}"
            for name in Behaviour.model_fields
            if getattr(self, name) != getattr(other, name)
        )

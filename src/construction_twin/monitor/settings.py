"""Settings of the gate, which the service `configure_gate` changes at rest; see config/pca_monitor.yaml."""

from __future__ import annotations

from typing import Annotated, Literal

import pydantic
import yaml

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.limits import MotionLimits
from construction_twin.monitor.comparison import ALIGNED, ComparisonSettings
from construction_twin.validation import StrictModel

#: What may happen after a violation.
REPLAN, RESUME, STOP = "replan", "resume", "stop"
#: A difference of poses [rad], [m]: above 1 the gate would compare nothing.
_Threshold = Annotated[float, pydantic.Field(gt=0, le=1, strict=True)]


class GateSettings(StrictModel):
    """Settings of the gate: the keys of config/pca_monitor.yaml, which explains each; SI."""

    threshold: _Threshold = 0.01
    threshold_linear: _Threshold = 0.005
    thresholds: dict[str, _Threshold] = {}
    comparison: Literal["aligned", "instant"] = "aligned"
    lag_allowance: float = pydantic.Field(0.05, ge=0, le=1, strict=True)
    lag_margin: float = pydantic.Field(0.02, ge=0, le=1, strict=True)
    feedback_timeout: float = pydantic.Field(0.1, gt=0, le=10, strict=True)
    agree_share: float = pydantic.Field(0.8, gt=0, le=1, strict=True)
    agree_time: float = pydantic.Field(0.1, ge=0, le=60, strict=True)
    policy: Literal["replan", "resume", "stop"] = "replan"
    give_up_time: float = pydantic.Field(30.0, gt=0, le=3600, strict=True)
    escalate_count: int = pydantic.Field(5, ge=1, le=1000, strict=True)
    escalate_time: float = pydantic.Field(30.0, gt=0, le=3600, strict=True)

    def comparison_settings(self, limits: MotionLimits) -> ComparisonSettings:
        """Return the part that the comparison needs, for the joints of `limits` in their order."""
        foreign = [name for name in self.thresholds if name not in limits.names]
        if foreign:
            raise ConfigurationError("thresholds", foreign[0], f"names of joints: {', '.join(limits.names)}")
        threshold = tuple(
            self.thresholds.get(name, self.threshold_linear if slides else self.threshold)
            for name, slides in zip(limits.names, limits.linear)
        )
        return ComparisonSettings(threshold, self.lag_allowance, self.lag_margin, self.comparison == ALIGNED)

    def with_changes(self, text: str) -> GateSettings:
        """Return the settings with some changed by a YAML text, e.g. ``{policy: resume, thresholds: {joint_a3: 0.02}}``."""
        try:
            changes = yaml.safe_load(text)
        # a date that does not exist is a ValueError, brackets nested by the thousand are a RecursionError
        except (yaml.YAMLError, ValueError, RecursionError) as error:
            raise ConfigurationError("settings", text[:200], f"YAML ({' '.join(str(error).split())})") from error
        if not isinstance(changes, dict):
            raise ConfigurationError("settings", text, "a YAML mapping, e.g. {policy: resume}")
        return GateSettings.read(self.model_dump() | changes)

    def difference(self, other: GateSettings) -> str:
        """Return what other settings change, as words; empty when nothing."""
        return ", ".join(
            f"{name} {getattr(self, name)} -> {getattr(other, name)}"
            for name in GateSettings.model_fields
            if getattr(self, name) != getattr(other, name)
        )

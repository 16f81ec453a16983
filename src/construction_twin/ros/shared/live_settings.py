"""How strict the monitor is, and changing it while it runs: parameters of the node, and dynamic_reconfigure.

The list of live parameters depends on the robot's joints, so it is made at run time and not generated from a .cfg file.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Literal

import pydantic
import rospy
from dynamic_reconfigure.encoding import Config
from dynamic_reconfigure.server import Server

from construction_twin.monitor.gate import GateSettings
from construction_twin.ros.shared.params import NodeSettings

#: Live parameters are kept on the parameter server below this private name: what was changed live ends with the node.
NAMESPACE = "live"
#: Before a joint's name: its threshold.
PREFIX = "threshold_"

_Positive = Annotated[float, pydantic.Field(gt=0, allow_inf_nan=False)]
_NotNegative = Annotated[float, pydantic.Field(ge=0, allow_inf_nan=False)]


class Behaviour(NodeSettings):
    """What can be changed live; see config/pca_monitor.yaml."""

    threshold: _Positive
    threshold_linear: _Positive
    thresholds: dict[str, _Positive] = {}
    comparison: Literal["aligned", "instant"]
    lag_allowance: _NotNegative
    lag_margin: _NotNegative
    feedback_timeout: _Positive
    agree_share: float = pydantic.Field(gt=0, le=1)
    agree_time: _NotNegative
    policy: Literal["replan", "resume", "stop"]
    give_up_time: _Positive
    escalate_count: int = pydantic.Field(ge=1)
    escalate_time: _Positive

    def gate_settings(self, compares: bool) -> GateSettings:
        """Return the same for the gate; `compares` is False without a physical arm."""
        values = {name: getattr(self, name) for name in Behaviour.model_fields if name in GateSettings.__match_args__}
        return GateSettings(**values, aligned=self.comparison == "aligned", compares=compares)


#: Type, lower and upper end of a slider, and a description without quotes, as dynamic_reconfigure asks for.
_SHOWN = {
    "lag_allowance": ("double", 0.0, 1.0, "Largest servo lag that is believed [s]"),
    "lag_margin": ("double", 0.0, 1.0, "What the estimated servo lag may be wrong by [s]"),
    "feedback_timeout": ("double", 0.01, 10.0, "Older feedback is out of sync [s]"),
    "agree_share": ("double", 0.01, 1.0, "Fraction of the thresholds below which poses agree again"),
    "agree_time": ("double", 0.0, 60.0, "Poses must agree this long before the gate opens [s]"),
    "give_up_time": ("double", 0.1, 3600.0, "Closed this long the gate is STOPPED [s]"),
    "escalate_count": ("int", 1, 1000, "Closed this often within escalate_time the gate is STOPPED"),
    "escalate_time": ("double", 0.1, 3600.0, "See escalate_count [s]"),
}
_WORDS = {
    "comparison": ("Poses are compared by command stamp or as they are", ("aligned", "instant")),
    "policy": ("What happens after a violation", ("replan", "resume", "stop")),
}


@dataclass
class _ReconfigureType:
    """What dynamic_reconfigure's server expects of a generated module."""

    min: dict = field(default_factory=Config)
    max: dict = field(default_factory=Config)
    defaults: dict = field(default_factory=Config)
    config_description: dict = field(
        default_factory=lambda: {"name": "Default", "id": 0, "parent": 0, "type": "", "parameters": [], "groups": []}
    )

    def add(self, name: str, kind: str, low, high, default, description: str, edit_method: str = "") -> None:
        """Add a parameter; its range includes the default, which somebody has chosen."""
        if kind != "str":
            low, high = min(low, default), max(high, default)
        self.min[name], self.max[name], self.defaults[name] = low, high, default
        entry = {"name": name, "type": kind, "level": 1, "description": description, "edit_method": edit_method}
        self.config_description["parameters"].append(entry | {"min": low, "max": high, "default": default})


def _choice(description: str, words: tuple[str, ...]) -> str:
    """Return the text from which rqt_reconfigure makes a menu."""
    entries = [
        {"name": word, "type": "str", "value": word, "ctype": "std::string", "cconsttype": "const char * const",
         "description": word, "srcfile": "", "srcline": 0}
        for word in words
    ]  # fmt: skip
    return str({"enum": entries, "enum_description": description})


class LiveSettings:
    """Serves dynamic_reconfigure for a behaviour.

    Parameters
    ----------
    behaviour : Behaviour
        As read at start.
    names, linear : tuple, length n
        Joint names, and which joints are linear.
    apply : callable
        Takes the behaviour that holds from now on.
    refuse : callable
        Takes reason and sentence for values that make no sense; nothing is changed then.
    """

    def __init__(
        self,
        behaviour: Behaviour,
        names: tuple[str, ...],
        linear: tuple[bool, ...],
        apply: Callable[[Behaviour], None],
        refuse: Callable[[str, str], None],
    ):
        self._behaviour = behaviour
        self._names = names
        self._apply = apply
        self._refuse = refuse
        self._config: dict | None = None
        self._server = Server(self._describe(names, linear), self._on_change, NAMESPACE)

    def _describe(self, names: tuple[str, ...], linear: tuple[bool, ...]) -> _ReconfigureType:
        shown, behaviour = _ReconfigureType(), self._behaviour
        for name, slides in zip(names, linear):
            value = behaviour.thresholds.get(name, behaviour.threshold_linear if slides else behaviour.threshold)
            unit = "m" if slides else "rad"
            shown.add(PREFIX + name, "double", 1e-6, 1.0, value, f"Largest difference of {name} at rest [{unit}]")
        for name, (kind, low, high, description) in _SHOWN.items():
            shown.add(name, kind, low, high, getattr(behaviour, name), description)
        for name, (description, words) in _WORDS.items():
            shown.add(name, "str", "", "", getattr(behaviour, name), description, _choice(description, words))
        return shown

    def _on_change(self, config: dict, _level: int) -> dict:
        """Take new values; return those that hold from now on."""
        changes = {name: config[name] for name in (*_SHOWN, *_WORDS)}
        changes["thresholds"] = {name: config[PREFIX + name] for name in self._names}
        try:
            behaviour = Behaviour.model_validate(
                self._behaviour.model_dump(include=set(Behaviour.model_fields)) | changes
            )
        except pydantic.ValidationError as error:
            first = error.errors()[0]
            where = "/".join(map(str, first["loc"]))
            self._refuse("live_setting", f"{where} = {first.get('input')!r}: {first['msg']}; nothing was changed")
            return self._config
        if self._config is not None:
            rospy.loginfo("live settings changed: %s", _difference(self._behaviour, behaviour))
        self._behaviour, self._config = behaviour, config
        self._apply(behaviour)
        return config


def _difference(before: Behaviour, after: Behaviour) -> str:
    found = [
        f"{name} {getattr(before, name)} -> {getattr(after, name)}"
        for name in Behaviour.model_fields
        if getattr(before, name) != getattr(after, name)
    ]
    return ", ".join(found) or "nothing"

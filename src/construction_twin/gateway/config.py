"""The gateway's configuration: one JSON file, which `twin gateway` makes from URDF and robot YAML.

The bridge compares its hash, which covers all of `motion`; hosts and ports are options of the program. SI units throughout.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from construction_twin.controller.port import DEFAULT_MAKE, GatewayTool, Layout, Make, make_of
from construction_twin.controller.telegram import AxisUnit
from construction_twin.core.errors import ConfigurationError
from construction_twin.core.limits import MotionLimits

#: Written into the file; another number means another meaning of its keys.
FORMAT = 3
_POSITIVE = (
    *("start_tolerance", "start_tolerance_linear", "playout_delay", "playout_delay_min", "playout_delay_max"),
    *("silence", "max_age", "speed_limit_deadline", "speed_limit_grace", "speed_limit_backlog", "timeout"),
    *("e1_feedback_scale", "e1_correction_scale"),
)


@dataclass(frozen=True)
class GatewayConfig:
    """Robot and link of a gateway; config/gateway.yaml explains the settings.

    Axis order is A1 first; values are those of the controller's axes. SI; those of linear axes in m where others are in rad.

    Attributes:
        axes, linear: Names in the telegrams, e.g. ``A1``, and those of linear axes.
        cycle: [ms]
        reference: One of `Make.references`; "": its usual one.
        layout: Default: that of RSI without a file.
        tool: None: no tool, or one that the layout has no channels for.
    """

    robot: str
    axes: tuple[str, ...]
    lower: tuple[float, ...]
    upper: tuple[float, ...]
    velocity: tuple[float, ...]
    acceleration: tuple[float, ...]
    cycle: int = 4
    decimals: int = 3
    properties: bool = True
    start_tolerance: float = math.radians(0.05)
    start_tolerance_linear: float = 0.0005
    playout_delay: float = 0.02
    playout_delay_min: float = 0.02
    playout_delay_max: float = 0.25
    silence: float = 0.1
    max_age: float = 0.5
    reference: str = ""
    speed_limit_deadline: float = 0.5
    speed_limit_silent: float = 0.1
    speed_limit_grace: float = 0.5
    speed_limit_backlog: float = 2.0
    timeout: float = 0.4
    e1_sign: int = 1
    e1_offset: float = 0.0
    e1_feedback_scale: float = 1.0
    e1_correction_scale: float = 1.0
    linear: tuple[str, ...] = ()
    layout: Layout = None  # type: ignore[assignment]  # `__post_init__` puts the plain layout of the axes in its place
    tool: GatewayTool | None = None

    def __post_init__(self):
        def need(holds: object, name: str, expected: str) -> None:
            if not holds:
                raise ConfigurationError(name, getattr(self, name), expected)

        count = len(self.axes)
        names = isinstance(self.axes, tuple) and all(isinstance(axis, str) for axis in self.axes)
        need(count and names, "axes", "at least one axis name")
        for name in ("lower", "upper", "velocity", "acceleration"):
            values = getattr(self, name)
            fit = len(values) == count and all(isinstance(v, (int, float)) and math.isfinite(v) for v in values)
            need(fit, name, f"{count} finite numbers, one per axis")
        need(all(low < high for low, high in zip(self.lower, self.upper)), "lower", f"values below upper {self.upper}")
        need(min(self.velocity) > 0, "velocity", "positive limits")
        need(min(self.acceleration) > 0, "acceleration", "positive limits")
        if self.layout is None:
            object.__setattr__(self, "layout", make_of(DEFAULT_MAKE).plain(self.axes))
        make = self.make
        if not self.reference and make.references:
            object.__setattr__(self, "reference", make.references[0])
        cycles = f"{' or '.join(map(str, make.cycles))} ms: {make.terms.cycles}"
        need(type(self.cycle) is int and self.cycle in make.cycles, "cycle", cycles)
        need(type(self.decimals) is int and 1 <= self.decimals <= 6, "decimals", "1 to 6")
        need(isinstance(self.properties, bool), "properties", "true or false")
        for name in _POSITIVE:
            value = getattr(self, name)
            need(isinstance(value, (int, float)) and 0 < value < math.inf, name, "a positive number")
        bounds = f"{self.playout_delay_min} (playout_delay_min) to {self.playout_delay_max} (playout_delay_max)"
        need(self.playout_delay_min <= self.playout_delay <= self.playout_delay_max, "playout_delay", bounds)
        need(self.playout_delay_max < self.max_age, "playout_delay_max", f"less than max_age, {self.max_age}")
        fraction = self.speed_limit_silent
        is_fraction = not isinstance(fraction, bool) and isinstance(fraction, (int, float)) and 0 <= fraction <= 1
        need(is_fraction, "speed_limit_silent", "a fraction of the velocity limits, 0 to 1")
        need(type(self.e1_sign) is int and self.e1_sign in (1, -1), "e1_sign", "1 or -1")
        finite = isinstance(self.e1_offset, (int, float)) and math.isfinite(self.e1_offset)
        need(finite, "e1_offset", "a finite number [rad] or [m]")
        need(set(self.linear) <= set(self.axes), "linear", f"some of the axes {', '.join(self.axes)}")
        known = make.references
        need(not known or self.reference in known, "reference", f"one of {', '.join(known)}")
        make.check(self)

    @property
    def make(self) -> Make:
        """The make of the controller."""
        return make_of(self.layout.make)

    @property
    def period(self) -> float:
        """The controller's cycle [s]."""
        return self.cycle / 1000

    @property
    def cycle_ns(self) -> int:
        """The controller's cycle [ns]."""
        return self.cycle * 1_000_000

    @property
    def units(self) -> tuple[AxisUnit, ...]:
        """How each axis is written in telegrams."""
        e1 = (self.e1_sign, self.e1_offset, self.e1_feedback_scale, self.e1_correction_scale)
        return tuple(AxisUnit(axis in self.linear, *(e1 if axis == "E1" else ())) for axis in self.axes)

    @property
    def limits(self) -> MotionLimits:
        """The axes' limits."""
        linear = tuple(axis in self.linear for axis in self.axes)
        return MotionLimits(self.axes, self.lower, self.upper, self.velocity, self.acceleration, linear)

    @property
    def start_tolerances(self) -> tuple[float, ...]:
        """How close to the held pose a stream may begin, per axis [rad], [m]."""
        return tuple(self.start_tolerance_linear if axis in self.linear else self.start_tolerance for axis in self.axes)

    @property
    def hash(self) -> str:
        """SHA-256 over the whole configuration, independent of the file's layout."""
        return hashlib.sha256(json.dumps(self._document(), sort_keys=True).encode()).hexdigest()

    def to_json(self) -> str:
        """Return the file's text."""
        return json.dumps({"format": FORMAT, "hash": self.hash, "motion": self._document()}, indent=2) + "\n"

    def _document(self) -> dict:
        return asdict(self) | {"make": self.layout.make}


def parse_config(text: str, where: str) -> GatewayConfig:
    """Parse a configuration file's text; ConfigurationError where it is invalid, or was edited by hand (wrong hash)."""
    try:
        document = json.loads(text)
        if document["format"] != FORMAT:
            raise ConfigurationError(where, document["format"], f"format {FORMAT}; export it again")
        motion = _with_tuples(document["motion"])
        if missing := {field.name for field in fields(GatewayConfig)} - set(motion):
            raise KeyError(", ".join(sorted(missing)))
        layout = make_of(motion.pop("make")).read_layout(_with_tuples(motion["layout"]))
        tool = GatewayTool.of_document(motion["tool"]) if motion["tool"] else None
        config = GatewayConfig(**motion | {"layout": layout, "tool": tool})
    except (json.JSONDecodeError, KeyError, TypeError, AttributeError) as error:
        raise ConfigurationError(where, str(error), "a file written by twin gateway") from error
    if document.get("hash") != config.hash:
        expected = f"hash {config.hash}; the file was edited, export it again"
        raise ConfigurationError(where, document.get("hash"), expected)
    return config


def _with_tuples(document: dict) -> dict:
    return {key: tuple(value) if isinstance(value, list) else value for key, value in document.items()}


def load_config(path: str) -> GatewayConfig:
    """Read a configuration file; ConfigurationError when it is missing or does not fit."""
    try:
        # what is no text is no JSON either
        text = Path(path).read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        expected = "a readable file written by twin gateway"
        raise ConfigurationError(path, error.strerror, expected) from error
    return parse_config(text, path)

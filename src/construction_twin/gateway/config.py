"""The gateway's configuration: one JSON file, made from URDF and robot YAML, with a hash that the bridge compares.

The gateway has neither URDF nor YAML at hand on the cell PC, so `rosrun construction_twin twin gateway` writes this
file. The `motion` part decides what the arm may do and is what the hash covers; hosts and ports are given on the gateway's
command line. What is fixed about the controller's telegrams is part of it. SI units throughout.
"""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path

from construction_twin.controller.axis_unit import AxisUnit
from construction_twin.controller.makes import DEFAULT, make_of
from construction_twin.controller.port import Layout, Make
from construction_twin.controller.tool import GatewayTool
from construction_twin.core.errors import ConfigurationError
from construction_twin.core.limits import MotionLimits

#: Written into the file; another number means another meaning of its keys.
FORMAT = 2
_POSITIVE = (
    *(
        "start_tolerance",
        "start_tolerance_linear",
        "playout_delay",
        "playout_delay_min",
        "playout_delay_max",
        "silence",
    ),
    *("max_age", "speed_limit_deadline", "speed_limit_grace", "speed_limit_backlog", "timeout"),
    *("e1_feedback_scale", "e1_correction_scale"),
)


@dataclass(frozen=True)
class GatewayConfig:
    """What the gateway must know about the robot and the link.

    Axis order is A1 first; values are those of the controller's axes, which may differ from the URDF's joints in sign and offset.
    SI; those of linear axes in m where others are in rad.

    Attributes:
        axes: Names of the axes in the telegrams, e.g. ``A1``.
        cycle: The controller's cycle [ms]; RSI has 4 (`#IPO_FAST`) and 12 (`#IPO`).
        decimals: Decimals of a degree, and of a mm for a linear axis, in the joint string.
        properties: Whether commands carry the MQTT 5 properties session, seq and stamp.
        start_tolerance, start_tolerance_linear: A stream may begin this close to the held pose [rad], [m].
        playout_delay: Distance of the playout to the newest command when a stream begins [s].
        playout_delay_min, playout_delay_max: Bounds of that distance, which follows the jitter of the commands [s].
        silence: The stream may be overdue this long before the gateway brakes and holds [s].
        max_age: A command may have travelled this much longer than the quickest one [s].
        reference: What the corrections are relative to, in the make's word (`Make.references`); "": its usual one.
        speed_limit_deadline: A speed limit's source that is silent for longer counts as silent [s].
        speed_limit_silent: Fraction of the velocity limits that holds then, 0 to 1.
        speed_limit_grace: Time in which the sender may obey a lowered limit before the gateway enforces it [s].
        speed_limit_backlog: How far the arm may trail a sender, who does not obey or whose replies were lost, before the gateway
            brakes [s].
        timeout: Silence of the controller after which its session is over [s].
        e1_sign: +1 or -1: whether E1 counts as the controller does.
        e1_offset: Controller's E1 where ours is 0 [rad], [m] when it is linear.
        e1_feedback_scale, e1_correction_scale: What the controller's unit of E1 is off by: wire value = scale * value in deg or mm.
        linear: Those of `axes` that are linear: m in place of rad, mm on the wire.
        layout: The controller's telegrams, and whose they are; not given: those of RSI, without a file.
        tool: The tool whose outputs the gateway switches; None: no tool, or one that the layout has no channels for.
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
            object.__setattr__(self, "layout", make_of(DEFAULT).plain(self.axes))
        make = self.make
        if not self.reference and make.references:
            object.__setattr__(self, "reference", make.references[0])
        cycles = f"{' or '.join(map(str, make.cycles))} ms: {make.words.cycles}"
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
        offset = self.e1_offset
        need(isinstance(offset, (int, float)) and math.isfinite(offset), "e1_offset", "a finite number [rad] or [m]")
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
        """Return what file and hash hold: of an arm without a tool, what they held before there were tools."""
        document = asdict(self)
        if self.tool is None:
            del document["tool"]
        document["layout"] = self.layout.document()
        if self.layout.make != DEFAULT:
            document["make"] = self.layout.make
        return document


def parse_config(text: str, where: str) -> GatewayConfig:
    """Parse a configuration file's text; ConfigurationError if it is none, or was edited by hand (its hash no longer fits)."""
    try:
        document = json.loads(text)
        motion = _with_tuples(document["motion"])
        known = {field.name for field in fields(GatewayConfig)} - ({"tool"} - set(motion))
        make = make_of(motion.pop("make", DEFAULT))
        if document["format"] != FORMAT:
            raise ConfigurationError(where, document["format"], f"format {FORMAT}; export it again")
        if set(motion) != known:
            difference = sorted(set(motion) ^ known)
            raise ConfigurationError(where, difference, "no missing or unknown keys; export it again")
        layout = make.read_layout(_with_tuples(motion["layout"]))
        tool = GatewayTool.of_document(motion["tool"]) if "tool" in motion else None
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

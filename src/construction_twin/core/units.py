"""Conversions at the borders: the wire and the RSI codecs. Inside the package everything is SI."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

#: Length of a cycle of setpoints, and of a controller cycle with `#IPO_FAST` [s] (docs/rsi.md, section 1).
CYCLE = 0.004
#: The same in nanoseconds: stamps are integers so that a grid of them stays exact.
CYCLE_NS = 4_000_000
NANOSECONDS = 1_000_000_000
#: An axis as KUKA and ROS-Industrial name it.
_AXIS = re.compile(r"joint_([ae][1-9])")


def seconds(stamp: int) -> float:
    """Convert a time from ns to s: to the same number as ROS does, whole seconds and their fraction added up."""
    whole, fraction = divmod(stamp, NANOSECONDS)
    return whole + fraction / 1e9


def degrees(values) -> tuple[float, ...]:
    """Convert joint angles from rad to deg."""
    return tuple(math.degrees(value) for value in values)


def radians(values) -> tuple[float, ...]:
    """Convert joint angles from deg to rad."""
    return tuple(math.radians(value) for value in values)


def to_wire(values: Sequence[float], linear: Sequence[bool]) -> tuple[float, ...]:
    """Convert joint values from rad to deg, and from m to mm where `linear` is True."""
    return tuple(1e3 * value if slides else math.degrees(value) for value, slides in zip(values, linear, strict=True))


def from_wire(values: Sequence[float], linear: Sequence[bool]) -> tuple[float, ...]:
    """Convert joint values from deg to rad, and from mm to m where `linear` is True; ValueError for another count."""
    return tuple(value / 1e3 if slides else math.radians(value) for value, slides in zip(values, linear, strict=True))


def to_display_unit(value: float, unit: str) -> tuple[float, str]:
    """Convert a quantity to the unit in which a person enters it: rad to deg, m to mm, alone or over a time; others stay."""
    base, slash, per = unit.partition("/")
    if base == "rad":
        return math.degrees(value), f"deg{slash}{per}"
    return (value * 1e3, f"mm{slash}{per}") if base == "m" else (value, unit)


def from_display_unit(value: float, unit: str) -> tuple[float, str]:
    """Convert back what `to_display_unit` has converted."""
    base, slash, per = unit.partition("/")
    if base == "deg":
        return math.radians(value), f"rad{slash}{per}"
    return (value / 1e3, f"m{slash}{per}") if base == "mm" else (value, unit)


def display_text(value: float, unit: str) -> str:
    """Return a quantity as a person enters it, by `to_display_unit`, with its unit."""
    value, unit = to_display_unit(value, unit)
    # six digits, of a position as many decimals as the wire may have: what is out of range by the last one shows it
    text = f"{value:.6f}" if "/" not in unit and abs(value) < 1e6 else f"{value:.6g}"
    text = text.rstrip("0").rstrip(".") if "." in text and "e" not in text else text
    return f"{text} {unit}".strip()


def last_digit(decimals: int, linear: bool = False) -> float:
    """Return the value of a joint string's last decimal: of deg [rad], where it is linear of mm [m]."""
    return 10.0**-decimals / 1e3 if linear else math.radians(10.0**-decimals)


def format_allowance(decimals: int, linear: bool = False, cycle: float = CYCLE) -> float:
    """Return what rounding to `decimals` adds to an acceleration measured per cycle: 125 deg/s^2 at 3, 0.125 at 6 (law 3)."""
    return 2 * last_digit(decimals, linear) / cycle**2


def axis_name(joint: str) -> str:
    """Return a joint's name on the pendant: ``A3`` for ``joint_a3``; another name stays."""
    found = _AXIS.fullmatch(joint)
    return found[1].upper() if found else joint

"""what both directions of the telegrams share: names, channels and units, checked once at construction. Standard library only."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from construction_twin.core.errors import ConfigurationError, TelegramError
from construction_twin.rsi.layout import EXTERNAL_AXES, ROBOT_AXES, STOP, AxisUnit, default_element

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_.-]{0,63}").fullmatch


def axis_units(axes: tuple[str, ...], units: tuple[AxisUnit, ...]) -> tuple[AxisUnit, ...]:
    """Return `units`, or plain ones when none are given; ConfigurationError when they are not one per axis."""
    if units and len(units) != len(axes):
        raise ConfigurationError("units", units, f"one for each of {', '.join(axes)}")
    return units or (AxisUnit(),) * len(axes)


def correction_channels(axes: tuple[str, ...], receive: tuple[str, ...]) -> tuple[str, ...]:
    """Return the channels of a reply, the usual ones when none are given; ConfigurationError when they are not those of `axes`."""
    check_axis_names(axes)
    receive = receive or tuple(f"{default_element(axis)}.{axis}" for axis in axes)
    check_names("RECEIVE", receive)
    if sorted(channel.partition(".")[2] for channel in receive if channel != STOP) != sorted(axes):
        raise ConfigurationError("RECEIVE", receive, f"one correction for each of {', '.join(axes)}")
    return receive


def attribute_template(names: Sequence[str], decimals: int) -> str:
    """Return the %-template of an element's attributes."""
    return " ".join(f'{name}="%.{decimals}f"' for name in names)


def check_axis_names(axes: Sequence[str]) -> None:
    """Raise ConfigurationError for a name that is no axis of RSI."""
    for axis in axes:
        if axis not in ROBOT_AXES and axis not in EXTERNAL_AXES:
            raise ConfigurationError("axes", axis, "A1 to A6 or E1 to E6")


def check_names(where: str, names: Sequence[str]) -> None:
    """Raise ConfigurationError for a name that cannot stand in a telegram."""
    for name in names:
        if not _NAME(name):
            raise ConfigurationError(where, name, "a letter, then letters, digits, '_', '.' or '-'")


def check_values(name: str, values: Sequence[float], count: int) -> None:
    """Raise TelegramError (``number``) unless there are `count` values, all finite."""
    if len(values) != count:
        raise TelegramError("number", f"{name} has {len(values)} values; expected {count}")
    if not all(map(math.isfinite, values)):
        raise TelegramError("number", f"{name} is {tuple(values)}; expected finite numbers")

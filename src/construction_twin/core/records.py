"""A record as plain JSON, field by field: one converter for all that travels as text. Standard library only.

A record is a frozen dataclass. Its fields are numbers, texts, truth values, enumerations (by name), other records, and tuples,
lists and mappings of them; keys are the fields' names, in their order. A number that is nan or infinite is null, because JSON has
neither. Where a field is written with decimals of its own, a time in whole ns as seconds, or only where there is a value,
`decimals`, `as_seconds` and `left_out` say so.
Reads nothing.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import MISSING, field, fields, is_dataclass
from enum import Enum
from typing import Any

from construction_twin.core.units import seconds

_DECIMALS, _LEFT_OUT = "decimals", "left out"
#: What stands between items, and between key and value: with blanks, or as short as it can be.
SPACED, COMPACT = (", ", ": "), (",", ":")
#: What `as_seconds` says of a field: what is written for 0.
ZERO = "zero"


def decimals(count: int, default: Any = MISSING) -> Any:
    """Return a field whose numbers are written with so many decimals, whatever the rest of its record has."""
    return field(default=default, metadata={_DECIMALS: count})


def left_out() -> Any:
    """Return a field, None where it is not given, that is written only where it is not None."""
    return field(default=None, metadata={_LEFT_OUT: True})


def as_seconds(zero: float | None = 0.0) -> Any:
    """Return a field of a time in whole ns, 0 where it is not given, that is written in seconds.

    Args:
        zero: What is written for 0: None where that means that there is no time.
    """
    return field(default=0, metadata={ZERO: zero})


def document(value: Any, places: int | None = None) -> Any:
    """Return a record, or a value of one, as what `json.dumps` takes.

    Args:
        places: Decimals of numbers; None: all that they have.
    """
    if isinstance(value, float):
        if not math.isfinite(value):
            return None
        return value if places is None else round(value, places)
    if isinstance(value, Enum):
        return value.name
    if is_dataclass(value):
        held = [(each, getattr(value, each.name)) for each in fields(value)]
        return {
            each.name: _written(item, each.metadata, places)
            for each, item in held
            if item is not None or _LEFT_OUT not in each.metadata
        }
    if isinstance(value, Mapping):
        return {key: document(item, places) for key, item in value.items()}
    return [document(item, places) for item in value] if isinstance(value, (list, tuple)) else value


def _written(value: Any, about: Mapping[str, Any], places: int | None) -> Any:
    if ZERO in about:
        return seconds(value) if value else about[ZERO]
    return document(value, about.get(_DECIMALS, places))


def dumped(value: Any, places: int | None = None, marks: tuple[str, str] = COMPACT) -> bytes:
    """Return a record as JSON."""
    return json.dumps(document(value, places), allow_nan=False, separators=marks).encode()

"""A record as plain JSON, field by field: one converter for all that travels as text. Standard library only.

A record is a frozen dataclass. Its fields are numbers, texts, truth values, enumerations (by name), other records, and tuples,
lists and mappings of them; keys are the fields' names, in their order. A number that is nan or infinite is null, because JSON has
neither. Where a field is written with decimals of its own, `decimals` says so. Reads nothing.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import field, fields, is_dataclass
from enum import Enum
from typing import Any

_DECIMALS = "decimals"


def decimals(count: int) -> Any:
    """Return a field whose numbers are written with so many decimals, whatever the rest of its record has."""
    return field(metadata={_DECIMALS: count})


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
        return {
            each.name: document(getattr(value, each.name), each.metadata.get(_DECIMALS, places))
            for each in fields(value)
        }
    if isinstance(value, Mapping):
        return {key: document(item, places) for key, item in value.items()}
    return [document(item, places) for item in value] if isinstance(value, (list, tuple)) else value


def dumped(value: Any, places: int | None = None) -> bytes:
    """Return a record as compact JSON; arguments as of `document`."""
    return json.dumps(document(value, places), allow_nan=False, separators=(",", ":")).encode()

"""A record as plain JSON, field by field: one converter for all that travels as text. Standard library only.

A record is a frozen dataclass. Its fields are numbers, texts, truth values, enumerations (by name), other records, and tuples,
lists and mappings of them; keys are the fields' names, in their order. A number that is nan or infinite is null, because JSON has
neither. Where a field is written otherwise, its metadata say so: `decimals` and `time_stamp`. Reads nothing.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import field, fields, is_dataclass
from enum import Enum
from typing import Any

from construction_twin.core.units import seconds

_DECIMALS, _TIME = "decimals", "time"


def decimals(count: int) -> Any:
    """Return a field whose numbers are written with so many decimals, whatever the rest of its record has."""
    return field(metadata={_DECIMALS: count})


def time_stamp(default: int | None = None, null: bool = False) -> Any:
    """Return a field that is a time in whole ns, and a number of seconds in JSON.

    Args:
        null: 0 means that it is not known, and is null in JSON.
    """
    metadata = {_TIME: null}
    return field(metadata=metadata) if default is None else field(default=default, metadata=metadata)


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
        return {each.name: _field(getattr(value, each.name), each.metadata, places) for each in fields(value)}
    if isinstance(value, Mapping):
        return {key: document(item, places) for key, item in value.items()}
    return [document(item, places) for item in value] if isinstance(value, (list, tuple)) else value


def dumped(value: Any, places: int | None = None) -> bytes:
    """Return a record as compact JSON; arguments as of `document`."""
    return json.dumps(document(value, places), allow_nan=False, separators=(",", ":")).encode()


def _field(value: Any, metadata: Mapping, places: int | None) -> Any:
    if _TIME in metadata:
        return None if metadata[_TIME] and not value else document(seconds(value), places)
    return document(value, metadata.get(_DECIMALS, places))

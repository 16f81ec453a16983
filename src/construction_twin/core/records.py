"""A frozen dataclass as plain JSON: keys are the fields' names; an enumeration is its name, nan and infinite numbers null."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import field, fields, is_dataclass
from enum import Enum
from typing import Any

from construction_twin.core.sentences import templates_of
from construction_twin.core.units import seconds

_LEFT_OUT = "left out"
#: What stands between items, and between key and value: with blanks, or as short as it can be.
SPACED, COMPACT = (", ", ": "), (",", ":")
#: What `seconds_field` says of a field: what is written for 0.
_ZERO = "zero"


class SchemaKeywords(dict):
    """Keywords of a value in a JSON Schema besides its type, for `Annotated`: pydantic reads them where schemas are made."""

    def __get_pydantic_json_schema__(self, core_schema: Any, handler: Any) -> dict[str, Any]:
        return handler(core_schema) | self


#: Of a number that may be nan, and of a time in whole ns, as JSON has them.
OR_NULL, SECONDS = SchemaKeywords(type=["number", "null"]), SchemaKeywords(type="number")


def optional_field() -> Any:
    """Return an optional field: None by default, and then left out of the JSON."""
    return field(default=None, metadata={_LEFT_OUT: True})


def seconds_field(zero: float | None = 0.0) -> Any:
    """Return a field of a time in whole ns, 0 where it is not given, that is written in seconds, and 0 as `zero`."""
    return field(default=0, metadata={_ZERO: zero})


def json_value(value: Any) -> Any:
    """Return a record, or a value of one, as what `json.dumps` takes."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Enum):
        return value.name
    if is_dataclass(value):
        held = [(each, getattr(value, each.name)) for each in fields(value)]
        return {
            each.name: _written(item, each.metadata)
            for each, item in held
            if item is not None or _LEFT_OUT not in each.metadata
        }
    if isinstance(value, Mapping):
        return {key: json_value(item) for key, item in value.items()}
    return [json_value(item) for item in value] if isinstance(value, (list, tuple)) else value


def _written(value: Any, about: Mapping[str, Any]) -> Any:
    if _ZERO in about:
        return seconds(value) if value else about[_ZERO]
    return json_value(value)


def to_json(value: Any, separators: tuple[str, str] = COMPACT, translatable: bool = False) -> bytes:
    """Return a record as JSON; `translatable`: with the templates of its sentences (`core.sentences.templates_of`)."""
    written, sentences = json_value(value), templates_of(value) if translatable else {}
    if sentences:
        written["said"] = sentences
    return json.dumps(written, allow_nan=False, separators=separators).encode()

"""Schemas of what travels are those of the records, and what is sent keeps them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

import schemas

from construction_twin.core.records import as_seconds


@dataclass(frozen=True)
class Inner:
    """What is inside.

    Attributes:
        near, far: Two distances,
            of one kind [m].
    """

    near: float
    far: Annotated[float | None, {"minimum": 0, "since": 2}]


@dataclass(frozen=True)
class Outer:
    """What is outside.

    Attributes:
        inner: Null: nothing.
    """

    inner: Inner | None
    word: Literal["a", "b"]
    texts: Mapping[str, str]
    units: Annotated[Mapping[str, str], {"const": {"length": "m"}}]
    counts: Sequence[int] = ()
    flag: bool = False
    more: tuple[str, ...] = field(default_factory=tuple)
    stamp: int = as_seconds()
    begun: int = as_seconds(None)


def test_types_bounds_and_words_are_those_of_the_record():
    made = schemas.schema(Outer)
    assert made["description"] == "What is outside." and made["additionalProperties"] is False
    assert made["properties"]["inner"] == {
        "type": ["object", "null"],
        "description": "Null: nothing.",
        "additionalProperties": False,
        "required": ["near", "far"],
        "properties": {
            "near": {"type": "number", "description": "Two distances, of one kind [m]."},
            "far": {
                "type": ["number", "null"], "minimum": 0, "since": 2, "description": "Two distances, of one kind [m].",
            },
        },
    }  # fmt: skip
    assert made["properties"]["word"] == {"enum": ["a", "b"]}
    assert made["properties"]["texts"] == {"type": "object", "additionalProperties": {"type": "string"}}
    assert made["properties"]["units"] == {"const": {"length": "m"}}
    assert [made["properties"][name]["type"] for name in ("stamp", "begun")] == ["number", ["number", "null"]]
    assert made["properties"]["counts"] == {"type": "array", "items": {"type": "integer"}}


def test_what_has_a_default_may_be_missing():
    assert schemas.schema(Outer)["required"] == ["inner", "word", "texts", "units"]


def test_the_page_needs_no_words():
    assert "description" not in str(schemas.schema(Outer, words=False))

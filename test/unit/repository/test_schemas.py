"""Schemas of what travels are those of the records, and what is sent keeps them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Literal

import schemas

from construction_twin.core.records import OR_NULL, SECONDS, SchemaKeywords, seconds_field


@dataclass(frozen=True)
class Inner:
    """What is inside.

    Attributes:
        near, far: Two distances,
            of one kind [m].
    """

    near: float
    far: Annotated[float | None, SchemaKeywords(minimum=0)]


@dataclass(frozen=True)
class Outer:
    """What is outside.

    Attributes:
        inner: Null: nothing.
    """

    inner: Inner | None
    word: Literal["a", "b"]
    texts: Mapping[str, str]
    units: Annotated[Mapping[str, str], SchemaKeywords(const={"length": "m"})]
    counts: Sequence[int] = ()
    flag: bool = False
    more: tuple[str, ...] = field(default_factory=tuple)
    stamp: Annotated[int, SECONDS] = seconds_field()
    begun: Annotated[int, OR_NULL] = seconds_field(None)


def test_types_bounds_and_words_are_those_of_the_record():
    made = schemas.schema(Outer)
    assert (
        made["description"].startswith("What is outside. Attributes: inner:") and made["additionalProperties"] is False
    )
    inner = made["properties"]["inner"]
    assert inner.pop("description").endswith("Two distances, of one kind [m].")
    assert inner == {
        "type": ["object", "null"],
        "additionalProperties": False,
        "required": ["near", "far"],
        "properties": {"near": {"type": "number"}, "far": {"type": ["number", "null"], "minimum": 0}},
    }
    assert made["properties"]["word"]["enum"] == ["a", "b"]
    assert made["properties"]["texts"] == {"type": "object", "additionalProperties": {"type": "string"}}
    assert made["properties"]["units"]["const"] == {"length": "m"}
    assert [made["properties"][name]["type"] for name in ("stamp", "begun")] == ["number", ["number", "null"]]
    assert made["properties"]["counts"] == {"type": "array", "items": {"type": "integer"}}


def test_what_has_a_default_may_be_missing_and_the_page_needs_no_words():
    assert schemas.schema(Outer)["required"] == ["inner", "word", "texts", "units"]
    assert "description" not in str(schemas.schema(Outer, words=False))

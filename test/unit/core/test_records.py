"""A record as plain JSON: each kind of field, and what JSON has no word for."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from enum import Enum

from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.records import SPACED, json_value, optional_field, seconds_field, to_json


class Kind(Enum):
    BOX = 3


@dataclass(frozen=True)
class Inner:
    value: float
    kind: Kind = Kind.BOX


@dataclass(frozen=True)
class Outer:
    name: str
    inner: Inner | None
    parts: tuple[Inner, ...] = ()
    counts: dict[str, int] = field(default_factory=dict)
    stamp: int = 0


@dataclass(frozen=True)
class Timed:
    stamp: int = seconds_field()
    begun: int = seconds_field(None)


@dataclass(frozen=True)
class Partly:
    name: str | None = None
    more: str | None = optional_field()
    parts: tuple[Inner, ...] | None = optional_field()


def test_what_is_left_out_is_not_there_unless_it_is_a_value_which_may_be_empty():
    assert json_value(Partly()) == {"name": None}
    assert json_value(Partly(more="", parts=())) == {"name": None, "more": "", "parts": []}
    assert json_value(Partly(parts=(Inner(0.5),)))["parts"] == [{"value": 0.5, "kind": "BOX"}]


def test_marks_are_as_short_as_they_can_be_or_with_blanks():
    assert to_json(Inner(0.5)) == b'{"value":0.5,"kind":"BOX"}'
    assert to_json([Inner(0.5), 1], separators=SPACED) == b'[{"value": 0.5, "kind": "BOX"}, 1]'


def test_fields_come_in_their_order_with_what_they_hold():
    record = Outer("ä", Inner(0.5), (Inner(1.0), Inner(2.0)), {"b": 1, "a": 2}, 1_500_000_000)
    assert json.dumps(json_value(record)) == (
        '{"name": "\\u00e4", "inner": {"value": 0.5, "kind": "BOX"}, "parts": [{"value": 1.0, "kind": "BOX"}, '
        '{"value": 2.0, "kind": "BOX"}], "counts": {"b": 1, "a": 2}, "stamp": 1500000000}'
    )


def test_what_is_no_number_is_null_at_every_depth():
    record = Outer("", Inner(math.nan), (Inner(math.inf), Inner(-math.inf)))
    assert [json_value(record)["inner"]["value"], *(part["value"] for part in json_value(record)["parts"])] == [
        None
    ] * 3
    assert json_value([math.nan, [math.inf]]) == [None, [None]]


@given(st.text(), st.floats(), st.lists(st.floats(), max_size=5), st.integers(0, 2**62))
def test_json_is_that_of_the_values_one_by_one(name, value, values, stamp):
    plain = [number if math.isfinite(number) else None for number in (value, *values)]
    parts = [{"value": number, "kind": "BOX"} for number in plain]
    wanted = {
        "name": name,
        "inner": parts[0],
        "parts": parts[1:],
        "counts": {},
        "stamp": stamp,
    }
    record = Outer(name, Inner(value), tuple(map(Inner, values)), {}, stamp)
    assert to_json(record) == json.dumps(wanted, allow_nan=False, separators=(",", ":")).encode()


def test_a_time_in_whole_ns_is_written_in_seconds_and_where_there_is_none_as_null():
    assert json_value(Timed(1_500_000_000, 2_000_000_001)) == {"stamp": 1.5, "begun": 2.000000001}
    assert json_value(Timed()) == {"stamp": 0.0, "begun": None}

"""A record as plain JSON: each kind of field, and what JSON has no word for."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from enum import Enum

from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.records import decimals, document, dumped, time_stamp


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
    stamp: int = time_stamp(0)
    begun: int = time_stamp(0, null=True)


@dataclass(frozen=True)
class Rounded:
    fine: float = decimals(3)
    coarse: float = 0.0


def test_fields_come_in_their_order_with_what_they_hold():
    record = Outer("ä", Inner(0.5), (Inner(1.0), Inner(2.0)), {"b": 1, "a": 2}, 1_500_000_000, 2_250_000_000)
    assert json.dumps(document(record)) == (
        '{"name": "\\u00e4", "inner": {"value": 0.5, "kind": "BOX"}, "parts": [{"value": 1.0, "kind": "BOX"}, '
        '{"value": 2.0, "kind": "BOX"}], "counts": {"b": 1, "a": 2}, "stamp": 1.5, "begun": 2.25}'
    )


def test_what_is_no_number_is_null_at_every_depth():
    record = Outer("", Inner(math.nan), (Inner(math.inf), Inner(-math.inf)))
    assert [document(record)["inner"]["value"], *(part["value"] for part in document(record)["parts"])] == [None] * 3
    assert document([math.nan, [math.inf]], 3) == [None, [None]]


def test_a_time_is_seconds_and_null_only_where_0_means_not_known():
    made = document(Outer("", None))
    assert (made["inner"], made["stamp"], made["begun"]) == (None, 0.0, None)


def test_decimals_are_those_of_the_field_before_those_of_the_message():
    assert document(Rounded(1.23456789, 1.23456789), 5) == {"fine": 1.235, "coarse": 1.23457}
    assert document(Rounded(1.23456789, 1.23456789)) == {"fine": 1.235, "coarse": 1.23456789}


@given(st.text(), st.floats(), st.lists(st.floats(), max_size=5), st.integers(0, 2**62))
def test_json_is_that_of_the_values_one_by_one(name, value, values, stamp):
    plain = [number if math.isfinite(number) else None for number in (value, *values)]
    seconds = stamp // 10**9 + stamp % 10**9 / 1e9
    parts = [{"value": number, "kind": "BOX"} for number in plain]
    wanted = {
        "name": name,
        "inner": parts[0],
        "parts": parts[1:],
        "counts": {},
        "stamp": seconds,
        "begun": seconds or None,
    }
    record = Outer(name, Inner(value), tuple(map(Inner, values)), {}, stamp, stamp)
    assert dumped(record) == json.dumps(wanted, allow_nan=False, separators=(",", ":")).encode()

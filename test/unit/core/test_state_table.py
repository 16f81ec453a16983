"""State machines: rows found in their order."""

from __future__ import annotations

from enum import Enum

from construction_twin.core.state_table import Rows, row_of, rows_by_event


class Number(Enum):
    REST = 0
    MOTION = 1


class Event(Enum):
    GO = "a person says go"
    WAIT = "a person says wait"


class Guard(Enum):
    ALWAYS = ""
    ALLOWED = "the key is turned"


class Action(Enum):
    NOTHING = ""
    HONK = "it honks"


rows = Rows(Number, Event, Guard, Action)
TABLE = (
    *rows(Number.REST, Event.GO, Number.MOTION, Action.HONK, Guard.ALLOWED),
    *rows(Number, Event.GO),
)


def test_rows_of_a_cause_are_tried_in_the_table_s_order_and_every_cause_has_an_entry():
    found = rows_by_event(TABLE)
    assert set(found) == {(state, event) for state in Number for event in Event}
    assert found[Number.REST, Event.GO] == TABLE[:2] and found[Number.MOTION, Event.GO] == TABLE[2:]
    assert found[Number.REST, Event.WAIT] == ()


def test_a_state_that_is_a_value_finds_its_row_in_the_same_order():
    rows = rows_by_event(TABLE)
    first, second = rows[Number.REST, Event.GO]
    assert row_of(rows, Number.REST, Event.GO, lambda guard: True) is first
    assert row_of(rows, Number.REST, Event.GO, lambda guard: False) is second
    assert row_of(rows, Number.REST, Event.WAIT, lambda guard: True) is None

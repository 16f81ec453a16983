"""Rows of state machines: found in their order, and told in words."""

from __future__ import annotations

from enum import Enum

from construction_twin.core.state_table import by_cause, cells, rows


class Number(Enum):
    REST = 0
    MOTION = 1


class Word(Enum):
    REST = "at_rest"


class Event(Enum):
    GO = "a person says go"
    WAIT = "a person says wait"


class Guard(Enum):
    ALWAYS = ""
    ALLOWED = "the key is turned"


class Action(Enum):
    NOTHING = ""
    HONK = "it honks"


TABLE = (
    *rows([Number.REST], Event.GO, Guard.ALLOWED, Action.HONK, Number.MOTION),
    *rows(Number, Event.GO, Guard.ALWAYS, Action.NOTHING, None),
)


def test_rows_of_a_cause_are_tried_in_the_table_s_order_and_every_cause_has_an_entry():
    found = by_cause(TABLE)
    assert set(found) == {(state, event) for state in Number for event in Event}
    assert found[Number.REST, Event.GO] == TABLE[:2] and found[Number.MOTION, Event.GO] == TABLE[2:]
    assert found[Number.REST, Event.WAIT] == ()


def test_a_table_is_told_in_words_and_a_state_that_stays_is_left_out():
    assert cells(TABLE)[:2] == [
        ("REST", "a person says go", "the key is turned", "it honks", "MOTION"),
        ("REST", "a person says go", "", "", ""),
    ]
    assert cells(tuple(rows(Word, Event.WAIT, Guard.ALWAYS, Action.NOTHING, Word.REST))) == [
        ("at_rest", "a person says wait", "", "", "at_rest")
    ]

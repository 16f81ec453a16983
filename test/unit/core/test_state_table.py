"""State machines: rows found in their order and told in words, and the one runner of every table."""

from __future__ import annotations

from enum import Enum

import pytest

from construction_twin.core.state_table import Machine, Occasion, Rows, by_cause, conditions, row_of


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


rows = Rows(Number, Event, Guard, Action)
TABLE = (
    *rows(Number.REST, Event.GO, Number.MOTION, Action.HONK, Guard.ALLOWED),
    *rows(Number, Event.GO),
)
HONKS = {Action.HONK: lambda row, occasion: None}
TURNED = conditions({Guard.ALLOWED: lambda occasion: occasion.now > 0})


def machine(actions=HONKS, guards=TURNED, **options) -> Machine:
    return Machine(by_cause(TABLE), Number.REST, "just built", guards, actions, **options)


def test_rows_of_a_cause_are_tried_in_the_table_s_order_and_every_cause_has_an_entry():
    found = by_cause(TABLE)
    assert set(found) == {(state, event) for state in Number for event in Event}
    assert found[Number.REST, Event.GO] == TABLE[:2] and found[Number.MOTION, Event.GO] == TABLE[2:]
    assert found[Number.REST, Event.WAIT] == ()


def test_the_first_row_that_nothing_speaks_against_is_applied_and_its_state_entered_for_a_reason():
    seen = []
    driven = machine(after=lambda row, occasion: seen.append((row.target, occasion.reason)))
    driven.changed = False
    assert driven.on(Event.GO, Occasion("somebody said so", 1)) == ""
    assert (driven.state, driven.reason, driven.changed) == (Number.MOTION, "somebody said so", True)
    assert seen == [(Number.MOTION, "somebody said so")]


def test_a_row_without_a_next_state_leaves_state_and_reason():
    driven = machine()
    driven.changed = False
    assert driven.on(Event.GO, Occasion("the key is not turned", 0)) == ""
    assert (driven.state, driven.reason, driven.changed) == (Number.REST, "just built", False)


def test_an_action_may_say_itself_why_the_next_state_is_entered():
    driven = machine({Action.HONK: lambda row, occasion: f"honked at {row.state.name}"})
    driven.on(Event.GO, Occasion("somebody said so", 1))
    assert driven.reason == "honked at REST"


def test_an_event_that_no_row_takes_is_refused_in_a_sentence():
    refused = machine().on(Event.WAIT, Occasion())
    assert refused == "it is REST: just built"
    assert machine(refusal=lambda: "no").on(Event.WAIT, Occasion()) == "no"
    only = Machine(by_cause(TABLE[:1]), Number.REST, "", {Guard.ALLOWED: lambda occasion: "no key"}, HONKS)
    assert only.on(Event.GO, Occasion()) == "no key" and only.state is Number.REST


def test_what_would_be_applied_can_be_asked_without_applying_it():
    driven = machine()
    assert driven.row(Event.GO, Occasion(now=1)) is TABLE[0] and driven.row(Event.GO, Occasion()) is TABLE[1]
    assert driven.row(Event.WAIT, Occasion()) is None and driven.state is Number.REST


@pytest.mark.parametrize("actions, guards, missing", [({}, TURNED, "HONK"), (HONKS, {}, "ALLOWED")])
def test_a_machine_without_a_function_for_a_guard_or_an_action_of_its_table_is_not_built(actions, guards, missing):
    with pytest.raises(ValueError, match=missing):
        machine(actions, guards)


def test_a_note_is_added_to_the_reason_in_place_of_the_one_before_and_taken_back():
    driven = machine()
    driven.add("first")
    driven.add("second")
    assert driven.reason == "just built; second"
    driven.changed = False
    driven.drop()
    assert (driven.reason, driven.changed) == ("just built", True)


def test_a_state_that_is_a_value_finds_its_row_in_the_same_order():
    rows = by_cause(TABLE)
    first, second = rows[Number.REST, Event.GO]
    assert row_of(rows, Number.REST, Event.GO, lambda guard: True) is first
    assert row_of(rows, Number.REST, Event.GO, lambda guard: False) is second
    assert row_of(rows, Number.REST, Event.WAIT, lambda guard: True) is None

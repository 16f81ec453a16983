"""Sentences: their English text, and what another language needs of them, sent and heard again."""

from __future__ import annotations

import copy
import json
import math
import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from construction_twin.core.records import to_json
from construction_twin.core.reports import HoldReport
from construction_twin.core.sentences import (
    Quantity,
    Sentence,
    join_sentences,
    replace_part,
    sentences_of,
    templates_of,
)

TEXTS = st.text(max_size=20)


@pytest.mark.parametrize(
    "form, quantity, text",
    [
        ("", Quantity(math.radians(2.5), "rad"), "2.5 deg"),
        ("", Quantity(0.0123, "m/s"), "12.3 mm/s"),
        ("", Quantity(2.0, "N"), "2 N"),
        (".3", Quantity(math.radians(1), "rad"), "1.000 deg"),
        (".6q", Quantity(0.1, "rad"), "0.100000 rad"),
        (".2", Quantity(math.nan, "m"), "nan mm"),
    ],
)
def test_a_quantity_is_written_in_the_units_of_people_or_in_its_own(form, quantity, text):
    assert format(quantity, form) == text


def test_a_sentence_is_its_text_and_knows_its_template_and_values():
    said = Sentence("the gate holds ({state})", state="HOLDING")
    assert said == "the gate holds (HOLDING)" and isinstance(said, str)
    for copied in (said, copy.deepcopy(said), pickle.loads(pickle.dumps(said))):
        assert (copied.template, copied.values) == ("the gate holds ({state})", {"state": "HOLDING"})
    with pytest.raises(KeyError):
        Sentence("the gate holds ({state})")


def test_what_is_told_has_each_value_as_it_is_written():
    inner = Sentence("{joint} differs by {error:.3}", joint="A3", error=Quantity(math.radians(1), "rad"))
    cause = Sentence("{reason}, {count} times in {seconds:.1f} s", reason=inner, count=2, seconds=0.25)
    assert templates_of(HoldReport(cause), ["a word", Sentence("without values")]) == {
        cause: {"template": cause.template, "values": {"reason": inner, "count": "2", "seconds": "0.2"}},
        inner: {"template": inner.template, "values": {"joint": "A3", "error": "1.000 deg"}},
    }
    assert json.loads(to_json(HoldReport(cause), translatable=True))["said"] == templates_of(cause)


@given(TEXTS, TEXTS, st.floats(allow_nan=False))
def test_what_is_heard_can_be_told_again(one, other, number):
    sentence = join_sentences(
        Sentence("{number:.2f} of {one}", number=number, one=one), Sentence("then {other}", other=other)
    )
    sent = json.loads(json.dumps(templates_of(sentence)))
    again = sentences_of(sent)[sentence]
    assert again == sentence and again.template == "{first}; {second}" and templates_of(again) == sent
    assert isinstance(again.values["first"], Sentence)


def test_a_sentence_that_is_said_to_hold_itself_is_heard_once():
    known = sentences_of(
        {"a": {"template": "{x}", "values": {"x": "a"}}, "b": {"template": "{x}", "values": {"x": "a"}}}
    )
    assert set(known) == {"a"} and type(known["a"].values["x"]) is str


def test_a_part_that_has_changed_is_said_in_its_place():
    holds, opened = Sentence("the gate holds ({state})", state="HOLDING"), Sentence("the gate held, and is open again")
    end = Sentence("{end}; look at the arm", end=join_sentences(Sentence("stop was asked for"), holds))
    changed = replace_part(end, holds, opened)
    assert changed == end.replace(holds, opened) and changed.template == end.template
    assert changed.values["end"].values["second"] is opened
    assert replace_part(holds, holds, opened) is opened and replace_part("a word", holds, opened) == "a word"

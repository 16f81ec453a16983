"""The sentences: every key in every language with the same values; places filled in as on the page."""

from __future__ import annotations

import copy
import json
import math
import re
from pathlib import Path

import pytest

from construction_twin.core.sentences import (
    Quantity,
    Sentence,
    fill,
    has,
    key_and_values,
    replaced,
    understood,
)

ROOT = Path(__file__).parents[3]
SENTENCES = json.loads((ROOT / "src/construction_twin/core/sentences.json").read_text())
CASES = json.loads((ROOT / "web/test/support/sentence_cases.json").read_text())


def places(text: str) -> set[str]:
    return set(re.findall(r"\{(\w+)[:}]", text))


def test_every_key_has_words_in_both_languages_with_the_same_values():
    for key, words in SENTENCES.items():
        assert set(words) == {"en", "de"}, key
        assert all(text and text == text.strip() for text in words.values()), key
        assert places(words["en"]) == places(words["de"]), key
        # what cannot be filled in is no place
        rest = re.sub(r"\{\w+(:(g|s|t|\.\df|\.\dq|(\.\d)?p))?\}", "", words["en"] + words["de"])
        assert "{" not in rest and "}" not in rest, key


def value_of(value: object) -> object:
    if isinstance(value, dict):
        return Quantity(math.nan if value["value"] is None else value["value"], value["unit"])
    return math.nan if value is None else value


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["text"])
def test_places_are_filled_in_as_on_the_page(case):
    assert fill(case["template"], {name: value_of(value) for name, value in case["values"].items()}) == case["text"]


def test_a_sentence_is_its_text_and_knows_its_key_and_values():
    said = Sentence("line.startup.broker.waits", broker="here:1883")
    assert said == "the MQTT broker here:1883" and isinstance(said, str)
    assert key_and_values(said) == {"key": "line.startup.broker.waits", "values": {"broker": "here:1883"}}
    assert key_and_values(copy.deepcopy(said)) == key_and_values(said) and key_and_values(str(said)) is None
    written = Sentence("the gate holds ({state})", state="HOLDING")
    assert key_and_values(written) == {"key": "executor.gate_holds", "values": {"state": "HOLDING"}}
    with pytest.raises(KeyError):
        Sentence("the gate holds ({state})")
    assert has("page.title") and not has("line.nothing")


def test_a_task_is_its_id_or_its_name_in_quotes_with_it():
    for task in ("0aB$", "'Place stud' (T2)", '"Eva\'s stud" (T2)', "'' (T2)"):
        said = Sentence("work.waits", task=task, tasks="'Place plate' (T1)")
        found = understood(str(said))
        assert (found.key, found.values) == (said.key, said.values)
    # what else waits is no task
    assert understood("stands at a boundary, waits for the tool").key == "executor.stands_and_waits"


def test_a_part_that_has_changed_is_said_in_its_place():
    holds, opened = Sentence("executor.gate_holds", state="HOLDING"), Sentence("executor.gate_open_again")
    end = Sentence(
        "executor.end.look", end=Sentence("executor.both", first=Sentence("executor.stop_asked"), second=holds)
    )
    changed = replaced(end, holds, opened)
    assert changed == end.replace(holds, opened) and changed.key == end.key
    assert changed.values["end"].values["second"].key == "executor.gate_open_again"
    assert replaced(holds, holds, opened) is opened and replaced("a word", holds, opened) == "a word"

"""The sentences: every key in every language with the same values, none unused, none missing; places filled in as on the page."""

from __future__ import annotations

import copy
import json
import math
import re
from pathlib import Path

import pytest

from construction_twin.core.sentences import Quantity, Sentence, fill, has, said_in

ROOT = Path(__file__).parents[3]
SENTENCES = json.loads((ROOT / "src/construction_twin/core/sentences.json").read_text())
CASES = json.loads((ROOT / "web/test/support/sentence_cases.json").read_text())
#: Where keys may be named: programs and page.
SOURCES = [*(ROOT / "src").rglob("*.py"), *(ROOT / "web/src").rglob("*.js")]
#: A text in quotes that may be a key, or the form of several: `verdict.blocked.${why}`, f"line.{key}.{part}".
KEY = re.compile(r"""["'`](\w+\.(?:[\w.]|\$?\{[^}]*\})+)["'`]""")
#: A key that is given to what makes a sentence: it must be there.
GIVEN = re.compile(r"""(?:\b(?:Sentence|texts)\(\s*|\bkey: )["'](\w[\w.]*)["']""")


def places(text: str) -> set[str]:
    return set(re.findall(r"\{(\w+)[:}]", text))


def named() -> set[str]:
    return {key for source in SOURCES for key in KEY.findall(source.read_text())}


def test_every_key_has_words_in_both_languages_with_the_same_values():
    for key, words in SENTENCES.items():
        assert set(words) == {"en", "de"}, key
        assert all(text and text == text.strip() for text in words.values()), key
        assert places(words["en"]) == places(words["de"]), key
        # what cannot be filled in is no place
        rest = re.sub(r"\{\w+(:(g|\.\df|\.\dq|(\.\d)?p))?\}", "", words["en"] + words["de"])
        assert "{" not in rest and "}" not in rest, key


def test_no_key_is_unused():
    forms = [re.escape(key) for key in named()]
    forms = [re.sub(r"(?:\\\$)?\\\{.*?\\\}", r"[\\w.]+", form) for form in forms]
    used = re.compile("|".join(forms))
    assert [key for key in SENTENCES if not used.fullmatch(key)] == []


def test_no_key_that_is_used_is_missing():
    wanted = {(key, source.name) for source in SOURCES for key in GIVEN.findall(source.read_text())}
    assert len(wanted) > 100
    assert [each for each in sorted(wanted) if each[0] not in SENTENCES] == []


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
    assert said_in(said) == {"key": "line.startup.broker.waits", "values": {"broker": "here:1883"}}
    assert said_in(copy.deepcopy(said)) == said_in(said) and said_in(str(said)) is None
    with pytest.raises(KeyError):
        Sentence("line.nothing")
    assert has("page.title") and not has("line.nothing")

"""The sentences: every key in every language with the same values, none unused, none missing; places filled in as on the page."""

from __future__ import annotations

import copy
import json
import math
import re
from pathlib import Path

import pytest

from construction_twin.core.sentences import Quantity, Sentence, fill, has, said_in, understood

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
        rest = re.sub(r"\{\w+(:(g|s|\.\df|\.\dq|(\.\d)?p))?\}", "", words["en"] + words["de"])
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


def sample(template: str, reason: str) -> dict[str, object]:
    """Values for a template: such as its places may have, `reason` for a part that is a sentence itself."""
    values: dict[str, object] = {}
    for name, decimals, form in re.findall(r"\{(\w+)(?::\.?(\d?)(\w))?\}", template):
        number = round(1.23456789, int(decimals or 3))
        quantity = Quantity(math.radians(12.5) if form == "p" else number, "rad")
        values[name] = (
            quantity if form in ("p", "q") else number if form in ("f", "g") else reason if form == "s" else "word"
        )
    return values


REASONS = [key for key in SENTENCES if key.startswith("reason.")]


@pytest.mark.parametrize("key", REASONS)
def test_a_reason_is_found_in_its_text_again(key):
    """ROS messages carry the text; no reason reads as another one."""
    inner = Sentence(
        "reason.motion.velocity", joint="joint_a1", value=Quantity(3.0, "rad/s"), limit=Quantity(2.0, "rad/s")
    )
    for reason in ("joint_a1", inner):
        said = Sentence(key, **sample(SENTENCES[key]["en"], reason))
        found = understood(str(said))
        assert found == said and found.key == key and found.values.keys() == said.values.keys()
        for name, value in said.values.items():
            again = found.values[name]
            if isinstance(value, Quantity):
                assert again.unit == value.unit and again.value == pytest.approx(value.value, rel=1e-5)
            else:
                assert again == value and getattr(again, "key", "") == getattr(value, "key", "")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "at 2.1 s",
        # not to the letter
        "joint_a3 differs by 0.7 deg",
        "joint_a3 differs by 0.01 rad, threshold 0.010000 rad",
        "joint_a3 differs by x rad, threshold 0.010000 rad",
        # a sentence, but no reason of a node
        "Twin and arm agree.",
    ],
)
def test_a_text_that_is_no_reason_to_the_letter_has_no_key(text):
    assert understood(text) is None

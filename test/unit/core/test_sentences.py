"""The sentences: every key in every language with the same values, none unused, none missing; places filled in as on the page."""

from __future__ import annotations

import copy
import json
import math
import re
from pathlib import Path

import pytest

from construction_twin.core.sentences import (
    REASONS,
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
        rest = re.sub(r"\{\w+(:(g|s|t|\.\df|\.\dq|(\.\d)?p))?\}", "", words["en"] + words["de"])
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


@pytest.mark.parametrize(
    "key", [key for key in SENTENCES if key.startswith("ifc.note.") and not SENTENCES[key]["en"].endswith(":s}")]
)
def test_a_note_with_the_names_that_it_holds_for_is_found_in_its_text_again(key):
    """The page gets the text alone. What ends with a text takes the names for a part of that."""
    values = {name: "IFC4" for name in re.findall(r"\{(\w+)", SENTENCES[key]["en"])}
    note = Sentence("ifc.note.of", note=Sentence(key, **values), names="wall (0000000000000000000008), #12=IFCWALL")
    found = understood(str(note))
    assert found is not None and (found.key, found.values["note"].key) == ("ifc.note.of", key)


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
    with pytest.raises(KeyError):
        Sentence("line.nothing")
    assert has("page.title") and not has("line.nothing")


def sample(template: str, part: str, reason: str) -> dict[str, object]:
    """Values for a template: such as its places may have, for what may be a sentence `part`, and `reason` for the last of them."""
    values: dict[str, object] = {}
    for name, decimals, form in re.findall(r"\{(\w+)(?::\.?(\d?)(\w))?\}", template):
        number = round(1.23456789, int(decimals or 3))
        quantity = Quantity(math.radians(12.5) if form == "p" else number, "rad")
        values[name] = (
            quantity if form in ("p", "q") else number if form in ("f", "g") else part if form == "s" else "word"
        )
    texts = [name for name, value in values.items() if value is part]
    return values | {name: reason for name in texts[-1:]}


REASON_KEYS = [key for key in SENTENCES if key.startswith(REASONS)]


@pytest.mark.parametrize("key", REASON_KEYS)
def test_a_reason_is_found_in_its_text_again(key):
    """ROS messages carry the text; no reason reads as another one."""
    inner = Sentence(
        "reason.motion.velocity", joint="joint_a1", value=Quantity(3.0, "rad/s"), limit=Quantity(2.0, "rad/s")
    )
    words = re.sub(r"\{.*?\}", "", SENTENCES[key]["en"])
    # what has no words of its own is found around another sentence only
    parts = [("joint_a1", "joint_a2")] if any(letter.isalpha() for letter in words) else []
    for part, reason in [*parts, (Sentence("executor.where.before"), inner)]:
        said = Sentence(key, **sample(SENTENCES[key]["en"], part, reason))
        found = understood(str(said))
        assert found == said and found.key == key and found.values.keys() == said.values.keys()
        for name, value in said.values.items():
            again = found.values[name]
            if isinstance(value, Quantity):
                assert again.unit == value.unit and again.value == pytest.approx(value.value, rel=1e-5)
            else:
                assert again == value and getattr(again, "key", "") == getattr(value, "key", "")


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


@pytest.mark.parametrize(
    "text",
    [
        "",
        # no words of its own, and nothing that is understood
        "this; that",
        "this: that",
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

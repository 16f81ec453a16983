"""The German of the page and of what it hears: every template of the page has some, and nothing stands there that nobody says."""

from __future__ import annotations

import re
from functools import cache

from translations import ROOT, german, templates

GERMAN = german()


@cache
def said(where: str) -> list[str]:
    """Return the templates of a folder; those that the page has, too, are the page's."""
    found = templates(where)
    return found if where == "web/src" else [template for template in found if template not in said("web/src")]


def places(text: str) -> set[str]:
    return set(re.findall(r"\{(\w+)(?::[^}]*)?\}", text))


def test_every_template_of_the_page_has_german():
    assert len(said("web/src")) > 300
    assert [template for template in said("web/src") if not GERMAN.get(template)] == []


def test_every_template_of_the_programs_has_german():
    assert len(said("src/construction_twin")) > 300
    assert [template for template in said("src/construction_twin") if not GERMAN.get(template)] == []


def test_nothing_is_translated_that_nobody_says():
    assert set(GERMAN) <= {*said("web/src"), *said("src/construction_twin")}, (
        "python scripts/translations.py takes it out"
    )


def test_german_has_the_places_of_its_template():
    translated = {template: words for template, words in GERMAN.items() if words}
    assert [each for each in translated.items() if places(each[0]) != places(each[1])] == []
    assert [words for words in translated.values() if words != words.strip()] == []


def test_the_page_says_nothing_by_key():
    """What is chosen among stands in a table of `mark`: a text that is put together is no template that could be found."""
    for file in (ROOT / "web/src").rglob("*.js"):
        assert not re.search(r"\b(?:texts|mark)\(`|\btexts\([^\n\"]*\? \"", file.read_text()), file

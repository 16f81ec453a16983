"""The German of the page and of what it hears: every template of the page has some, and nothing stands there that nobody says."""

from __future__ import annotations

import re

from translations import ROOT, german, templates

GERMAN = german()
PAGE = templates("web/src")
PROGRAMS = [template for template in templates("src/construction_twin") if template not in PAGE]


def places(text: str) -> set[str]:
    return set(re.findall(r"\{(\w+)(?::[^}]*)?\}", text))


def test_every_template_of_the_page_has_german():
    assert len(PAGE) > 300
    assert [template for template in PAGE if not GERMAN.get(template)] == []


def test_every_template_of_the_programs_has_german():
    assert len(PROGRAMS) > 300
    assert [template for template in PROGRAMS if not GERMAN.get(template)] == []


def test_nothing_is_translated_that_nobody_says():
    assert set(GERMAN) <= {*PAGE, *PROGRAMS}, "python scripts/translations.py takes it out"


def test_german_has_the_places_of_its_template():
    translated = {template: words for template, words in GERMAN.items() if words}
    assert [each for each in translated.items() if places(each[0]) != places(each[1])] == []
    assert [words for words in translated.values() if words != words.strip()] == []


def test_the_page_says_nothing_by_key():
    """What is chosen among stands in a table of `mark`: a text that is put together is no template that could be found."""
    for file in (ROOT / "web/src").rglob("*.js"):
        assert not re.search(r"\b(?:texts|mark)\(`|\btexts\([^\n\"]*\? \"", file.read_text()), file

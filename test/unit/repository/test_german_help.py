"""The German help (docs/de) is there for each line that has a link to help, and says what the English says.

A heading that translates one of the English page has a line above it: ``<a id="3-look"></a> <!-- en 1a2b3c4d -->``, with the
English heading's anchor, so that a link needs no language, and the hash of the English section as it was when it was translated.
"""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import pytest

from construction_twin.views.status_line import TABLE

ROOT = Path(__file__).resolve().parents[3]
DOCS = ROOT / "docs"
GERMAN = DOCS / "de"
PAGES = sorted(GERMAN.rglob("*.md"))
SENTENCES = json.loads((ROOT / "src/construction_twin/core/sentences.json").read_text())
MARK = re.compile(r'<a id="([^"]+)"></a> <!-- en (\w+) -->')
HEADING = re.compile(r"#{1,6} (.+)")
CODE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
#: How a page begins, below its title: a translation of the whole page, or of the sections with a mark.
WHOLE, PARTS = "*Deutsche Fassung von [", "*Auszug; alles Übrige steht auf Englisch in ["


def name(page: Path) -> str:
    return str(page.relative_to(GERMAN))


def anchor_of(heading: str) -> str:
    return re.sub(r"[^\w -]", "", heading).lower().replace(" ", "-")


def sections(page: Path) -> dict[str, str]:
    """Return the sections of a page by anchor: a heading and what is below it, up to the next one, without generated tables."""
    text = re.sub(r"^<!-- generated: .*?^<!-- end of .*? -->\n", "", page.read_text(), flags=re.MULTILINE | re.DOTALL)
    found: dict[str, str] = {}
    anchor, in_code = "", False
    for line in text.splitlines():
        in_code ^= line.startswith("```")
        heading = None if in_code else HEADING.fullmatch(line)
        if heading:
            anchor = anchor_of(heading[1])
            assert anchor not in found, f"{page}: two headings have the anchor {anchor}"
            found[anchor] = ""
        if anchor:
            found[anchor] += f"{line}\n"
    return found


def translated(page: Path) -> dict[str, tuple[str, str]]:
    """Return the sections of a German page that have a mark: hash and text by anchor."""
    found: dict[str, tuple[str, str]] = {}
    for part in re.split(r"^(?=<a id=)", page.read_text(), flags=re.MULTILINE):
        mark = MARK.match(part)
        if mark:
            assert mark[1] not in found, f"{page}: the anchor {mark[1]} stands there twice"
            found[mark[1]] = (mark[2], part)
    return found


def hash_of(section: str) -> str:
    """Return eight digits of a section's hash; where its lines break does not matter."""
    return hashlib.sha256(" ".join(section.split()).encode()).hexdigest()[:8]


def opening(page: Path) -> str:
    """Return the first paragraph below the title."""
    return re.search(r"^# [^\n]+\n\n(.+?)\n\n", page.read_text(), re.MULTILINE | re.DOTALL)[1]


def quotes(page: Path) -> list[str]:
    """Return the messages that headings quote."""
    headings = "\n".join(re.findall(r"^## (.*)$", page.read_text(), re.MULTILINE))
    return [quote.strip() for quote in re.findall(r"`([^`]+)`", headings)]


@pytest.mark.parametrize("place", sorted({urgency.page for urgency in TABLE.values()}))
def test_every_place_that_a_line_names_is_there_in_german(place):
    page, _, anchor = place.partition("#")
    assert (GERMAN / page).is_file(), f"write docs/de/{page}"
    assert not anchor or anchor in translated(GERMAN / page), f"docs/de/{page} has no section {anchor}"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_a_german_page_begins_with_a_link_to_its_original(page):
    assert (DOCS / name(page)).is_file(), f"docs/{name(page)} is gone: remove docs/de/{name(page)}, or move it along"
    first = opening(page)
    assert first.startswith((WHOLE, PARTS))
    target = re.search(r"\]\(([^)]+)\)", first)[1]
    assert (page.parent / target).resolve() == DOCS / name(page)


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_what_a_german_page_translates_has_not_changed_in_english(page):
    english = sections(DOCS / name(page))
    for anchor, (known, _) in translated(page).items():
        assert anchor in english, (
            f"docs/{name(page)} has no section #{anchor} any more: "
            f"give the section in docs/de/{name(page)} the anchor that it has now"
        )
        present = hash_of(english[anchor])
        assert known == present, (
            f"docs/{name(page)}#{anchor} has changed since it was translated: let docs/de/{name(page)} say the same, "
            f"then write <!-- en {present} --> beside its anchor there"
        )


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_a_page_that_says_it_is_a_translation_has_every_section(page):
    """In the order of the original; no section stands there without its mark, but for the title of a page that has parts only."""
    english, german = list(sections(DOCS / name(page))), list(translated(page))
    assert german == [anchor for anchor in english if anchor in german]
    headings = re.findall(r"^#{1,6} .+$", CODE.sub("", page.read_text()), re.MULTILINE)
    if opening(page).startswith(WHOLE):
        assert german == english
        assert len(headings) == len(german)
    else:
        assert german
        assert len(headings) == len(german) + 1


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_commands_and_what_they_print_are_those_of_the_original(page):
    english = sections(DOCS / name(page))
    for anchor, (_, text) in translated(page).items():
        assert CODE.findall(text) == CODE.findall(english[anchor]), anchor


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_of_a_german_page_stay_in_german_where_they_can(page):
    text = page.read_text().replace(opening(page), "")
    for target, anchor in re.findall(r"\]\((?!https?:)([^)#\s]+\.md)(?:#([^)\s]+))?\)", text):
        path = (page.parent / target).resolve()
        german = GERMAN / path.relative_to(DOCS) if path.is_relative_to(DOCS) else path
        if path.is_relative_to(GERMAN):
            assert not anchor or anchor in translated(path), f"{target}#{anchor}"
        elif german.is_file():
            whole = opening(german).startswith(WHOLE)
            there = anchor in translated(german) if anchor else whole
            assert not there, f"{target}#{anchor} is there in German: docs/de/{name(german)}"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_lines_of_a_german_page_are_not_too_long(page):
    lines = CODE.sub("", page.read_text()).splitlines()
    assert [line for line in lines if len(line) > 132 and not line.startswith(("|", "#", "<a id="))] == []


def test_messages_in_the_german_troubleshooting_are_what_page_and_programs_say():
    """What stands in German is in the sentences; what is English the English page quotes too, whose test looks it up."""
    german = "\n".join(words["de"] for words in SENTENCES.values())
    english = quotes(DOCS / "troubleshooting.md")
    found = quotes(GERMAN / "troubleshooting.md")
    assert [quote for quote in english if quote not in found] == []
    assert [quote for quote in found if quote not in english and quote not in german] == []
    assert len(set(found) - set(english)) > 50


def test_what_is_not_checked_with_a_bare_plc_is_said_as_elsewhere():
    text = (GERMAN / "broker.md").read_text()
    said = [words["de"] for key, words in SENTENCES.items() if key.startswith("link.not_checked.")]
    assert len(said) > 5
    assert [sentence for sentence in said if f"| {sentence} |" not in text] == []


def test_a_change_of_the_english_is_noticed_and_where_its_lines_break_is_not(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "# A\n\none two\n```\n# no heading\n```\n## B `c`\nthree\n<!-- generated: x -->\nrow\n<!-- end of x -->\n"
    )
    before = sections(page)
    assert list(before) == ["a", "b-c"] and "row" not in before["b-c"]
    page.write_text(page.read_text().replace("one two", "one\ntwo").replace("row", "other"))
    assert {anchor: hash_of(text) for anchor, text in sections(page).items()} == {
        anchor: hash_of(text) for anchor, text in before.items()
    }
    page.write_text(page.read_text().replace("three", "four"))
    after = sections(page)
    assert hash_of(after["a"]) == hash_of(before["a"]) and hash_of(after["b-c"]) != hash_of(before["b-c"])

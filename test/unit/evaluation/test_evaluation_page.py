"""The report's page: valid, complete, self-contained, and nothing of a recording gets into its markup."""

from __future__ import annotations

import base64
import dataclasses
from html.parser import HTMLParser

import pytest
from evaluation_samples import BASE, link, run

from construction_twin.evaluation.alignment import evaluate
from construction_twin.evaluation.recording import StateChange
from construction_twin.evaluation.report import MOST_CHANGES, page
from construction_twin.evaluation.tables import ALIGNMENTS, ARM_UNKNOWN, summarise

PNG = b"\x89PNG not a real picture"
EVIL = "\"><script>alert(1)</script><b a='&"
VOID = {"meta", "img", "br", "link"}


class Reader(HTMLParser):
    """Reads a page; fails when its elements are not closed in order."""

    def __init__(self, text: str):
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.tags: list[tuple[str, dict]] = []
        self.rows: list[list[str]] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)
        if self.open and self.open[-1] in ("td", "th"):
            self.rows[-1].append(data)

    @property
    def text(self) -> str:
        return " ".join(self.words)


def changed(recording, *changes: StateChange):
    return dataclasses.replace(recording, changes=changes)


def summary_of(recording) -> dict:
    return {**summarise(evaluate(recording)), "environment": {"python": "3"}}


@pytest.fixture(scope="module")
def full():
    links = [link(0.5, 100), link(12.5, 3300, lost=3, late=5, counts=(30, 20, 5, 1))]
    recording = run(links=links, mock={"config": {"servo": "ideal"}, "counters": {}})
    recording = changed(
        recording,
        StateChange(BASE + 10**9, "gate", "IN_SYNC", "the poses agree"),
        StateChange(BASE + 3 * 10**9, "gate", "HOLDING", "joint_a3 differs by 2 deg"),
    )
    summary = summary_of(recording)
    return summary, Reader(page(summary, recording, {"figure8.png": PNG, "figure9.png": PNG}))


def test_page_needs_no_other_file(full):
    _, reader = full
    assert {tag for tag, _ in reader.tags}.isdisjoint({"script", "link", "iframe"})
    sources = [attributes["src"] for tag, attributes in reader.tags if tag == "img"]
    assert len(sources) == 2
    for source in sources:
        assert base64.b64decode(source.removeprefix("data:image/png;base64,")) == PNG


def test_page_holds_tables_timing_and_what_happened(full):
    summary, reader = full
    for alignment in ALIGNMENTS:
        assert f"{alignment}: " in reader.text
    worst = summary["tables"]["instant"]["joint_a6"]["max_rad"]
    assert any(row[0] == "joint_a6" and row[2] == f"{worst:.4e} rad" for row in reader.rows if row)
    assert ["round trip, ms", "23.000", "23.000", "23.000", "23.000"] in reader.rows
    assert ["commands lost", "3"] in reader.rows
    assert ["p1", "1.000", "10.000", "finished"] in reader.rows
    assert ["3.000", "gate", "HOLDING", "joint_a3 differs by 2 deg"] in reader.rows
    assert "2 changes of state, 1 of them faults" in reader.text
    assert "This is a simulation" in reader.text


def test_page_of_a_recording_that_does_not_tell_the_arm_says_so():
    recording = run()
    assert ARM_UNKNOWN in Reader(page(summary_of(recording), recording, {})).text


def test_page_of_a_recording_that_tells_little():
    recording = run(plans=False, feedback=False)
    reader = Reader(page(summary_of(recording), recording, {}))
    assert "by_command: not available" in reader.text
    assert ["round trip, ms", *["unknown"] * 4] in reader.rows
    assert reader.text.count("None was recorded.") == 2


def test_nothing_of_a_recording_is_taken_for_markup():
    recording = run()
    plans = tuple(dataclasses.replace(plan, plan_id=EVIL, outcome=EVIL) for plan in recording.plans)
    recording = changed(
        dataclasses.replace(recording, robot=f"/{EVIL}", plans=plans), StateChange(BASE, EVIL, EVIL, EVIL)
    )
    summary = {**summary_of(recording), "servo": EVIL, "mock": {"x": EVIL}}
    text = page(summary, recording, {EVIL: PNG})
    assert "<script" not in text and "<b " not in text
    reader = Reader(text)
    assert any(row[1:] == [EVIL] * 3 for row in reader.rows)
    assert [attributes["alt"] for tag, attributes in reader.tags if tag == "img"] == [EVIL]


def test_a_restless_recording_stays_readable():
    recording = run()
    changes = [StateChange(BASE + number, "gate", "STALE", "") for number in range(MOST_CHANGES + 5)]
    reader = Reader(page(summary_of(recording), changed(recording, *changes), {}))
    assert sum(row[1:2] == ["gate"] for row in reader.rows) == MOST_CHANGES
    assert f"The first {MOST_CHANGES} are shown." in reader.text

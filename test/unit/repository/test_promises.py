"""docs/promises.md: each quote stands in its document, each test that it names exists, and each law has its rows."""

from __future__ import annotations

import ast
import math
import re
from pathlib import Path

import pytest
import touched
import yaml

from construction_twin.controller.last_resort import LONGEST_GAP_MS
from construction_twin.core.freshness import LIFETIME
from construction_twin.core.units import NANOSECONDS
from construction_twin.execution.boundary import FIRE_TIMEOUT, LEAD, SCENE_TIMEOUT
from construction_twin.execution.segment_run import RECORD_TIMEOUT
from construction_twin.link.observations import STATUS_TIMEOUT
from construction_twin.review.record import KEPT
from construction_twin.robot.executed_path import WAY_BACK_TOLERANCE

ROOT = Path(__file__).resolve().parents[3]
PAGE = ROOT / "docs/promises.md"


def plain(text: str) -> str:
    """Return a text without the marks of Markdown and with single spaces."""
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return " ".join(re.sub(r"[`*]", "", text).split())


def rows() -> list[tuple[str, Path, str, str]]:
    """Return (section, document, quote, tests) of each row."""
    found = []
    for section in PAGE.read_text().split("\n## ")[1:]:
        title, _, body = section.partition("\n")
        document = re.search(r"^From \[[^\]]*\]\(([^)]*)\)\.$", body, re.MULTILINE)
        if document is None:
            continue
        for quote, tests in re.findall(r"^\| (?!promise )(.+) \| (`.+`) \|$", body, re.MULTILINE):
            found.append((title, (PAGE.parent / document[1]).resolve(), quote, tests))
    return found


ROWS = rows()
NAMED = sorted({name for *_, tests in ROWS for name in re.findall(r"`([^`]+)`", tests)})


def nameable(file: Path) -> set[str]:
    """Return what can be named in a file of tests: functions, classes that hold some, and their methods."""
    names = set()
    for node in ast.parse(file.read_text()).body:
        if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            inside = {each.name for each in node.body if isinstance(each, ast.FunctionDef)}
            methods = {f"{node.name}::{name}" for name in inside if name.startswith("test_")}
            names |= methods | ({node.name} if methods else set())
    return names


def test_the_page_is_read():
    assert len(ROWS) > 100 and len(NAMED) > 150
    assert {path.name for _, path, *_ in ROWS} >= {"README.md", "architecture.md", "states.md", "mqtt.md"}
    lines = [line for line in PAGE.read_text().split("## Held by")[0].splitlines() if line.startswith("| ")]
    assert len(ROWS) == sum(line != "| promise | tests |" for line in lines), "a row that is not read is not checked"


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row[2][:40])
def test_a_promise_stands_in_its_document_in_these_words(row):
    _, document, quote, _ = row
    text = plain(document.read_text())
    missing = [part for part in plain(quote.replace("\\|", "|")).split(" ... ") if part not in text]
    assert missing == [], f"not in {document.name}"


@pytest.mark.parametrize("name", NAMED)
def test_a_test_that_keeps_a_promise_exists_and_is_run(name):
    path, _, inside = name.partition("::")
    file = ROOT / "test" / path
    assert file.is_file(), path
    assert inside in nameable(file), f"{path} has no {inside}"
    if file.parent.name == "integration":
        started = {name for each in file.parent.glob("*.test") for name in touched.started_by(each.read_text())}
        assert file.name in started, f"no rostest starts {file.name}"


@pytest.mark.parametrize("law", range(1, 9))
def test_every_law_has_its_rows(law):
    assert [quote for title, _, quote, _ in ROWS if title.startswith(f"Law {law}: ")]
    assert re.search(rf"^{law}\. \*\*", (ROOT / "docs/architecture.md").read_text(), re.MULTILINE)


def test_every_law_of_the_architecture_is_on_the_page():
    laws = (ROOT / "docs/architecture.md").read_text().split("\n## Laws\n")[1]
    assert re.findall(r"^(\d+)\. \*\*", laws, re.MULTILINE) == [str(number) for number in range(1, 9)]


@pytest.mark.parametrize(
    "document, words, value, expected",
    [
        ("architecture", "after a gap of more than 40 ms in IPOC", LONGEST_GAP_MS, 40),
        ("architecture", "An approval starts motion within 3 s", LIFETIME, 3 * NANOSECONDS),
        ("architecture", "for the setpoint 0.15 s ahead", LEAD, 0.15 * NANOSECONDS),
        ("architecture", "3 s until it is reported as fired", FIRE_TIMEOUT, 3 * NANOSECONDS),
        ("architecture", "| 30 s: whoever changes it", SCENE_TIMEOUT, 30 * NANOSECONDS),
        ("architecture", "that file is gone | 10 s |", RECORD_TIMEOUT, 10 * NANOSECONDS),
        ("architecture", "within 2e-4 rad or m", WAY_BACK_TOLERANCE, 2e-4),
        ("planning", "at most 1000 other records", KEPT, 1000),
        ("reference/states", "Statuses of more than one run within 3 s", STATUS_TIMEOUT, 3 * NANOSECONDS),
    ],
)
def test_figures_of_the_documents_are_those_of_the_code(document, words, value, expected):
    """Tests that take a figure from the code keep a promise whatever the figure is; here it is the document's."""
    assert words in plain((ROOT / f"docs/{document}.md").read_text())
    # setpoints lie on a grid of 4 ms
    assert value == pytest.approx(expected, rel=0.015)


def test_the_start_tolerance_that_is_shipped_is_the_architecture_s():
    shipped = yaml.safe_load((ROOT / "config/gateway.yaml").read_text())
    assert "start_tolerance (default 0.05 deg per joint)" in plain((ROOT / "docs/architecture.md").read_text())
    assert math.degrees(shipped["start_tolerance"]) == pytest.approx(0.05)

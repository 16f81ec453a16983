"""Ledgers that commit 4beb2eb wrote (`make_ledgers.py` there) leave the states that they left in that commit, line by line."""

from __future__ import annotations

import json
import shutil
from dataclasses import asdict
from itertools import count
from pathlib import Path

import pytest

from construction_twin.review.chained_file import verify
from construction_twin.work.book import fold
from construction_twin.work.ledger import Ledger, read_entries
from construction_twin.work.task_states import TaskState

OLD = Path(__file__).parents[2] / "data/written_by_4beb2eb/ledgers"
AFTER = {"plate": (), "stud": ("plate",), "board": ("plate", "stud")}
LEDGERS = ("full", "interrupted", "people")


def known(memory) -> dict:
    said = {**asdict(memory), "state": memory.state.value, "before": memory.before.value}
    return {name: list(value) if isinstance(value, tuple) else value for name, value in said.items()}


def of_then(memory) -> dict:
    """Return what is known of a task, without the fields that came since: all but the element are empty for every line of then."""
    said = known(memory)
    del said["element"]
    for name in ("process", "name", "ifc_class", "body", "goal", "source"):
        assert not said.pop(name)
    return said


def whole_lines(name: str, folder: Path) -> Path:
    content = (OLD / f"{name}.jsonl").read_bytes()
    path = folder / "ledger.jsonl"
    path.write_bytes(content[: content.rfind(b"\n") + 1])
    return path


@pytest.mark.parametrize("name", LEDGERS)
@pytest.mark.parametrize("schedule", [0, 1], ids=["its schedule", "another one"])
def test_every_line_leaves_what_it_left_then(tmp_path, name, schedule):
    case = json.loads((OLD / f"{name}_states.json").read_text())[schedule]
    book, lines = fold(case["after"]), list(read_entries(whole_lines(name, tmp_path)))
    assert len(lines) == len(case["lines"])
    for entry, expected in zip(lines, case["lines"]):
        book = book.then(entry)
        tasks = {task if task in book.after else f"former {task}": memory for task, memory in book.tasks.items()}
        assert {task: of_then(memory) for task, memory in tasks.items()} == expected["tasks"]
        assert (book.accepted, book.model, book.cell) == tuple(expected[key] for key in ("accepted", "model", "cell"))


@pytest.mark.parametrize("name", LEDGERS)
def test_it_is_written_on(tmp_path, name):
    path = tmp_path / "whole.jsonl"
    shutil.copy(OLD / f"{name}.jsonl", path)
    times = count(1_800_000_000_000_000_000)
    before = list(read_entries(whole_lines(name, tmp_path)))
    model = [entry.model for entry in before if entry.model][-1]
    ledger = Ledger(path, AFTER, model, lambda: next(times), "/cell.yaml", {"E1": "plate"})
    torn = name == "interrupted"
    assert ledger.lines == len(before) + torn and verify(path).lines == ledger.lines
    assert [entry.event for entry in read_entries(path)][len(before) :] == ["mended"] * torn
    if torn:
        assert ledger.book.tasks["stud"].state is TaskState.WORKING
    ledger.close()

"""The append-only file: what was reported as written is on the disk, and what was not is not in the file."""

from __future__ import annotations

import errno
import json
import os
from pathlib import Path

import pytest
from memory import size

from construction_twin.core.append_only import MAX_DEFERRED, AppendOnlyFile, read_lines
from construction_twin.core.errors import ConfigurationError, RecordError

NOW = 1_790_000_000_123_456_789


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "deep" / "file.jsonl"


@pytest.fixture
def file(path):
    file = AppendOnlyFile(path, RecordError, "executor")
    yield file
    file.close()


def names(path: Path) -> list[str]:
    return [line["name"] for line in read_lines(path)]


def full(*_):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_line_holds_the_time_and_what_it_was_given(file, path):
    file.append(NOW, {"name": "line\nbreak \u2028 Grüße"})
    (line,) = path.read_text().splitlines()
    assert json.loads(line) == {
        "time": "2026-09-21T14:13:20.123456789Z",
        "time_ns": NOW,
        "name": "line\nbreak \u2028 Grüße",
    }


def test_a_line_is_synced_before_append_returns(file, path, monkeypatch):
    synced = []
    sync = os.fsync
    monkeypatch.setattr(os, "fsync", lambda file: (sync(file), synced.append(path.read_bytes())))
    file.append(NOW, {"name": "a"})
    assert synced == [path.read_bytes()] and names(path) == ["a"]


def test_goes_on_behind_what_is_there(path):
    for number in range(3):
        file = AppendOnlyFile(path, RecordError, "executor")
        file.append(NOW, {"name": str(number)})
        assert (file.lines, file.cut_off) == (number + 1, 0)
        file.close()
    assert names(path) == ["0", "1", "2"]


def test_a_last_line_without_its_end_is_cut_off_wherever_it_was_torn(path):
    path.parent.mkdir()
    whole, torn = b'{"name": "whole"}\n', b'{"name": "torn"}'
    for length in range(len(torn) + 1):
        path.write_bytes(whole + torn[:length])
        assert names(path) == ["whole"], "what has no end was not reported as written"
        file = AppendOnlyFile(path, RecordError, "executor")
        assert (file.cut_off, file.lines) == (length, 1)
        assert path.read_bytes() == whole
        file.append(NOW, {"name": "later"})
        file.close()
        assert names(path) == ["whole", "later"]


@pytest.mark.parametrize("call", ["write", "fsync"])
def test_what_could_not_be_written_is_taken_back_and_can_be_written_later(file, path, monkeypatch, call):
    file.append(NOW, {"name": "a"})
    with monkeypatch.context() as patch:
        patch.setattr(os, call, full)
        with pytest.raises(
            RecordError, match=r": \[Errno 28\] No space left on device; nothing is approved without a record, mend"
        ):
            file.append(NOW, {"name": "lost"})
    assert names(path) == ["a"]
    file.append(NOW, {"name": "kept"})
    assert names(path) == ["a", "kept"]


def test_half_a_line_is_taken_back(file, path, monkeypatch):
    write = os.write
    monkeypatch.setattr(os, "write", lambda file, data: write(file, data[: len(data) // 2]))
    with pytest.raises(RecordError, match="bytes could be written"):
        file.append(NOW, {"name": "a"})
    assert path.read_bytes() == b""


@pytest.mark.parametrize(
    "change, problem",
    [
        (lambda path: path.unlink(), "the file is gone"),
        (lambda path: path.rename(path.with_name("moved")), "the file is gone"),
        (lambda path: (path.unlink(), path.write_text("")), "the file was replaced"),
    ],
    ids=["removed", "moved", "replaced"],
)
def test_a_file_that_is_there_no_more_takes_no_line(file, path, change, problem):
    change(path)
    with pytest.raises(RecordError, match=problem):
        file.append(NOW, {"name": "a"})


def test_deferred_lines_come_first_with_the_time_they_were_deferred_at(file, path):
    file.defer(1, {"name": "first"})
    assert path.read_bytes() == b""
    file.append(2, {"name": "next"})
    file.defer(3, {"name": "last"})
    file.flush()
    assert [(line["time_ns"], line["name"]) for line in read_lines(path)] == [(1, "first"), (2, "next"), (3, "last")]


def test_while_the_disk_refuses_a_bounded_number_is_kept_and_how_many_are_missing_is_written_later(
    file, path, monkeypatch
):
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", full)
        for number in range(MAX_DEFERRED + 7):
            if number == MAX_DEFERRED:
                held = size(file)
            file.defer(number, {"name": str(number)})
        assert size(file) < held + 7 and file.lost == 7
        for _ in range(2):
            with pytest.raises(RecordError, match="; nothing is approved without a record, mend it and approve again"):
                file.append(NOW, {"name": "approval"})
    assert path.read_bytes() == b""
    file.append(NOW, {"name": "next"})
    *kept, gap, following = read_lines(path)
    assert [line["name"] for line in kept] == [str(number) for number in range(MAX_DEFERRED)]
    assert (gap["record"], gap["lost"], following["name"]) == ("gap", 7, "next")


def test_another_writer_is_refused(file, path):
    with pytest.raises(ConfigurationError, match="a file that no other executor writes"):
        AppendOnlyFile(path, RecordError, "executor")


def test_a_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigurationError, match="a file that can be written"):
        AppendOnlyFile(tmp_path / "file" / "file.jsonl", RecordError, "executor")


def test_the_home_folder_can_be_written_as_a_tilde(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    AppendOnlyFile("~/file.jsonl", RecordError, "executor").close()
    assert (tmp_path / "file.jsonl").exists()


@pytest.mark.parametrize("strange", ["hello", "[1]", "", "1"])
def test_a_line_that_is_no_object_is_named(path, strange):
    path.parent.mkdir()
    path.write_text(f'{{"name": "a"}}\n{strange}\n')
    with pytest.raises(ConfigurationError, match=r"a JSON object \(") as error:
        read_lines(path)
    assert error.value.where == f"{path} line 2"


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigurationError, match="nowhere"):
        read_lines(tmp_path / "nowhere")

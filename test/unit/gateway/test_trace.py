"""The record of what the gateway sent."""

from __future__ import annotations

import errno
import math
import os
import subprocess
import sys

import pytest
from gateway_cell import START, following

from construction_twin.core.errors import ConfigurationError
from construction_twin.gateway.gateway import State
from construction_twin.gateway.trace import TraceEntry, TraceWriter, read_trace


def test_it_holds_what_was_answered_cycle_by_cycle(tmp_path):
    path = str(tmp_path / "trace")
    cell = following()
    writer = TraceWriter(path, 2)
    cell.gateway.trace = writer.record
    replies = [cell.cycle() for _ in range(200)]
    writer.close()
    entries = read_trace(path)
    assert [entry.ipoc for entry in entries] == list(range(cell.ipoc - 4 * 199, cell.ipoc + 1, 4))
    assert [tuple(q - start for q, start in zip(entry.position, START)) for entry in entries] == replies
    assert {entry.state for entry in entries} == {State.FOLLOWING, State.BRAKING, State.HOLDING}
    assert {entry.session for entry in entries} == {1}
    assert entries[0].stamp > 0 and entries[-1].stamp == 0


def test_a_full_one_keeps_what_it_has(tmp_path):
    path = str(tmp_path / "trace")
    writer = TraceWriter(path, 1, cycles=3)
    for k in range(5):
        writer.record(k, 70_000, State.READY, 0, (math.pi,))
    writer.close()
    assert read_trace(path) == [TraceEntry(k, 0, State.READY, 70_000 & 0xFFFF, (math.pi,)) for k in range(3)]


def test_what_was_recorded_survives_a_killed_process(tmp_path):
    path = str(tmp_path / "trace")
    code = (
        "import os, signal, sys\n"
        "from construction_twin.gateway.states import State\n"
        "from construction_twin.gateway.trace import TraceWriter\n"
        "writer = TraceWriter(sys.argv[1], 2)\n"
        "for k in range(100):\n"
        "    writer.record(4 * k, 1, State.FOLLOWING, 7, (0.1 * k, -1.0))\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    assert subprocess.run([sys.executable, "-c", code, path]).returncode == -9
    entries = read_trace(path)
    assert len(entries) == 100
    assert entries[99] == TraceEntry(396, 7, State.FOLLOWING, 1, (0.1 * 99, -1.0))


@pytest.mark.parametrize("content", [b"", b"rsi", b"something else entirely"])
def test_what_is_no_trace_is_refused(tmp_path, content):
    path = tmp_path / "trace"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError):
        read_trace(str(path))


@pytest.mark.parametrize("place", ["missing/trace", ".", "pipe"])
def test_a_file_that_cannot_be_written_or_is_none_is_refused_by_name_and_stays(tmp_path, place):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ConfigurationError, match="--trace"):
        TraceWriter(str(tmp_path / place), 1)
    assert os.listdir(tmp_path) == ["pipe"]


def test_a_disk_without_room_for_the_whole_trace_is_refused_and_nothing_is_left(tmp_path, monkeypatch):
    def no_room(*_given):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", no_room)
    with pytest.raises(ConfigurationError, match=r"MB of room, reserved at the start \(No space left on device\)"):
        TraceWriter(str(tmp_path / "trace"), 1)
    assert os.listdir(tmp_path) == []


def test_another_gateway_with_the_same_path_takes_nothing_from_the_first(tmp_path):
    """It would take the blocks of the file in which the first one records, which would end that one by SIGBUS."""
    path = tmp_path / "trace"
    first = TraceWriter(str(path), 1)
    first.record(4, 1, State.FOLLOWING, 7, (0.1,))
    os.link(path, tmp_path / "first")
    TraceWriter(str(path), 1).close()
    first.record(8, 1, State.FOLLOWING, 7, (0.1,))
    first.close()
    assert [entry.ipoc for entry in read_trace(tmp_path / "first")] == [4, 8] and read_trace(path) == []


def test_all_of_its_blocks_are_there_before_the_first_cycle(tmp_path):
    writer = TraceWriter(str(tmp_path / "trace"), 6, cycles=50_000)
    status = os.stat(tmp_path / "trace")
    assert status.st_blocks * 512 >= status.st_size > 50_000 * 72
    writer.close()
    assert os.stat(tmp_path / "trace").st_size < 100

"""The benchmark of a start: what it asks of Linux, and its medians."""

from __future__ import annotations

import importlib
import mmap
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parents[3] / "benchmarks"


@pytest.fixture
def start(monkeypatch):
    """Return the benchmark as a module."""
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module("start")


def test_medians_are_of_each_figure_and_of_what_some_rounds_lack(start):
    rows = [{"s": 1.0, "of": {"a": 1.0}}, {"s": 9.0, "of": {"a": 3.0, "b": 7.0}}, {"s": 2.0, "of": {"a": 2.0}}]
    assert start.median_of(rows) == {"s": 2.0, "of": {"a": 2.0, "b": 7.0}}


def test_shared_memory_counts_once(start):
    size = 64 << 20
    with mmap.mmap(-1, size) as shared:
        shared.write(b"\1" * size)
        alone = start.pss_mb(os.getpid())
        child = os.fork()
        if not child:
            shared[:: mmap.PAGESIZE]  # what a process has not read is not its own
            os.kill(os.getpid(), signal.SIGSTOP)
            os._exit(0)
        try:
            os.waitpid(child, os.WUNTRACED)
            both = start.pss_mb(os.getpid()) + start.pss_mb(child)
        finally:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
    assert alone > size / 1e6
    assert both < 2 * alone - 0.5 * size / 1e6


def test_a_process_that_has_ended_has_no_memory_and_no_name(start):
    ended = subprocess.Popen(["true"])
    ended.wait()
    assert start.pss_mb(ended.pid) is None
    assert start.name_of(ended.pid) == "ended"


@pytest.mark.parametrize(
    ("command", "name"),
    [(["sleep", "60"], "sleep"), ([sys.executable, "-m", "http.server", "--bind", "127.0.0.1", "0"], "http.server")],
)
def test_a_program_has_the_name_of_its_file_or_module(start, command, name):
    link_world = importlib.import_module("link_world")
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            # while it becomes that program it has no command line
            link_world.wait_for(Path(f"/proc/{process.pid}/cmdline").read_text, 10.0, "a program")
            assert start.name_of(process.pid) == name
        finally:
            process.kill()


def test_a_command_that_ends_otherwise_is_not_measured(start):
    times = start.seconds_of(["bash", "-c", "exit 2"], 3, code=2)
    assert all(value >= 0.0 for value in times)
    with pytest.raises(SystemExit, match="ended with 2, not 0"):
        start.seconds_of(["bash", "-c", "exit 2"], 1)


def test_the_measured_shell_is_not_the_one_of_the_benchmark(start, monkeypatch):
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    monkeypatch.setenv("PYTHONPATH", "/elsewhere")
    assert not {"PYTHONDONTWRITEBYTECODE", "PYTHONPATH"} & set(start.shell())

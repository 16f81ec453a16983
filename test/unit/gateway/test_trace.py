"""The record of what the gateway sent."""

from __future__ import annotations

import errno
import math
import os
import shutil
import socket
import stat
import subprocess
import sys

import pytest
from gateway_cell import CONFIG, START, following
from sentence_checks import expects

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.udp import bind
from construction_twin.gateway.command_line import main
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
    assert (read_trace(path, 150), read_trace(path, 200)) == (entries[150:], [])
    assert entries[0].stamp > 0 and entries[-1].stamp == 0


def test_a_full_one_counts_what_it_leaves_out(tmp_path):
    path = str(tmp_path / "trace")
    writer = TraceWriter(path, 1, cycles=3)
    for k in range(5):
        writer.record(k, 70_000, State.READY, 0, (math.pi,))
    writer.close()
    assert writer.dropped == 2
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


@pytest.mark.parametrize("content", [b"", b"rsi", b"something else entirely", b"rsitrace1\n\x02\x00\x07\x00\x00\x00"])
def test_what_is_no_trace_is_refused(tmp_path, content):
    path = tmp_path / "trace"
    path.write_bytes(content)
    with pytest.raises(ConfigurationError):
        read_trace(str(path))


def test_a_file_that_cannot_be_written_is_refused_by_name(tmp_path):
    with pytest.raises(ConfigurationError, match="--trace"):
        TraceWriter(str(tmp_path / "missing" / "trace"), 1)


def _make_pipe(path):
    os.mkfifo(path)


def _make_folder(path):
    os.mkdir(path)


def _make_socket(path):
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))


def _make_device(path):
    if os.geteuid() != 0:
        pytest.skip("a device is made, which needs root")
    # the numbers of /dev/null
    os.mknod(path, 0o666 | stat.S_IFCHR, os.makedev(1, 3))


@pytest.mark.parametrize("linked", [False, True])
@pytest.mark.parametrize("make", [_make_device, _make_pipe, _make_folder, _make_socket])
def test_what_is_no_regular_file_is_refused_unopened_and_stays(tmp_path, monkeypatch, make, linked):
    there, link = tmp_path / "there", tmp_path / "link"
    make(there)
    link.symlink_to(there)
    before = os.lstat(there)
    monkeypatch.setattr("builtins.open", lambda *given, **named: pytest.fail(f"opened: {given}"))
    with pytest.raises(ConfigurationError, check=expects("expected.trace.regular", "--trace")):
        TraceWriter(str(link if linked else there), 1)
    after = os.lstat(there)
    assert (after.st_mode, after.st_ino, after.st_rdev) == (before.st_mode, before.st_ino, before.st_rdev)
    assert link.is_symlink()


@pytest.mark.parametrize("existed", [False, True])
@pytest.mark.parametrize("linked", [False, True])
def test_a_refused_start_removes_only_the_file_that_it_made(tmp_path, monkeypatch, existed, linked):
    there, link = tmp_path / "there", tmp_path / "link"
    link.symlink_to(there)
    if existed:
        there.write_bytes(b"of an earlier run")

    def no_room(*_given):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", no_room)
    with pytest.raises(ConfigurationError, check=expects("expected.trace.room", problem="No space left on device")):
        TraceWriter(str(link if linked else there), 1)
    assert link.is_symlink() and there.exists() is existed
    if existed:
        assert there.stat().st_size == 0


#: Takes a folder, a number of cycles and a command: records that many cycles in the folder, after the command.
_RECORDS = (
    "import sys\n"
    "from construction_twin.core.errors import ConfigurationError\n"
    "from construction_twin.gateway.states import State\n"
    "from construction_twin.gateway.trace import TraceWriter\n"
    "cycles = int(sys.argv[2])\n"
    "exec(sys.argv[3])\n"
    "try:\n"
    "    writer = TraceWriter(sys.argv[1] + '/trace', 6, cycles)\n"
    "except ConfigurationError as error:\n"
    "    sys.exit(f'refused: {error}')\n"
    "exec(sys.argv[4])\n"
    "for k in range(cycles):\n"
    "    writer.record(4 * k, 1, State.FOLLOWING, 7, (0.1,) * 6)\n"
    "writer.close()\n"
    "print('recorded', writer.dropped)\n"
)


def on_a_small_disk(folder, size, cycles, before="", between=""):
    """Return what a process does that records on a disk of `size`, in a mount namespace of its own."""
    command = f'mount -t tmpfs -o size={size} tmpfs "$1" && exec "$2" -c "$3" "$1" {cycles} "$4" "$5"; exit 3'
    arguments = [str(folder), sys.executable, _RECORDS, before, between]
    return subprocess.run(
        ["unshare", "--mount", "sh", "-c", command, "sh", *arguments], capture_output=True, text=True, timeout=60
    )


needs_a_disk = pytest.mark.skipif(
    os.geteuid() != 0 or shutil.which("unshare") is None, reason="a small disk is mounted, which needs root"
)


@needs_a_disk
def test_a_disk_without_room_for_the_whole_trace_is_refused_at_the_start_and_left_as_it_was(tmp_path):
    left = "import atexit, os; atexit.register(lambda: print(os.listdir(sys.argv[1])))"
    done = on_a_small_disk(tmp_path, "1m", 100_000, before=left)
    assert done.returncode == 1, done
    assert done.stderr.startswith("refused: --trace") and "7.2 MB" in done.stderr and "No space left" in done.stderr
    assert done.stdout.strip() == "[]"


@needs_a_disk
def test_a_disk_that_fills_up_meanwhile_takes_nothing_from_the_trace(tmp_path):
    fill = (
        "import os, errno\n"
        "file = os.open(sys.argv[1] + '/other', os.O_CREAT | os.O_WRONLY)\n"
        "try:\n"
        "    while True: os.write(file, bytes(4096))\n"
        "except OSError as error:\n"
        "    assert error.errno == errno.ENOSPC\n"
    )
    done = on_a_small_disk(tmp_path, "2m", 20_000, between=fill)
    assert (done.returncode, done.stdout.strip()) == (0, "recorded 0"), done


def test_a_limit_on_the_length_of_files_is_refused_at_the_start(tmp_path):
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (65536, 65536))"
    done = subprocess.run(
        [sys.executable, "-c", _RECORDS, str(tmp_path), "10000", limit, ""], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 1 and "refused: --trace" in done.stderr and "0.7 MB" in done.stderr, done
    assert os.listdir(tmp_path) == []


#: Takes a folder and what else happens to the file, and records before and after that.
_RECORDS_ON = (
    "import subprocess, sys\n"
    "from construction_twin.gateway.states import State\n"
    "from construction_twin.gateway.trace import TraceWriter\n"
    "writer = TraceWriter(sys.argv[1] + '/trace', 6, 1000)\n"
    "writer.record(4, 1, State.FOLLOWING, 7, (0.1,) * 6)\n"
    "print(subprocess.run([sys.executable, '-c', sys.argv[2], sys.argv[1]], capture_output=True, text=True).stderr)\n"
    "for k in range(2, 1000):\n"
    "    writer.record(4 * k, 1, State.FOLLOWING, 7, (0.1,) * 6)\n"
    "writer.close()\n"
)


@pytest.mark.parametrize("how", ["begins and ends", "is refused"])
def test_another_gateway_with_the_same_path_is_refused_and_takes_nothing_from_the_first(tmp_path, how):
    """It would take the blocks of the file in which the first one records, which would end that one by SIGBUS."""
    other = (
        "import os, sys\n"
        "from construction_twin.gateway.trace import TraceWriter\n"
        + ("def refuse(*_): raise OSError(28, 'full')\nos.posix_fallocate = refuse\n" if how == "is refused" else "")
        + "TraceWriter(sys.argv[1] + '/trace', 6, 1000).close()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", _RECORDS_ON, str(tmp_path), other], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0, done
    assert "another gateway records in it" in done.stdout
    assert [entry.ipoc for entry in read_trace(str(tmp_path / "trace"))] == list(range(4, 4000, 4))


def test_all_of_its_blocks_are_there_before_the_first_cycle(tmp_path):
    writer = TraceWriter(str(tmp_path / "trace"), 6, cycles=50_000)
    status = os.stat(tmp_path / "trace")
    assert status.st_blocks * 512 >= status.st_size > 50_000 * 72
    writer.close()
    assert os.stat(tmp_path / "trace").st_size < 100


def test_a_gateway_that_is_refused_for_another_reason_leaves_no_trace_behind(tmp_path, capsys):
    taken = bind("127.0.0.1", 0)
    (tmp_path / "gateway.json").write_text(CONFIG.to_json())
    port = taken.getsockname()[1]
    arguments = ["--config", str(tmp_path / "gateway.json"), "--listen", f"127.0.0.1:{port}"]
    assert main([*arguments, "--trace", str(tmp_path / "trace")]) == 2
    assert not (tmp_path / "trace").exists()
    taken.close()


@pytest.mark.parametrize("ipoc", [0, 2**63 - 4, 2**63, 2**64 - 1])
def test_every_ipoc_that_a_telegram_may_carry_is_recorded(tmp_path, ipoc):
    writer = TraceWriter(str(tmp_path / "trace"), 1)
    writer.record(ipoc, 1, State.READY, 0, (0.5,))
    writer.close()
    assert read_trace(str(tmp_path / "trace")) == [TraceEntry(ipoc, 0, State.READY, 1, (0.5,))]

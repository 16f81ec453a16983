"""How long a start takes, and what it takes when nothing moves; writes results/bench/start.json.

``python benchmarks/start.py`` (`make bench ARGS=start`) starts bringup.launch with the mock arm again and again, as a person does
from a shell. `ready_s` is from `roslaunch` to the line that says `ready`, `read_s` the part of it in which roslaunch reads the
launch files. `idle_cores` and `idle_mb` are of all that roslaunch started, itself and the master included, while the arm stands:
processor time per time, and memory in which what several processes share counts once (PSS). `programs` is each program's processor
time until it is ready, `idle` its cores at rest. `help_s` is `twin --help` without `rosrun`, which takes its own time.

Two commits in turns: ``python benchmarks/turns.py start 90a3d156``. In a folder without a workspace one is built first.
"""

from __future__ import annotations

import argparse
import ctypes
import os
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from link_world import ROOT, end_in_order, environment, free_port, write_figures

WORKSPACE = ROOT / ".ws"
#: What belongs to the shell that runs this, and not to the commit whose start is measured. Nobody's shell forbids byte code.
_OTHERS = ("PYTHONPATH", "CMAKE_PREFIX_PATH", "ROS_PACKAGE_PATH", "PYTHONDONTWRITEBYTECODE")
#: prctl(2), Linux.
_PR_SET_CHILD_SUBREAPER = 36
_LIBC = ctypes.CDLL(None)
#: Longest start [s].
PATIENCE = 120.0
#: Longest wait for what a launch left behind [s].
PATIENCE_AT_END = 10.0
#: After it said that it is ready, what still starts beside [s].
SETTLE = 5.0


def prepare() -> None:
    """Build the workspace of this folder, if it has none, with the packages of the interpreter that runs this."""
    if (WORKSPACE / "env.bash").exists():
        return
    WORKSPACE.mkdir(exist_ok=True)
    (WORKSPACE / "venv").symlink_to(sys.prefix)
    subprocess.run(["bash", ROOT / "setup" / "setup.sh"], check=True, env=shell())


def shell() -> dict[str, str]:
    """Return the environment of a person's shell before it has read `.ws/env.bash`."""
    return {name: value for name, value in os.environ.items() if name not in _OTHERS}


def in_workspace(*command: object) -> list[str]:
    """Return a command as a shell runs it that has read `.ws/env.bash`."""
    # catkin's script takes the words of whoever reads it for its own
    read_and_run = 'command=("$@"); set --; source "$0" && exec "${command[@]}"'
    return ["bash", "-c", read_and_run, str(WORKSPACE / "env.bash"), *map(str, command)]


class Launch:
    """One start, in a session of its own."""

    def __init__(self, folder: Path, words: Sequence[str]):
        master, self.broker_port = free_port(), free_port()
        #: For nodes beside it, too.
        self.ros = {"ROS_MASTER_URI": f"http://127.0.0.1:{master}", "ROS_IP": "127.0.0.1", "ROS_HOME": str(folder)}
        ports = (f"broker_port:={self.broker_port}", f"rsi_port:={free_port(socket.SOCK_DGRAM)}")
        command = in_workspace("roslaunch", "-p", master, ROOT / "launch" / "bringup.launch", *ports, *words)
        self._log = folder / "start.log"
        with self._log.open("wb") as log:
            self._began = time.monotonic()
            self._process = subprocess.Popen(
                command, stdout=log, stderr=log, env=shell() | self.ros, start_new_session=True, cwd=folder
            )

    def await_line(self, text: str) -> float:
        """Return when the launch said this [s since it began]; SystemExit if it ended, or did not."""
        while text not in (said := self._log.read_text(errors="replace")):
            passed = time.monotonic() - self._began
            if self._process.poll() is not None or passed > PATIENCE:
                raise SystemExit(f"no {text!r} after {passed:.0f} s:\n{said[-2000:]}")
            time.sleep(0.01)
        return time.monotonic() - self._began

    def used(self) -> dict[int, float]:
        """Return the processor time of each process of the launch [s]."""
        ticks = os.sysconf("SC_CLK_TCK")
        return {pid: sum(map(int, fields[11:13])) / ticks for pid, fields in self._family().items()}

    def memory(self) -> dict[str, float]:
        """Return the memory of each program of the launch [MB]."""
        found: Counter[str] = Counter()
        for pid in self._family():
            found[name_of(pid)] += pss_mb(pid)
        return found

    def end(self) -> None:
        """Interrupt it, as Ctrl-C does."""
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(30.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _family(self) -> dict[int, list[str]]:
        children: dict[int, list[int]] = {}
        fields = {}
        for entry in Path("/proc").iterdir():
            if entry.name.isdigit():
                try:
                    fields[int(entry.name)] = _stat(int(entry.name))
                except OSError:
                    continue  # it has ended meanwhile
                children.setdefault(int(fields[int(entry.name)][1]), []).append(int(entry.name))
        found, waiting = {}, list(children.get(os.getpid(), []))
        while waiting:
            pid = waiting.pop()
            found[pid] = fields[pid]
            waiting += children.get(pid, [])
        return found


def _stat(pid: int) -> list[str]:
    """Return what Linux tells of a process, from its state on: proc(5), field 3."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()


def pss_mb(pid: int) -> float:
    """Return a process's memory, of what it shares its part [MB]; 0 when it has ended."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0.0
    return next(int(line.split()[1]) for line in lines if line.startswith("Pss:")) * 1024 / 1e6


def name_of(pid: int) -> str:
    """Return the name of a process's program: of a Python program that of its file or module."""
    try:
        # a process that has given itself a title has one text instead of words
        words = Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ").split() or ["none"]
    except OSError:
        return "ended"
    if words[1:2] == ["-m"]:
        return words[2]
    python = "python" in Path(words[0]).name
    return Path(next((word for word in words[1:] if "/" in word), words[0]) if python else words[0]).name


@contextmanager
def launched(words: Sequence[str]) -> Iterator[Launch]:
    """Start bringup.launch; it has ended when the block has. What it leaves behind counts, too: it becomes this process's child."""
    _LIBC.prctl(_PR_SET_CHILD_SUBREAPER, 1)
    with tempfile.TemporaryDirectory() as folder:
        launch = Launch(Path(folder), words)
        try:
            yield launch
        finally:
            launch.end()
            # and what it left behind, which ends by itself; another child of this process may stay
            deadline = time.monotonic() + PATIENCE_AT_END
            with suppress(ChildProcessError):
                while time.monotonic() < deadline:
                    os.waitpid(-1, os.WNOHANG)
                    time.sleep(0.01)


def measure_start(words: Sequence[str], idle: float) -> dict:
    """Start once; return the figures of it."""
    with launched(words) as launch:
        read = launch.await_line("started roslaunch server")
        ready = launch.await_line("ready; plan with")
        used = launch.used()
        time.sleep(SETTLE)
        before, began = launch.used(), time.monotonic()
        time.sleep(idle)
        after, passed = launch.used(), time.monotonic() - began
        programs: Counter[str] = Counter()
        idles: Counter[str] = Counter()
        for pid in after:
            programs[name_of(pid)] += used.get(pid, 0.0)
            idles[name_of(pid)] += (after[pid] - before.get(pid, 0.0)) / passed
        return {
            "ready_s": ready,
            "read_s": read,
            "idle_cores": sum(idles.values()),
            "idle_mb": sum(launch.memory().values()),
            "programs": programs,
            "idle": idles,
        }


def median_of(rows: Sequence[dict]) -> dict:
    """Return the median of each figure; of names below one another, too."""
    columns = {name: [row[name] for row in rows if name in row] for row in rows for name in row}
    return {
        name: median_of(column) if isinstance(column[0], dict) else round(statistics.median(column), 3)
        for name, column in columns.items()
    }


def help_seconds() -> float:
    """Return how long `twin --help` takes [s]."""
    began = time.monotonic()
    command = in_workspace("python", ROOT / "nodes" / "twin", "--help")
    subprocess.run(command, stdout=subprocess.DEVNULL, env=shell(), check=True)
    return time.monotonic() - began


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=ROOT / "results/bench/start.json", help="[%(default)s]")
    parser.add_argument("--runs", type=int, default=5, help="starts [%(default)s]")
    parser.add_argument("--idle", type=float, default=10.0, help="how long it is watched at rest [s] [%(default)s]")
    parser.add_argument("words", nargs="*", help="launch arguments, as twin:=mujoco")
    options = parser.parse_args()
    if options.runs < 1 or not options.idle > 0.0:
        parser.error("expected at least one start, and a time above 0 s")
    end_in_order()
    prepare()
    with launched(options.words) as launch:
        launch.await_line("ready; plan with")  # what Python compiles at the first start of all is not measured
    rows = []
    for number in range(options.runs):
        rows.append(measure_start(options.words, options.idle))
        print(f"[start] {number + 1} of {options.runs}: {rows[-1]['ready_s']:.2f} s", flush=True)
    result = median_of(rows)
    result["help_s"] = round(statistics.median(help_seconds() for _ in range(9)), 3)
    write_figures(options.output, result | {"environment": environment()})


if __name__ == "__main__":
    main()

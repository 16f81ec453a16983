"""How long a start takes, and what it takes when nothing moves; writes results/bench/start.json.

``python benchmarks/start.py`` (`make bench ARGS=start`) starts bringup.launch with the mock arm again and again, as a person does
from a shell. `ready_s` is from `roslaunch` to the line that says `ready`, `read_s` the part of it in which roslaunch reads the
launch files; `start_cpu_s` is the processor time that went into it, `programs` whose. `idle_cores` and
`idle_mb` are of all that roslaunch started, itself and the master included, while the arm stands: processor time per time, and
memory in which what several processes share counts once (PSS). `help_s` is `twin --help`, `refused_s` a command with an option
that there is not, both without `rosrun`, which takes its own time. `rospy_s` is the processor time to load rospy alone: the floor
of each Python node.

Two commits in turns: ``python benchmarks/turns.py start 90a3d156``. In a folder without a workspace one is built first.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from link_world import ROOT, end_in_order, environment, free_port

WORKSPACE = ROOT / ".ws"
#: What belongs to the shell that runs this, and not to the commit whose start is measured. Nobody's shell forbids byte code.
_OTHERS = ("PYTHONPATH", "CMAKE_PREFIX_PATH", "ROS_PACKAGE_PATH", "PYTHONDONTWRITEBYTECODE")
#: prctl(2), Linux.
_PR_SET_CHILD_SUBREAPER = 36
_LIBC = ctypes.CDLL(None)
#: Longest start [s].
PATIENCE = 120.0
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
        master, broker, controller = (free_port() for _ in range(3))
        uri = f"http://127.0.0.1:{master}"
        ros = {
            "ROS_MASTER_URI": uri,
            "ROS_IP": "127.0.0.1",
            "ROS_HOME": str(folder),
            "ROS_LOG_DIR": str(folder / "log"),
        }
        ports = (f"broker_port:={broker}", f"rsi_port:={controller}")
        command = in_workspace("roslaunch", "-p", master, ROOT / "launch" / "bringup.launch", *ports, *words)
        self._log = folder / "start.log"
        with self._log.open("wb") as log:
            self._began = time.monotonic()
            self._process = subprocess.Popen(
                command, stdout=log, stderr=log, env=shell() | ros, start_new_session=True, cwd=folder
            )

    def await_line(self, text: str) -> float:
        """Return when the launch said this [s since it began]; SystemExit if it ended, or did not."""
        while text not in (said := self._log.read_text(errors="replace")):
            passed = time.monotonic() - self._began
            if self._process.poll() is not None or passed > PATIENCE:
                raise SystemExit(f"no {text!r} after {passed:.0f} s:\n{said[-2000:]}")
            time.sleep(0.01)
        return time.monotonic() - self._began

    def waited_for(self) -> float:
        """Return the processor time of children that have ended, as those that roslaunch runs while it reads [s]."""
        return sum(map(int, _stat(self._process.pid)[13:15])) / os.sysconf("SC_CLK_TCK")

    def used(self) -> dict[int, float]:
        """Return the processor time of each process of the launch [s]."""
        ticks = os.sysconf("SC_CLK_TCK")
        return {pid: sum(map(int, fields[11:13])) / ticks for pid, fields in self._family().items()}

    def memory(self) -> float:
        """Return the memory of all processes of the launch [MB]."""
        return sum(filter(None, map(pss_mb, self._family())))

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


def pss_mb(pid: int) -> float | None:
    """Return a process's memory, of what it shares its part [MB]; None when it has ended."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return None
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
            # and what it left behind, which ends by itself
            with suppress(ChildProcessError):
                while True:
                    os.wait()


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
            "start_cpu_s": sum(used.values()) + launch.waited_for(),
            "idle_cores": sum(idles.values()),
            "idle_mb": launch.memory(),
            "programs": dict(programs),
            "idle": dict(idles),
        }


def median_of(rows: Sequence[dict]) -> dict:
    """Return the median of each figure; of names below one another, too."""
    return {
        name: median_of([row[name] for row in rows if name in row])
        if isinstance(value, dict)
        else round(statistics.median(row[name] for row in rows if name in row), 3)
        for row in rows
        for name, value in row.items()
    }


def seconds_of(command: Sequence[str], runs: int, code: int = 0) -> tuple[float, float]:
    """Return the medians of time and processor time of a command that ends with this exit code [s]."""
    times, used = [], []
    for _ in range(runs):
        before, began = os.times(), time.monotonic()
        ended = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=shell()).returncode
        times.append(time.monotonic() - began)
        after = os.times()
        used.append(after.children_user + after.children_system - before.children_user - before.children_system)
        if ended != code:
            raise SystemExit(f"{' '.join(command)} ended with {ended}, not {code}")
    return round(statistics.median(times), 3), round(statistics.median(used), 3)


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
    twin = ROOT / "nodes" / "twin"
    result = median_of(rows)
    result["help_s"], _ = seconds_of(in_workspace("python", twin, "--help"), 9)
    result["refused_s"], _ = seconds_of(in_workspace("python", twin, "--nonsense"), 9, code=2)
    _, result["rospy_s"] = seconds_of(in_workspace("python", "-c", "import rospy"), 9)
    result["environment"] = environment()
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    for name, value in result.items():
        print(f"{name}: {value}")
    print(options.output)


if __name__ == "__main__":
    main()

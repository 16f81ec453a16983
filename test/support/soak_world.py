"""The programs of `make soak ARGS=faults`, and what can be done to them: bringup, its broker behind a line, a small disk, a clock.

Everything lives on free ports of loopback, and ends with the block. The disk is a tmpfs of its own, which needs root.
"""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import signal
import socket
import struct
import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import rospy
from processes import ROOT, listens, wait_until

from construction_twin.gateway.trace import TraceEntry, read_trace

ROBOT = "kr120"
#: Room of the disk that holds ROS_HOME: records, logs [MB].
DISK_MB = 192
#: Programs that do not run on the PC of the ROS nodes: their wall clock is another one.
CELL = "rsi_gateway:mosquitto"
#: Longest time until roslaunch has ended its nodes [s].
PATIENCE = 60.0
#: A line of a log that a person would ask about.
_BAD = re.compile(r"\b(ERROR|FATAL|CRITICAL)\b|Traceback|Logging error|process has died|required process")
#: The last line of a traceback: the exception's type, and what it says.
_EXCEPTION = re.compile(r"[A-Za-z_][\w.]*(: |$)")
_COLOUR = re.compile(r"\x1b\[[0-9;]*m|\x1b\].*?\x07")


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    """Return a free port of the loopback interface."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@dataclass(frozen=True)
class Ports:
    """TCP ports of master, broker and the line in front of it; UDP port of RSI."""

    master: int = field(default_factory=free_port)
    broker: int = field(default_factory=free_port)
    line: int = field(default_factory=free_port)
    rsi: int = field(default_factory=lambda: free_port(socket.SOCK_DGRAM))


class SoakWorld(ExitStack):
    """Bringup with the mock arm; entered when the ROS master answers.

    Args:
        folder: Empty; for logs, trace, configuration and the disk.
        arguments: Further arguments of bringup.launch.
    """

    def __init__(self, folder: Path, arguments: tuple[str, ...] = ()):
        super().__init__()
        self.folder, self.ports = folder, Ports()
        self.disk = folder / "disk"
        self.home = self.disk / "ros_home"
        self.review_file = self.home / "construction_twin" / f"{ROBOT}_reviews.jsonl"
        self.trace_file = folder / "gateway.trace"
        self._log = folder / "bringup.log"
        self._clock = folder / "wall_clock"
        self._ballast = self.disk / "ballast"
        self._arguments = arguments
        self._read: dict[Path, int] = {}
        self._traced = 0
        self._ended_runs: list[list[TraceEntry]] = []
        self._launch: subprocess.Popen | None = None

    def __enter__(self) -> SoakWorld:
        super().__enter__()
        try:
            self._start()
        except BaseException:
            self.__exit__(*sys.exc_info())
            raise
        return self

    def _start(self) -> None:
        self.disk.mkdir()
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK_MB}m", "soak", str(self.disk)], check=True)
        self.callback(subprocess.run, ["umount", "--lazy", str(self.disk)], check=False)
        self.home.mkdir()
        config = self.folder / "mosquitto.conf"
        shipped = (ROOT / "config" / "mosquitto.conf").read_text()
        config.write_text(f"{shipped}\nlistener {self.ports.broker} 127.0.0.1\n")
        library = self.folder / "wall_clock.so"
        source = Path(__file__).with_name("wall_clock.c")
        subprocess.run(["cc", "-O1", "-shared", "-fPIC", "-o", str(library), str(source)], check=True)
        self.step_clock(0.0, 0.0)
        os.environ |= {"ROS_MASTER_URI": f"http://127.0.0.1:{self.ports.master}", "ROS_IP": "127.0.0.1"}
        os.environ["ROS_HOME"] = str(self.home)
        for name in ("ROS_HOSTNAME", "ROS_LOG_DIR"):
            os.environ.pop(name, None)
        self._line = self._start_line()
        clock = {"LD_PRELOAD": str(library), "WALL_CLOCK_FILE": str(self._clock), "WALL_CLOCK_CELL": CELL}
        inside = {name: value for name, value in os.environ.items() if name != "ROS_NAMESPACE"}
        command = ["roslaunch", "-p", str(self.ports.master), "construction_twin", "bringup.launch"]
        command += [f"broker_config:={config}", f"broker_port:={self.ports.line}", f"rsi_port:={self.ports.rsi}"]
        command.append(f"ethernet_xml:={self._ethernet_xml()}")
        command += [f"gateway_trace:={self.trace_file}", *self._arguments]
        with open(self._log, "wb") as log:
            self._launch = subprocess.Popen(
                command, stdout=log, stderr=subprocess.STDOUT, env=inside | clock, start_new_session=True
            )
        self.callback(self._end_launch)
        wait_until(lambda: self.alive() and listens(self.ports.master), 60.0, "the ROS master's answer")

    def _ethernet_xml(self) -> Path:
        """Write the shipped file with the channel that tells the override, and return where it is."""
        shipped = (ROOT / "krl" / "ethernet" / "ctwin_ethernet.xml").read_text()
        end = "    </ELEMENTS>\n  </SEND>"
        assert shipped.count(end) == 1, "the shipped Ethernet XML has another form"
        path = self.folder / "ethernet.xml"
        path.write_text(shipped.replace(end, f'      <ELEMENT TAG="OvPro" TYPE="LONG" INDX="1"/>\n{end}'))
        return path

    def _start_line(self) -> subprocess.Popen:
        command = [sys.executable, str(Path(__file__).with_name("soak_proxy.py")), str(self.ports.line)]
        line = subprocess.Popen(
            [*command, str(self.ports.broker)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        )
        self.callback(line.wait)
        self.callback(line.stdin.close)
        assert line.stdout.readline() == "listening\n", "the line to the broker did not start"
        return line

    def alive(self) -> bool:
        """Return whether roslaunch runs; AssertionError with its last words when it has ended."""
        assert self._launch.poll() is None, self.said()
        return True

    def said(self) -> str:
        """Return the last lines that bringup printed."""
        return "\n".join(self._log.read_text(errors="replace").splitlines()[-15:])

    def wait_for_parameters(self, *names: str) -> None:
        """Wait until roslaunch has set these parameters."""
        wait_until(lambda: self.alive() and all(rospy.has_param(name) for name in names), 120.0, f"parameters {names}")

    def keep_logs(self) -> None:
        """Copy what is on the disk, which ends with the block, to the folder beside it."""
        shutil.copytree(self.home, self.folder / "ros_home", symlinks=True, dirs_exist_ok=True)

    # -- programs

    def nodes(self) -> dict[str, int]:
        """Return the process of each node that roslaunch runs, by its name in the robot's namespace.

        Of a node that is a copy of the loaded process it is the copy, which has its program's words.
        """
        programs, copies = {}, {}
        for entry in Path("/proc").glob("[0-9]*"):
            try:
                parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
                words = (entry / "cmdline").read_bytes().decode(errors="replace").replace("\0", " ").split()
            except (FileNotFoundError, ProcessLookupError):
                continue
            (programs if parent == self._launch.pid else copies)[tuple(words)] = int(entry.name)
        found = {}
        for words, pid in programs.items():
            names = [word.removeprefix("__name:=") for word in words if word.startswith("__name:=")]
            if name := names[0] if names else _unnamed(words):
                found[name] = copies.get(words, pid)
        return found

    def kill(self, name: str) -> int:
        """End a program as the kernel does when memory is short; return its process number.

        The gateway's trace is put aside before: the next run writes the file anew.
        """
        pid = self.nodes()[name]
        if name == "rsi_gateway":
            aside = self.trace_file.with_suffix(".aside")
            os.replace(self.trace_file, aside)
            os.kill(pid, signal.SIGKILL)
            self._ended_runs.append(self._read_trace(aside))
            self._traced = 0
            aside.unlink()
        else:
            os.kill(pid, signal.SIGKILL)
        return pid

    @contextlib.contextmanager
    def frozen(self, name: str):
        """Let a program stand still while the block runs."""
        pid = self.nodes()[name]
        os.kill(pid, signal.SIGSTOP)
        try:
            yield
        finally:
            os.kill(pid, signal.SIGCONT)

    def wait_for_nodes(self, names: set[str], timeout: float) -> None:
        """Wait until every one of these programs runs; what does not is the judge's to name."""
        with contextlib.suppress(AssertionError):
            wait_until(lambda: names <= set(self.nodes()), timeout, "the killed programs")

    # -- line, disk, clock

    def cut(self, seconds: float) -> None:
        """Let nothing pass between broker and everybody else from now on, for so many seconds."""
        self._line.stdin.write(f"cut {seconds}\n")

    def break_connections(self) -> None:
        """Break every connection to the broker."""
        self._line.stdin.write("reset\n")

    @contextlib.contextmanager
    def full_disk(self):
        """Fill the disk to the last byte, and free it at the end of the block."""
        with open(self._ballast, "ab", buffering=0) as ballast:
            try:
                self._fill(ballast)
                yield
            finally:
                ballast.truncate(0)
        self._ballast.unlink()

    @staticmethod
    def _fill(ballast) -> None:
        for size in (1 << 20, 1 << 12, 1):
            try:
                while True:
                    ballast.write(bytes(size))
            except OSError:
                continue

    def step_clock(self, ros: float, cell: float) -> None:
        """Set how far the wall clock is ahead from now on [s]: that of the ROS nodes, and that of gateway and broker."""
        numbers = struct.pack("<qq", round(ros * 1e9), round(cell * 1e9))
        with open(self._clock, "r+b" if self._clock.exists() else "wb") as file:
            file.write(numbers)

    # -- what is left behind

    def traces(self) -> list[list[TraceEntry]]:
        """Return what each run of the gateway has answered since the last call, each list from an entry at rest on.

        The arm must rest: the last entry of a call is the first one of the next.
        """
        runs, self._ended_runs = self._ended_runs, []
        return [*runs, self._read_trace(self.trace_file)]

    def _read_trace(self, path: Path) -> list[TraceEntry]:
        since = max(0, self._traced - 1)
        entries = read_trace(path, since)
        self._traced = since + len(entries)
        return entries

    @property
    def traced(self) -> int:
        """Number of cycles that were read from the trace of the present run of the gateway."""
        return self._traced

    def new_log_lines(self) -> tuple[int, list[str]]:
        """Return how many lines were logged since the last call, and those that speak of an error, each text once."""
        count, bad = 0, []
        for path in [self._log, *sorted((self.home / "log").rglob("*.log"))]:
            if path.is_symlink() or path.parent.is_symlink() or not path.exists():
                continue
            with open(path, "rb") as file:
                file.seek(self._read.get(path, 0))
                data = file.read()
            whole = data.rpartition(b"\n")[0] + b"\n" if b"\n" in data else b""
            self._read[path] = self._read.get(path, 0) + len(whole)
            lines = _COLOUR.sub("", whole.decode(errors="replace")).splitlines()
            count += len(lines)
            for number, line in enumerate(lines):
                if _BAD.search(line):
                    # the exception itself stands at a traceback's end
                    more = _last_of_traceback(lines[number:]) if "Traceback" in line else ""
                    bad.append(f"{path.name}: {line.strip()}{more}")
        return count, list(dict.fromkeys(bad))

    def _end_launch(self) -> None:
        if self._launch.poll() is None:
            self._launch.send_signal(signal.SIGINT)
        try:
            self._launch.wait(PATIENCE)
        except subprocess.TimeoutExpired:
            for pid in self.nodes().values():
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
            self._launch.kill()
            self._launch.wait()


def _unnamed(words: list[str]) -> str:
    """Return what a program is called that has no name of a node: the broker is mosquitto, the gateway a program without ROS."""
    name = Path(words[0]).name if words and words[0] else ""
    if "construction_twin.gateway" in words:
        return "rsi_gateway"
    return {"mosquitto": "broker"}.get(name, "rosmaster" if any(w.endswith("rosmaster") for w in words) else "")


def _last_of_traceback(lines: list[str]) -> str:
    # other programs write in between
    last = next((line for line in lines[1:60] if _EXCEPTION.match(line)), "")
    return f" ... {last}"


def wait_while(condition, timeout: float, period: float = 0.02) -> bool:
    """Return whether `condition()` ceased to hold within `timeout` [s]."""
    deadline = time.monotonic() + timeout
    while condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(period)
    return True

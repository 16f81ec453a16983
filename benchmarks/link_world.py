"""What every part of the link benchmark starts: a broker, a ROS master and processes on free ports of the loopback interface."""

from __future__ import annotations

import json
import os
import platform
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from importlib.metadata import version
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
#: SCHED_FIFO priority of the 250 Hz path where the system permits it, as launch/bringup.launch asks for.
REALTIME = 40
XACRO, ROBOT_YAML = ROOT / "urdf" / "kr120r2500.urdf.xacro", ROOT / "config" / "kr120.yaml"


def free_port(kind: int = socket.SOCK_STREAM) -> int:
    """Return a free port of the loopback interface."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_for(condition: Callable[[], object], timeout: float, what: str) -> object:
    """Return the first true value of `condition()`; TimeoutError after `timeout` [s]."""
    deadline = time.monotonic() + timeout
    while not (value := condition()):
        if time.monotonic() > deadline:
            raise TimeoutError(f"{what} did not happen within {timeout:g} s")
        time.sleep(0.01)
    return value


def listens(port: int) -> bool:
    """Return whether a program accepts TCP connections on this port of the loopback interface."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def cpu_seconds(pid: int) -> float:
    """Return the processor time that a process has used, all its threads [s] (Linux: the process's own CPU clock)."""
    return time.clock_gettime((~pid << 3) | 2)


class World(ExitStack):
    """Processes that end with the block; their output goes to files in `folder`.

    Args:
        folder: For logs, configuration files and ROS_HOME.
    """

    def __init__(self, folder: Path):
        super().__init__()
        self.folder = folder
        self.broker_port = 0
        self._processes: list[subprocess.Popen] = []
        self.environment = dict(os.environ, ROS_HOME=str(folder), ROS_LOG_DIR=str(folder / "log"))

    def start(self, name: str, command: Sequence[object], **environment: str) -> subprocess.Popen:
        """Start a program; it is interrupted, together with all others, and after 5 s killed, at the end of the block."""
        log = self.enter_context(open(self.folder / f"{name}.log", "ab"))
        process = subprocess.Popen(
            [str(part) for part in command], stdout=log, stderr=log, env=self.environment | environment
        )
        self._processes.append(process)
        return process

    def __exit__(self, *details):
        """End all programs at once: one after the other would take minutes on a machine that is too busy."""
        end(self._processes)
        return super().__exit__(*details)

    def start_broker(self, realtime: int = REALTIME) -> int:
        """Start mosquitto with the project's configuration; return its port."""
        self.broker_port = free_port()
        command = [sys.executable, ROOT / "nodes/broker", "--config", ROOT / "config/mosquitto.conf"]
        self.broker = self.start("mosquitto", [*command, "--port", self.broker_port, "--realtime", realtime])
        wait_for(lambda: listens(self.broker_port), 10.0, "mosquitto listening")
        return self.broker_port

    def start_master(self) -> str:
        """Start a ROS master; return its URI, which is also in the environment of what is started later."""
        port = free_port()
        self.environment |= {"ROS_MASTER_URI": f"http://127.0.0.1:{port}", "ROS_IP": "127.0.0.1"}
        self.environment.pop("ROS_HOSTNAME", None)
        self.start("rosmaster", ["rosmaster", "--core", "-p", port])
        wait_for(lambda: listens(port), 20.0, "the ROS master listening")
        return self.environment["ROS_MASTER_URI"]

    def last_lines(self, name: str) -> str:
        """Return the last lines of what a program printed."""
        return "\n".join((self.folder / f"{name}.log").read_text(errors="replace").splitlines()[-5:])


def end_in_order() -> None:
    """Make SIGTERM end this program as an exception does, so that what it started ends too; for the main thread."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))


def end(processes: Sequence[subprocess.Popen], patience: float = 5.0) -> None:
    """Interrupt processes, the last one first; kill those that do not end within `patience` [s]."""
    for process in reversed(processes):
        process.send_signal(signal.SIGINT)
    deadline = time.monotonic() + patience
    for process in reversed(processes):
        try:
            process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
    for process in processes:
        process.wait()


def spread_ms(latencies: Sequence[int]) -> dict:
    """Return the percentiles of latencies in ns, in ms; None without any."""
    names = ("p50_ms", "p99_ms", "p99_9_ms", "max_ms")
    if not len(latencies):
        return dict.fromkeys(names)
    values = np.percentile(latencies, (50, 99, 99.9, 100)) / 1e6
    return {name: round(float(value), 4) for name, value in zip(names, values)}


def write_figures(output: Path, figures: dict) -> None:
    """Print a benchmark's figures, and write them."""
    text = json.dumps(figures, indent=2)
    output.parent.mkdir(parents=True, exist_ok=True)
    output.write_text(text + "\n")
    print(f"{text}\nwritten to {output}")


def environment(packages: Sequence[str] = ()) -> dict:
    """Return what the figures depend on, with the versions of some packages."""
    cpu = [line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
    return {
        "system": platform.platform(),
        "packages": {name: version(name) for name in packages},
        "cpu": cpu[0].partition(": ")[2] if cpu else "unknown",
        "cores": os.cpu_count(),
        "kernel": os.uname().release,
        "python": sys.version.split()[0],
        "load": [round(value, 2) for value in os.getloadavg()],
    }

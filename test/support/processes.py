"""Real processes for tests: a broker on a free port, and waiting for conditions."""

from __future__ import annotations

import socket
import subprocess
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def wait_until(condition, timeout: float = 10.0, what: str = "the condition"):
    """Return the first true value of `condition()`; fail after `timeout` [s]."""
    deadline = time.monotonic() + timeout
    while True:
        value = condition()
        if value:
            return value
        assert time.monotonic() < deadline, f"{what} did not come true within {timeout} s"
        time.sleep(0.005)


def free_port() -> int:
    """Return a TCP port of this machine that nobody has."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def listens(port: int, host: str = "127.0.0.1") -> bool:
    """Return whether a program accepts TCP connections on this port of an address of this machine."""
    with socket.socket() as probe:
        return probe.connect_ex((host, port)) == 0


class BrokerProcess:
    """Debian's mosquitto with the project's configuration on a free port of the loopback interface."""

    def __init__(self, config: Path = ROOT / "config" / "mosquitto.conf"):
        self.port = free_port()
        self._process, self._config = None, config

    def start(self) -> None:
        command = ["/usr/sbin/mosquitto", "-c", str(self._config), "-p", str(self.port)]
        self._process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        wait_until(lambda: listens(self.port), what="mosquitto listening")

    def kill(self) -> None:
        """End it as a power cut would."""
        if self._process is not None:
            self._process.kill()
            self._process.wait(5.0)
            self._process = None

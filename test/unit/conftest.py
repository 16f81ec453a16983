"""Fixtures that several tests share: a real MQTT broker, and waiting for conditions."""

from __future__ import annotations

import itertools
import os
import socket
import subprocess
import time
from pathlib import Path

import hypothesis
import pytest

from construction_twin.mqtt.messages import Topics

# how long an example takes is the machine's affair, not the product's; and a red run is red again until it is mended, a green one
# stays green: new examples are looked for by `make properties`
hypothesis.settings.register_profile("repeatable", deadline=None, derandomize=True)
hypothesis.settings.register_profile("random", deadline=None)
hypothesis.settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

ROOT = Path(__file__).resolve().parents[2]
_prefixes = (f"test{number}" for number in itertools.count())


def wait_until(condition, timeout: float = 10.0, what: str = "the condition"):
    """Return the first true value of `condition()`; fail after `timeout` [s]."""
    deadline = time.monotonic() + timeout
    while True:
        value = condition()
        if value:
            return value
        assert time.monotonic() < deadline, f"{what} did not come true within {timeout} s"
        time.sleep(0.005)


def listens(port: int) -> bool:
    """Return whether somebody accepts TCP connections on this port of the loopback interface."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


class BrokerProcess:
    """Debian's mosquitto with the project's configuration on a free port of the loopback interface."""

    def __init__(self):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self._process = None

    def start(self) -> None:
        command = ["/usr/sbin/mosquitto", "-c", str(ROOT / "config" / "mosquitto.conf"), "-p", str(self.port)]
        self._process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        wait_until(lambda: listens(self.port), what="mosquitto listening")

    def kill(self) -> None:
        """End it as a power cut would."""
        if self._process is not None:
            self._process.kill()
            self._process.wait(5.0)
            self._process = None


@pytest.fixture
def broker_process():
    """A started BrokerProcess that the test may kill and start again."""
    process = BrokerProcess()
    process.start()
    yield process
    process.kill()


@pytest.fixture(scope="module")
def broker():
    """Port of a broker that a module's tests share; use a topic prefix of your own."""
    process = BrokerProcess()
    process.start()
    yield process.port
    process.kill()


@pytest.fixture
def topics():
    """MQTT topics that no other test uses."""
    return Topics(next(_prefixes), "arm")

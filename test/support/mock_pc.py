"""The mock controller in a thread, and a small PC that answers it on real UDP."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import contextmanager

from construction_twin.mock.network import MockRsi
from construction_twin.mock.program import MockSettings, build_controller
from construction_twin.rsi.gateway_codec import RobotDecoder, SensorEncoder

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
ZERO = (0.0,) * 6


class Pc(threading.Thread):
    """Answers every packet with zero corrections while `answering`; keeps (monotonic ns, packet, source)."""

    def __init__(self):
        super().__init__(daemon=True)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.05)
        self.answering = True
        #: How long an answer waits [ns], by the number of the packet, from 1.
        self.after: dict[int, int] = {}
        #: When the answer left [ns], by IPOC.
        self.answered: dict[int, int] = {}
        self.received = []
        self._encoder = SensorEncoder("ImFree", AXES)
        self._closing = threading.Event()

    @property
    def address(self):
        return self.socket.getsockname()

    def run(self):
        while not self._closing.is_set():
            try:
                data, source = self.socket.recvfrom(65535)
            except TimeoutError:
                continue
            now = time.monotonic_ns()
            packet = RobotDecoder(AXES).parse(data)
            if self.answering:
                time.sleep(self.after.get(len(self.received) + 1, 0) / 1e9)
                self.socket.sendto(self._encoder.encode(ZERO, packet.controller_ms), source)
                self.answered[packet.controller_ms] = time.monotonic_ns()
            self.received.append((now, packet, source))

    def close(self):
        self._closing.set()
        self.join(1.0)
        self.socket.close()


@contextmanager
def running(robot, address, restart_after=0.0, observe=lambda mock: None, **settings):
    settings = MockSettings(gateway_host=address[0], gateway_port=address[1], **settings)
    with in_thread(MockRsi(build_controller(settings, robot), address, restart_after, observe)) as mock:
        yield mock


@contextmanager
def in_thread(mock):
    """Run a `MockRsi`; yields it."""
    stop = threading.Event()
    thread = threading.Thread(target=mock.run, args=(stop,), daemon=True)
    thread.start()
    try:
        yield mock
    finally:
        stop.set()
        thread.join(1.0)
        assert not thread.is_alive()

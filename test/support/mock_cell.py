"""A mock controller and a PC that answers as told, on a simulated clock; and both on real UDP."""

from __future__ import annotations

import dataclasses
import math
import socket
import threading
import time
from contextlib import contextmanager
from dataclasses import dataclass
from types import SimpleNamespace

from construction_twin.core.units import radians
from construction_twin.gateway.config import GatewayConfig
from construction_twin.mock.config import MockConfig
from construction_twin.mock.controller import MockController
from construction_twin.mock.network import MockRsi
from construction_twin.mock.program import MockSettings, build_controller
from construction_twin.mock.servo import IdealServo
from construction_twin.rsi.gateway_codec import RobotDecoder, SensorEncoder
from construction_twin.rsi.layout import RsiLayout

AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
HOME = radians((0, -90, 90, 0, 90, 0))
CONFIG = MockConfig(
    axes=AXES,
    start_pose=HOME,
    lower=radians((-185, -140, -120, -350, -125, -350)),
    upper=radians((185, -5, 155, 350, 125, 350)),
    velocity=radians((123, 115, 120, 179, 172, 219)),
    acceleration=radians((155.8, 134.2, 368.7, 998.8, 518.0, 492.1)),
)
ZERO = (0.0,) * 6
PLAIN = RsiLayout.plain(AXES)
#: Commands of `swing` until it rests.
SWING = 314
NO_HOLDON = dataclasses.replace(PLAIN, holdon=(False,) * 6)
WITH_STOP = dataclasses.replace(PLAIN, receive=("Stop", *PLAIN.receive), holdon=(False, *PLAIN.holdon))


def forward_kinematics(angles):
    """Stand-in with the right shape: the tool is where the first three axes say."""
    return angles[:3], angles[3:]


class Cell:
    """A mock controller and a PC that answers as told."""

    def __init__(self, servo=None, **changes):
        self.config = dataclasses.replace(CONFIG, **changes)
        self.mock = MockController(self.config, servo or IdealServo(3), forward_kinematics)
        self.encoder = SensorEncoder.of(self.config.layout, AXES)
        self.packets = []

    def cycle(self, correction=None, ipoc_offset=0, encoder=None):
        """Run one cycle; `correction` [rad] None: no reply. Returns the packet or None."""
        data = self.mock.begin_cycle()
        if data is None:
            return None
        packet = RobotDecoder(AXES).parse(data)
        self.packets.append(packet)
        if correction is not None:
            self.mock.receive((encoder or self.encoder).encode(correction, packet.controller_ms + ipoc_offset))
        return packet

    def cycles(self, count, correction=ZERO):
        return [self.cycle(correction) for _ in range(count)]


def gateway_config(**changes) -> GatewayConfig:
    """Of a gateway that answers such a controller, for a sender that must wait for the processor now and then."""
    limits = CONFIG.lower, CONFIG.upper, CONFIG.velocity, CONFIG.acceleration
    return GatewayConfig("arm", AXES, *limits, decimals=6, playout_delay=0.1, silence=8.0, max_age=20.0, **changes)


def swing(k):
    """Command k of a motion of A1 from HOME, at rest after `SWING` commands."""
    return (0.2 * (1 - math.cos(0.01 * min(k, SWING))), *HOME[1:])


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


@dataclass(frozen=True)
class CycleSeen:
    """What the controller knew when a packet left: session, replies taken so far, cycles missed in a row, correction."""

    session: int
    answered: int
    missed: int
    correction: tuple[float, ...]


@contextmanager
def mock_at(address, **changes):
    """A mock controller on real UDP, in a thread; yields it, and an object whose `replies` are the cycles so far."""
    seen = []

    def observe(mock):
        controller = mock.controller
        seen.append(
            CycleSeen(controller.session, controller.counters["replies"], controller.missed, controller.applied)
        )

    controller = MockController(dataclasses.replace(CONFIG, **changes), IdealServo(3), forward_kinematics)
    with in_thread(MockRsi(controller, address, 1.0, observe)) as mock:
        yield mock, SimpleNamespace(replies=seen)


def step(axis, degrees):
    return tuple(math.radians(degrees) if index == axis else 0.0 for index in range(6))


def assert_stopped(cell, reason):
    assert cell.cycle(ZERO) is None
    assert not cell.mock.running and cell.mock.reason.startswith(reason), cell.mock.reason

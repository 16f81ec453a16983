"""A gateway with a simulated controller and a simulated sender around it, for the gateway's tests."""

from __future__ import annotations

import dataclasses
import math

from construction_twin.controller.telegram import Telegram
from construction_twin.core.units import CYCLE, CYCLE_NS, NANOSECONDS
from construction_twin.gateway.config import GatewayConfig
from construction_twin.gateway.gateway import Gateway, State
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import CommandProperties, Control, arm_value, reset_value

CONFIG = GatewayConfig("arm", ("A1", "A2"), (-0.5, -3.2), (0.5, 3.2), (2.0, 4.5), (2.34, 17.4))
DELAY_CYCLES = 5
#: The gateway's present run.
RUN = "run1"
START = JointStringCodec(2).quantise((0.1, -1.0))
#: The sender's clock when the cell's reads 0.
SENDER_EPOCH = 1_764_000_000_000_000_000
PAYLOADS = [
    b"",
    b"\x00" * 17,
    b"nan,nan",
    b"+000.000",
    b"+000.000,+000.000,+000.000",
    b"+005.730,-057.2960",
    b"+005.7300,-057.2960",
    b"+00a.000,+000.000",
    "+005.730,−057.296".encode(),
    b"+005.730;-057.296",
    b"+1e9.000,+000.000",
]


def slow(cycle, rate=2.0):
    """A smooth motion of A1 from START, well inside the limits; `cycle` from 0."""
    return (START[0] + 0.1 * (1 - math.cos(rate * cycle * CYCLE)), START[1])


class Cell:
    """A controller that carries out each reply at once, and a sender, on one simulated clock."""

    def __init__(self, start=START, measures=False, **changes):
        self.config = dataclasses.replace(CONFIG, **changes)
        self.gateway = Gateway(self.config, RUN, measures=measures)
        self._measures = measures
        self.codec = JointStringCodec(2, self.config.decimals)
        self.now = 50 * NANOSECONDS
        self.ipoc = 1_000_000
        self.source = ("192.168.1.20", 49152)
        self.setpoint = self.measured = start
        self.delay = 0
        self.seq = 0
        self.stamp = SENDER_EPOCH
        self.controls = 0
        self._commands = 0
        self.replies = []

    # the controller

    def telegram(self, **changes):
        telegram = Telegram(self.ipoc, self.measured, self.setpoint, self.delay)
        if self._measures:
            self.gateway.clock.on_telegram(self.ipoc, self.now)
        reply = self.gateway.on_telegram(dataclasses.replace(telegram, **changes), self.source, self.now)
        if reply is not None:
            self.measured = tuple(start + value for start, value in zip(self.setpoint, reply))
        self.replies.append(reply)
        return reply

    def cycle(self, count=1, step_ms=None, **changes):
        step_ms = self.step_ms = step_ms or self.config.cycle
        for _ in range(count):
            self.now += step_ms * 1_000_000
            self.ipoc += step_ms
            reply = self.telegram(**changes)
            self.gateway.poll(self.now)
        return reply

    # the sender

    def send(self, q, session="s1", stamp=None, seq=None, payload=None):
        self.stamp += CYCLE_NS
        self.seq += 1
        properties = CommandProperties(
            session, self.seq if seq is None else seq, self.stamp if stamp is None else stamp
        )
        self.gateway.on_command(
            self.codec.encode(q) if payload is None else payload,
            properties if self.config.properties else None,
            self.now,
        )

    def stream(self, poses, session="s1"):
        """A command every 4 ms, and a cycle after each, or after every third one."""
        for q in poses:
            self.send(q, session)
            self.pass_command()

    def pass_command(self):
        """Let the 4 ms of a command pass, at the end of which a cycle of the controller may begin."""
        self.now += CYCLE_NS
        self._commands += 1
        if self._commands * CYCLE_NS % self.config.cycle_ns == 0:
            # `cycle` lets the time of a whole cycle pass
            self.now -= self.config.cycle_ns
            self.cycle()

    def control(self, verb, session="s1", value=None):
        self.controls += 1
        if verb == "reset" and value is None:
            value = self.resetting
        return self.take(Control(str(self.controls), session, verb, value))

    def take(self, control):
        """Give the gateway a control; return whether it was carried out, and why."""
        answer = self.gateway.on_control(control, self.now)
        return answer.ok, answer.reason

    def arm(self, session="s1"):
        return self.control("arm", session, self.arming)

    # shorthand

    @property
    def arming(self):
        """The value of an `arm` that is meant for this gateway."""
        return arm_value(self.config.hash, self.gateway.run)

    @property
    def resetting(self):
        """The value of a `reset` that knows of every stop."""
        return reset_value(self.gateway.run, self.gateway.fault_number)

    @property
    def state(self):
        return self.gateway.state

    def count(self, name):
        return self.gateway.counters[name]

    def held(self):
        """Where a still arm has been put, checked over a second of telegrams."""
        before = self.measured
        self.cycle(250)
        assert self.measured == before
        return before


def following(cycles=100, **changes) -> Cell:
    """Return a cell in the middle of a motion of A1."""
    cell = Cell(**changes)
    cell.cycle(110 if changes.get("measures") else 3)
    assert cell.arm() == (True, "armed")
    cell.stream(slow(k) for k in range(cycles))
    assert cell.state is State.FOLLOWING
    return cell


def gap(cell):
    cell.now += round(cell.config.timeout * NANOSECONDS)
    cell.gateway.poll(cell.now + CYCLE_NS)
    assert cell.state is State.NO_CONTROLLER


def other_source(cell):
    cell.source = (cell.source[0], cell.source[1] + 1)


def jump_ahead(cell):
    cell.ipoc += 500


def jump_back(cell):
    cell.ipoc -= 4000

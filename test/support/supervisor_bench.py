"""A LinkSupervisor with a scripted gateway, arm and command stream around it, on one simulated clock."""

from __future__ import annotations

import itertools
import math
from types import SimpleNamespace

import pytest

from construction_twin.core.units import NANOSECONDS, last_digit
from construction_twin.link.gateway_status import GatewayAnswer, GatewayStatus, parse_status, read
from construction_twin.link.observations import LinkState
from construction_twin.link.supervisor import BareSupervisor, LinkSupervisor
from construction_twin.mqtt.messages import PROTOCOL

HASH, DECIMALS, RUN = "cafe", 3, "run1"
TOLERANCE = math.radians(0.05)
POSE = (0.1, 0.2)
#: What of a `GatewayConfig` the link is decided by.
CONFIG = SimpleNamespace(
    hash=HASH,
    decimals=DECIMALS,
    start_tolerances=(TOLERANCE,) * len(POSE),
    limits=SimpleNamespace(last_digits=lambda decimals: (last_digit(decimals),) * len(POSE)),
)
POLL = NANOSECONDS // 50
FAULT = "refused: joint_a1: velocity check failed"
SILENCE = "silence: no command for 0.104 s"
STOP = "stop: asked for by somebody"


def moved(distance: float) -> tuple[float, ...]:
    return (POSE[0] + distance, POSE[1])


class Bench:
    """A supervisor, its clock, and what the world around it does in every poll."""

    def __init__(self, waits: str = ""):
        ids = map(str, itertools.count(1))
        self.supervisor = LinkSupervisor(CONFIG, lambda: next(ids), waits)
        self.now = 100 * NANOSECONDS
        self.gateway = {
            "state": "ready", "reason": "", "session": "", "fault": False, "fault_number": 0, "run": RUN, "hash": HASH,
            "decimals": DECIMALS, "protocol": PROTOCOL,
        }  # fmt: skip
        self.pose: tuple[float, ...] | None = POSE
        self.command: tuple[float, ...] | None = POSE
        self.answering = True
        self.speaking = True
        self.sent = []
        self.forwarded = False
        self.supervisor.inputs.on_connection(True)

    @property
    def state(self) -> LinkState:
        return self.supervisor.state

    def set_gateway(self, state: str, reason: str = "", **other) -> None:
        """Let the gateway say this from now on; as the real one does, it names a stop's cause, here the sentence's first word."""
        if state in ("braking", "holding"):
            self.gateway["stop"] = {"cause": reason.partition(":")[0]}
        if other.get("fault") and not self.gateway["fault"]:
            self.gateway["fault_number"] += 1
        self.gateway |= {"state": state, "reason": reason} | other

    def poll(self):
        self.now += POLL
        if self.speaking:
            self.supervisor.inputs.on_status(read(GatewayStatus, self.gateway), self.now)
        if self.pose is not None:
            self.supervisor.inputs.on_pose(self.pose, self.now)
        if self.command is not None:
            self.forwarded = bool(self.supervisor.on_command(self.command, self.now))
        control = self.supervisor.poll(self.now)
        if control is not None:
            self.sent.append(control)
            self.carry_out(control)
        return control

    def run(self, seconds: float) -> Bench:
        for _ in range(round(seconds * 50)):
            self.poll()
        return self

    def carry_out(self, control) -> None:
        """What the real gateway does with these verbs when nothing moves."""
        if control.verb == "arm":
            self.set_gateway("armed", "armed", session=control.session)
        elif control.verb == "reset":
            self.set_gateway("ready", "reset", session="", fault=False)
        if self.answering:
            self.answer(control)

    def answer(self, control, ok: bool = True, reason: str = "") -> None:
        self.supervisor.on_answer(GatewayAnswer(id=control.id, ok=ok, reason=reason), self.now)

    def refuse(self, control, reason: str) -> None:
        self.answer(control, False, reason)

    @property
    def verbs(self) -> list[str]:
        return [control.verb for control in self.sent]


class BareBench:
    """The same around a bare PLC: it says a word, or none, and its pose; its strings may be refused."""

    def __init__(self):
        ids = map(str, itertools.count(1))
        self.supervisor = BareSupervisor(CONFIG, lambda: next(ids))
        self.now = 100 * NANOSECONDS
        self.word: str | None = "ready"
        self.pose: tuple[float, ...] | None = POSE
        self.command: tuple[float, ...] | None = POSE
        self.sent = []
        self.forwarded = False
        self.supervisor.inputs.on_connection(True)
        self._said: str | None = None

    @property
    def state(self) -> LinkState:
        return self.supervisor.state

    def publish_word(self, word: str) -> None:
        """Let the PLC say a word now."""
        self.supervisor.inputs.on_status(parse_status(word.encode()), self.now)

    def poll(self) -> None:
        self.now += POLL
        if self.word is not None and self.word != self._said:
            # retained, and said once: not repeated as a gateway's status is
            self.publish_word(self.word)
            self._said = self.word
        if self.pose is not None:
            self.supervisor.inputs.on_pose(self.pose, self.now)
        if self.command is not None:
            self.forwarded = bool(self.supervisor.on_command(self.command, self.now))
        control = self.supervisor.poll(self.now)
        if control is not None:
            self.sent.append(control)

    def run(self, seconds: float) -> BareBench:
        for _ in range(round(seconds * 50)):
            self.poll()
        return self


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def armed(bench) -> Bench:
    bench.run(1.0)
    assert bench.state is LinkState.ARMED
    bench.set_gateway("following", "stream began")
    bench.run(1.0)
    bench.sent.clear()
    return bench

"""The MQTT side of a route measurement, in a process of its own: sends states, receives commands, echoes, plays the gateway.

Stamps are times of the monotonic clock, the same for both ends on one machine: a message carries the time at which it was sent.
"""

from __future__ import annotations

import json
import select
import time
from dataclasses import dataclass, field

from link_mqtt import MqttEnd, publish_packet, read_publish

from construction_twin.gateway.config import GatewayConfig
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import PROTOCOL, StateProperties, Topics, read_command_properties

_PERIOD_OF_STATUS = 1.0


class FakeGateway:
    """What the bridge has to receive to be armed and to stay armed, and states as the system sends them."""

    def __init__(self, topics: Topics, pose: tuple[float, ...], config: GatewayConfig):
        self._topics, self._seq = topics, 0
        self._payload = JointStringCodec(len(pose), config.decimals).encode(pose)
        self._status = {"state": "ready", "reason": "benchmark", "session": "", "fault": False, "mode": "normal"}
        self._status |= {"run": "benchmark", "fault_number": 0, "protocol": PROTOCOL}
        self._status |= {"hash": config.hash, "decimals": config.decimals, "counters": {}}

    def state(self, command_stamp: int) -> bytes:
        """Return the packet of a state."""
        self._seq += 1
        pairs = StateProperties(self._seq, time.monotonic_ns(), command_stamp).pairs()
        return publish_packet(self._topics.state, self._payload, pairs)

    def status(self) -> bytes:
        """Return the packet of the status."""
        return publish_packet(self._topics.status, json.dumps(self._status).encode(), retain=True)

    def answer(self, payload: bytes) -> list[bytes]:
        """Return the packets that answer a control message."""
        control = json.loads(payload)
        armed = control["verb"] == "arm"
        self._status |= {"state": "following" if armed else "ready", "session": control["session"] if armed else ""}
        answer = {"id": control["id"], "verb": control["verb"], "ok": True, "reason": "", "session": control["session"]}
        return [self.status(), publish_packet(self._topics.control_ack, json.dumps(answer).encode())]


@dataclass
class Task:
    """What to do in one measurement.

    Attributes:
        rate: States per second; 0: none.
        count: How many states.
        echo: Answer each command with a state that carries its stamp.
    """

    rate: float = 0.0
    count: int = 0
    echo: bool = False


@dataclass
class Heard:
    """What a measurement yields: arrivals as (stamp, time of arrival) and stamps of what was sent [ns]."""

    arrivals: list[tuple[int, int]] = field(default_factory=list)
    sent: list[int] = field(default_factory=list)


class Peer:
    """Runs tasks that come through a pipe; between them it keeps the bridge armed."""

    def __init__(self, port: int, topics: Topics, gateway: FakeGateway):
        self._topics, self._gateway = topics, gateway
        self._end = MqttEnd(port, "link-peer", [topics.command, topics.control])
        self._status_at = 0.0
        self._task, self._heard = Task(), Heard()

    def run(self, pipe) -> None:
        """Serve until the pipe says None: a Task begins a measurement, ``"result"`` ends it."""
        due, period = 0, 0
        while True:
            self._report()
            left = len(self._heard.sent) < self._task.count
            wait = max(0, due - time.monotonic_ns()) / 1e9 if left else 0.1
            ready, _, _ = select.select([self._end.socket, pipe], [], [], min(wait, 0.1))
            if self._end.socket in ready:
                self._receive()
            if left and time.monotonic_ns() >= due:
                self._send()
                due += period
            if pipe not in ready:
                continue
            order = pipe.recv()
            if order is None:
                self._end.close()
                return
            if isinstance(order, Task):
                self._task, self._heard = order, Heard()
                period = round(1e9 / order.rate) if order.rate else 0
                due = time.monotonic_ns()
                pipe.send("begun")
            elif order == "count":
                pipe.send(len(self._heard.arrivals))
            else:
                self._task = Task()
                pipe.send(self._heard)

    def _send(self) -> None:
        now = time.monotonic_ns()
        self._end.publish(self._gateway.state(now))
        self._heard.sent.append(now)

    def _receive(self) -> None:
        for body in self._end.receive():
            topic, payload, pairs = read_publish(body)
            if topic == self._topics.command:
                stamp = read_command_properties(pairs).stamp
                if self._task.echo:
                    self._end.publish(self._gateway.state(stamp))
                self._heard.arrivals.append((stamp, time.monotonic_ns()))
            else:
                for packet in self._gateway.answer(payload):
                    self._end.publish(packet)

    def _report(self) -> None:
        now = time.monotonic()
        if now >= self._status_at:
            self._status_at = now + _PERIOD_OF_STATUS
            self._end.publish(self._gateway.status())


def serve(pipe, port: int, topics: Topics, robot, config: GatewayConfig) -> None:
    """Be the bridge's peer; the target of a process."""
    Peer(port, topics, FakeGateway(topics, tuple(robot.home), config)).run(pipe)

"""The bridge with lists in place of ROS topics and of the broker, on clocks that the test sets."""

from __future__ import annotations

import dataclasses
import json
from collections import Counter, defaultdict
from types import SimpleNamespace

from gateway_cell import CONFIG, RUN, START
from unplugged import ask

from construction_twin.core.units import NANOSECONDS
from construction_twin.link.observations import LinkState
from construction_twin.mqtt.client import Broker
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import PROTOCOL, Topics, parse_control
from construction_twin.ros.nodes.mqtt_bridge import NODE, WAITS, MqttBridge, Settings


class Clocks:
    """The wall clock, which somebody sets, and the monotonic one, in place of a module's."""

    def __init__(self, monkeypatch, module):
        self.wall, self.steady = 1_764_000_000 * NANOSECONDS, 1000 * NANOSECONDS
        monkeypatch.setattr(module, "now_ns", lambda: self.wall)
        #: What happens while a service waits.
        self.while_waiting = lambda: None
        steady = SimpleNamespace(
            monotonic_ns=lambda: self.steady,
            monotonic=lambda: self.steady / NANOSECONDS,
            sleep=lambda seconds: self.while_waiting() or self.run(seconds),
        )
        monkeypatch.setattr(module, "time", steady)

    def run(self, seconds: float) -> None:
        self.wall += round(seconds * NANOSECONDS)
        self.steady += round(seconds * NANOSECONDS)


class Client:
    """In place of the connection to the broker: remembers what is published."""

    def __init__(self):
        self.published: list[tuple[str, bytes]] = []
        self.streamed: list[tuple[str, bytes, object]] = []
        self.connected = True

    def publish(self, topic, payload, qos=0, retain=False):
        self.published.append((topic, payload))
        return SimpleNamespace(mid=len(self.published))

    def send_stream(self, topic, payload, pairs=None):
        self.streamed.append((topic, payload, pairs))

    def subscribe(self, topics):
        pass

    def is_connected(self):
        return self.connected

    @property
    def controls(self):
        """The control messages among what was published."""
        return [parse_control(payload) for topic, payload in self.published if topic.endswith("/control")]


class Published(list):
    """In place of a publisher."""

    def publish(self, *content):
        self.append(content)


class Refusals:
    """In place of `NodeDiagnostics`, which wants a master."""

    def __init__(self, report):
        self.refused = Counter()

    def refuse(self, reason, sentence):
        self.refused[reason] += 1


def open_node_io(diagnostics, waits="", keep=lambda name, value: None) -> SimpleNamespace:
    """Return a node's IO whose publishers are lists, by topic, and what an earlier bridge has kept; `keep` takes name and value."""
    return SimpleNamespace(
        publishers=defaultdict(Published),
        diagnostics=diagnostics,
        parameters={"gateway": {}, WAITS: waits},
        parameter_writer=lambda name: lambda value: keep(name, value),
    )


class BridgeBench:
    """A bridge for the two-axis arm of `gateway_cell`.

    Args:
        diagnostics: Takes what reports of the bridge; returns what counts.
        properties: Bool. Whether the link carries user properties.
        kind: Str. ``rsi`` or ``plc``: what takes the commands.
        kept: As of `open_node_io`.
    """

    def __init__(self, clocks, diagnostics=Refusals, properties=True, kind="rsi", **kept):
        self.clocks = clocks
        self.client = Client()
        settings = Settings(
            arm="mock",
            host="127.0.0.1",
            port=1,
            gateway_kind=kind,
            reset_timeout=1.0,
            max_state_age=0.1,
        )
        config = dataclasses.replace(CONFIG, properties=properties)
        codec = JointStringCodec(len(config.axes), config.decimals)
        #: Whether commands come, that is, whether twin and arm can meet.
        self.commands = True

        self._codec, self._states = codec, 0
        self.diagnostics = diagnostics(lambda: self.bridge.diagnose())
        node_io = open_node_io(self.diagnostics, **kept)
        topics = ("physical/joint_states", "link", "tool", "session_request")
        self.physical, self.links, self.tools, self.asked = (node_io.publishers[topic] for topic in topics)
        self.bridge = MqttBridge(
            settings, Topics("twin", "arm"), config, codec, Broker("127.0.0.1", 1), self.client, node_io
        )
        self.gateway = {
            "state": "ready", "reason": "", "session": "", "run": RUN, "fault_number": 0, "hash": config.hash,
            "decimals": config.decimals, "protocol": PROTOCOL,
        }  # fmt: skip

    @property
    def refused(self):
        """What was refused, and how often."""
        return self.diagnostics.refused

    def ask(self, name: str, **request):
        """Return the answer of one of the bridge's services."""
        return ask(NODE, self.bridge, name, SimpleNamespace(**request), self.diagnostics.refuse)

    def arm_by_name(self, person: str):
        """Return the answer to a person at the robot who arms a bare PLC."""
        return self.ask("~act_as_seen", act="arm", person=person, moment="")

    def connect(self) -> None:
        """Let the broker say welcome."""
        topic, payload, _ = self.bridge.on_connect()
        self.client.publish(topic, payload)

    def step(self) -> None:
        """Let 20 ms pass, with a gateway that is well and an arm at rest where it is commanded; then poll."""
        self.clocks.run(0.02)
        self._states += 1
        pairs = [("seq", str(self._states)), ("stamp", str(self.clocks.steady)), ("command_stamp", "0")]
        self.bridge.on_status(json.dumps(self.gateway).encode())
        self.bridge.on_state(self._codec.encode(START), pairs, False)
        if self.commands:
            self.bridge.on_command(self.clocks.wall, START)
        self.bridge.poll()
        self.bridge.write_log()

    def run_bare(self, steps: int = 1, commands: bool = True) -> None:
        """Let 20 ms pass, `steps` times, with a bare PLC that is ready at rest where it is commanded; then poll."""
        for _ in range(steps):
            self.clocks.run(0.02)
            if self.bridge.link is LinkState.GATEWAY_OFFLINE:
                self.bridge.on_status(b"ready")
            self.bridge.on_state(self._codec.encode(START), [], False)
            if commands:
                self.bridge.on_command(self.clocks.wall, START)
            self.bridge.poll()

    def arm(self) -> None:
        """Lead the link to ARMED."""
        self.connect()
        for _ in range(100):
            self.step()
            for control in self.client.controls[-1:]:
                self.gateway |= {"state": "armed", "session": control.session}
                self.bridge.on_answer(json.dumps({"id": control.id, "ok": True, "verb": control.verb}).encode())
            if self.bridge.link is LinkState.ARMED:
                self.bridge.poll()
                return
        raise AssertionError(f"not armed: {self.links[-1][0].reason}")

    def arm_and_rest(self) -> None:
        """Lead the link to ARMED, with a stream that has been seen to rest."""
        self.arm()
        for _ in range(15):
            self.step()

    def shown(self, status: dict) -> dict[str, str]:
        """Give the bridge a status; return what `link` says of the gateway a second later."""
        self.bridge.on_status(json.dumps(status).encode())
        self.clocks.run(1.0)
        self.bridge.poll()
        return {pair.key: pair.value for pair in self.links[-1][0].gateway_counters}

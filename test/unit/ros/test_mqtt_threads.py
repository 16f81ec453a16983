"""An unexpected exception in a callback of the MQTT connection leaves its thread: `run_node` then ends the process.

A thread of the client that ended quietly would leave a bridge that looks alive and hears nothing. Over real sockets, with a broker
of a few bytes, for both clients: the direct one that serves the link without TLS, and paho's own loop.
"""

from __future__ import annotations

import socket
import threading

import pytest
from bridge_bench import BridgeBench, Clocks, open_node_io
from gateway_cell import CONFIG

from construction_twin.mqtt.client import Broker, make_client
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.mqtt.messages import Topics
from construction_twin.ros.nodes import mqtt_bridge
from construction_twin.ros.nodes.mqtt_bridge import MqttBridge, Settings


def packet(kind: int, body: bytes) -> bytes:
    """A packet of MQTT 5 with a body of at most 127 bytes."""
    return bytes([kind, len(body)]) + body


def message(topic: str, payload: bytes) -> bytes:
    """A PUBLISH of QoS 0."""
    return packet(0x30, len(topic).to_bytes(2, "big") + topic.encode() + b"\0" + payload)


class TinyBroker:
    """Says welcome to one client, then sends it a message."""

    def __init__(self, sent: bytes):
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._sent = sent
        self.gone = threading.Event()
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        connection, _ = self._listener.accept()
        connection.recv(4096)
        connection.sendall(packet(0x20, b"\0\0\0") + self._sent)
        self.gone.wait(10.0)
        connection.close()
        self._listener.close()


def fail(*_, **__):
    raise IndexError("injected")


@pytest.fixture
def caught(monkeypatch):
    """What reaches `threading.excepthook`, where `run_node` ends the process."""
    errors, arrived = [], threading.Event()
    monkeypatch.setattr(threading, "excepthook", lambda args: errors.append(args) or arrived.set())

    def wait():
        assert arrived.wait(10.0), "the error was swallowed"
        return errors[0]

    return wait


@pytest.mark.parametrize("direct", [True, False], ids=["direct", "paho's loop"])
@pytest.mark.parametrize(
    "method, topic",
    [
        ("on_connect", ""),
        ("on_status", "twin/arm/status"),
        ("on_answer", "twin/arm/control/ack"),
        ("on_state", "twin/arm/state"),
    ],
)
def test_an_error_in_a_callback_reaches_the_hook_that_ends_the_node(monkeypatch, caught, direct, method, topic):
    monkeypatch.setattr(MqttBridge, method, fail)
    broker = TinyBroker(message(topic, b"x") if topic else b"")
    settings = Settings(arm="mock", host="127.0.0.1", port=broker.port, reset_timeout=1.0, max_state_age=0.1)
    address = Broker("127.0.0.1", broker.port)
    client = make_client(address, "bridge", "twin/arm/bridge/status", direct=direct)
    codec = JointStringCodec(len(CONFIG.axes), CONFIG.decimals)
    bridge = MqttBridge(settings, Topics("twin", "arm"), CONFIG, codec, address, client, open_node_io(None))
    bridge.connect()
    try:
        error = caught()
        assert error.exc_type is IndexError and error.thread is not threading.current_thread()
    finally:
        broker.gone.set()
        client.disconnect()
        client.loop_stop()


def test_an_expected_error_is_counted_and_ends_nothing(monkeypatch):
    bench = BridgeBench(Clocks(monkeypatch, mqtt_bridge))
    bench.bridge.on_state(b"nan,nan", [], False)
    bench.bridge.on_state(b"+005.730,-057.296", [], False)
    bench.bridge.on_state(b"+005.730,-057.296", [], True)
    bench.bridge.on_status(b"{")
    bench.bridge.on_answer(b"\xff")
    assert bench.refused == {"state_length": 1, "state_properties": 1, "state_retained": 1, "status": 2}

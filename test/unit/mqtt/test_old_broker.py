"""Brokers that do not speak MQTT 5, or no MQTT at all: both kinds of client say what to do, and never a word of the protocol's.

The answers are those of the real programs, recorded with Debian 12's: nats-server 2.9.10 refuses MQTT 5 with return code 1,
rabbitmq-server 3.10.8 fails on the CONNECT and hangs up without a byte.
"""

from __future__ import annotations

import selectors
import socket
import threading
import time

import pytest
from processes import wait_until

from construction_twin.mqtt.client import Broker, make_client, unique_id
from construction_twin.mqtt.failures import ConnectionLog
from construction_twin.mqtt.polled_client import PolledClient

#: CONNACK of MQTT 3.1.1 with return code 1, "unacceptable protocol version"; the connection is closed behind it.
REFUSED_VERSION = b"\x20\x02\x00\x01"
#: CONNACK of MQTT 5 with the reason code of the same meaning, as a broker of MQTT 5 refuses a newer one.
REFUSED_VERSION_5 = b"\x20\x03\x00\x84\x00"
REMEDY = "does not speak MQTT 5: use one that does, as mosquitto (docs/broker.md)"


class Answering:
    """A TCP server on loopback that answers what every client says first with the same bytes, and hangs up."""

    def __init__(self, answer: bytes):
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self.clients = 0
        self._answer = answer
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            with connection:
                self.clients += 1
                # what is unread when a socket is closed would turn the hang-up into a reset
                connection.recv(4096)
                connection.sendall(self._answer)

    def __enter__(self) -> Answering:
        return self

    def __exit__(self, *_) -> None:
        self._listener.close()


class ThreadClient:
    """The bridge's kind of client, served by a thread."""

    def __init__(self, broker: Broker):
        self.said: list[str] = []
        self.report = ConnectionLog(broker, self.said.append)
        self.client = make_client(broker, unique_id("arm", "test"), "unused/test", direct=True)
        self.report.watch(self.client)
        listen(self.client, self.report)
        self.client.connect_async(broker.host, broker.port, broker.keepalive)

    def __enter__(self) -> ThreadClient:
        self.client.loop_start()
        return self

    def __exit__(self, *_) -> None:
        self.client.disconnect()
        self.client.loop_stop()


class LoopClient:
    """The gateway's kind of client, served from a select loop."""

    def __init__(self, broker: Broker):
        self.said: list[str] = []
        self.report = ConnectionLog(broker, self.said.append)
        client = make_client(broker, unique_id("arm", "test"), "unused/test")
        listen(client, self.report)
        client.connect_async(broker.host, broker.port, broker.keepalive)
        self._selector = selectors.DefaultSelector()
        self.polled = PolledClient(client, self._selector, self.report.failed)
        self._running = True
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def _serve(self) -> None:
        while self._running:
            for key, _ in self._selector.select(0.01):
                key.data.read()
            self.polled.service(time.monotonic())

    def __enter__(self) -> LoopClient:
        self._thread.start()
        return self

    def __exit__(self, *_) -> None:
        self._running = False
        self._thread.join(5.0)


def listen(client, report: ConnectionLog) -> None:
    """Report as bridge and gateway do."""
    client.on_connect = lambda c, u, f, code, p: report.refused(code) if code.is_failure else report.connected(c, p)
    client.on_disconnect = lambda c, u, f, code, p: report.lost(code)


KINDS = pytest.mark.parametrize("kind", [ThreadClient, LoopClient])


@KINDS
@pytest.mark.parametrize("answer", [REFUSED_VERSION, REFUSED_VERSION_5], ids=["return code 1", "reason code 132"])
def test_a_broker_without_mqtt_5_is_told_once_with_what_helps(kind, answer):
    with Answering(answer) as server, kind(Broker(port=server.port)) as attempt:
        wait_until(lambda: server.clients >= 3, what="the third attempt")
        assert len(attempt.said) == 1 and attempt.report.sentence == attempt.said[0]
    assert attempt.said[0] == f"broker 127.0.0.1:{server.port} {REMEDY}"


@KINDS
@pytest.mark.parametrize(
    "answer", [b"", b"SSH-2.0-OpenSSH_9.2p1 Debian-2\r\n", b"HTTP/1.1 400 Bad Request\r\n\r\n", b"\xf0\0"]
)
def test_a_program_that_is_no_broker_is_no_protocol_error(kind, answer):
    with Answering(answer) as server, kind(Broker(port=server.port)) as attempt:
        wait_until(lambda: attempt.said, what="a sentence")
    asked = (
        "closed the connection without an answer: does the port speak MQTT 5 without TLS? RabbitMQ before 3.13 does not"
    )
    assert attempt.said[0] == f"broker 127.0.0.1:{server.port} {asked}"

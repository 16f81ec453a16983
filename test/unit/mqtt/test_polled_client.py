"""The gateway's MQTT connection in somebody else's loop, on TCP and on TLS: nothing waits, nothing is left lying."""

from __future__ import annotations

import selectors
import socket
import ssl
import struct
import threading
import time
from contextlib import contextmanager

import pytest
from processes import BrokerProcess, wait_until
from site_broker import Listener, SiteBroker

from construction_twin.mqtt.client import Broker, make_client, unique_id
from construction_twin.mqtt.fast_client import UserProperties
from construction_twin.mqtt.polled_client import PolledClient

PERIOD = 0.004
COUNT = 1000


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    site = SiteBroker(tmp_path_factory.mktemp("site"))
    site.start()
    yield site
    site.stop()


@pytest.fixture(params=["tcp", "tls"])
def ways(request):
    """How to reach a broker: for the gateway, and for the bridge."""
    if request.param == "tls":
        site = request.getfixturevalue("site")
        return site.broker(site.account("one-gateway")), site.broker(site.account("one-bridge"))
    return (Broker(port=request.getfixturevalue("broker")),) * 2


class Loop:
    """A gateway's loop without a gateway; `turn` may be called from one thread only."""

    def __init__(self, broker: Broker, subscribe: str = "", will: str = "twin/one/status"):
        self.selector = selectors.DefaultSelector()
        self.failures: list[OSError] = []
        self.received: list[bytes] = []
        client = make_client(broker, unique_id("one", "gateway"), will)
        client.on_connect = lambda c, *_: c.subscribe(subscribe) if subscribe else None
        client.on_message = lambda c, u, message: self.received.append(message.payload)
        client.connect_async(broker.host, broker.port, broker.keepalive)
        self.mqtt = PolledClient(client, self.selector, self.failures.append)

    def turn(self, patience: float = 0.01) -> None:
        for key, mask in self.selector.select(patience):
            if key.data is self.mqtt and mask & selectors.EVENT_READ:
                self.mqtt.read()
        self.mqtt.service(time.monotonic())

    def turn_until(self, condition, what: str, timeout: float = 10.0):
        def turned():
            self.turn()
            return condition()

        return wait_until(turned, timeout, what)

    def close(self) -> None:
        self.mqtt.close()
        self.selector.close()


@contextmanager
def loop_of(*arguments, **options):
    loop = Loop(*arguments, **options)
    try:
        yield loop
    finally:
        loop.close()


def test_connects_from_the_loop_and_waits_for_no_packet(ways):
    with loop_of(ways[0]) as loop:
        loop.turn_until(lambda: loop.mqtt.connected, "the connection")
        sock = loop.mqtt.client.socket()
        assert sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY) != 0
        assert sock.gettimeout() == 0.0 and isinstance(sock, ssl.SSLSocket) == ways[0].encrypted


def test_last_words_arrive_although_answers_are_unread(ways):
    heard = Listener(ways[1], "twin/one/status", "bridge")
    try:
        for number in range(20):
            with loop_of(ways[0], "twin/one/command") as loop:
                loop.turn_until(lambda loop=loop: loop.mqtt.connected, "the connection")
                for _ in range(50):
                    heard.client.publish("twin/one/command", b"unread")
                last = b"last words %d" % number
                loop.mqtt.client.publish("twin/one/status", last, qos=1)
            wait_until(lambda last=last: ("twin/one/status", last) in heard.messages, what="the last words")
    finally:
        heard.close()


def test_250_hz_both_ways_lose_nothing_and_keep_their_order(ways):
    """As between bridge and gateway: commands one way, states the other, on one connection each."""
    states, commands = ([b"%s %d" % (kind, k) for k in range(COUNT)] for kind in (b"state", b"command"))
    bridge = Listener(ways[1], "twin/one/state", "bridge")
    with loop_of(ways[0], "twin/one/command") as loop:
        loop.turn_until(lambda: loop.mqtt.connected, "the connection")
        loop.turn_until(lambda: bridge.client.publish("twin/one/command", b"?") and loop.received, "the subscription")

        def command():
            for payload in commands:
                bridge.client.publish("twin/one/command", payload, properties=UserProperties([("seq", "1")]))
                time.sleep(PERIOD)

        sender = threading.Thread(target=command)
        sender.start()
        due = time.monotonic()
        try:
            for payload in states:
                due += PERIOD
                while (patience := due - time.monotonic()) > 0:
                    loop.turn(patience)
                loop.mqtt.client.publish("twin/one/state", payload)
            loop.turn_until(lambda: loop.received[-1:] == commands[-1:], "the last command")
            wait_until(lambda: bridge.messages[-1:] == [("twin/one/state", states[-1])], what="the last state")
        finally:
            sender.join(30.0)
            bridge.close()
        assert [payload for payload in loop.received if payload != b"?"] == commands
        assert [payload for _, payload in bridge.messages] == states


def test_finds_the_broker_again_after_its_restart():
    process = BrokerProcess()
    process.start()
    try:
        with loop_of(Broker(port=process.port)) as loop:
            loop.turn_until(lambda: loop.mqtt.connected, "the connection")
            process.kill()
            loop.turn_until(lambda: not loop.mqtt.connected and loop.failures, "the loss")
            assert isinstance(loop.failures[0], ConnectionRefusedError)
            process.start()
            loop.turn_until(lambda: loop.mqtt.connected, "the new connection")
    finally:
        process.kill()


def test_finds_a_site_s_broker_again_after_its_restart(tmp_path):
    site = SiteBroker(tmp_path / "site")
    site.start()
    try:
        with loop_of(site.broker(site.account("one-gateway"))) as loop:
            loop.turn_until(lambda: loop.mqtt.connected, "the connection")
            site.stop()
            loop.turn_until(lambda: not loop.mqtt.connected and loop.failures, "the loss")
            site.start()
            loop.turn_until(lambda: loop.mqtt.connected, "the new connection")
    finally:
        site.stop()


def test_every_attempt_that_fails_is_told_with_its_error(site):
    broker = site.broker(site.account("one-gateway"), "127.1")
    with loop_of(broker) as loop:
        loop.turn_until(lambda: len(loop.failures) >= 2, "two failures")
        assert all(isinstance(error, ssl.SSLCertVerificationError) for error in loop.failures)
        assert not loop.mqtt.connected


class ScriptedBroker(threading.Thread):
    """Speaks TLS, welcomes one client, and then sends what it is told in one record."""

    def __init__(self, site, payload: bytes):
        super().__init__(daemon=True)
        self._context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        self._context.load_cert_chain(site.folder / "broker/server.crt", site.folder / "broker/server.key")
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.port = self._socket.getsockname()[1]
        self._payload = payload
        self.ended = threading.Event()

    def run(self) -> None:
        with self._socket, self._context.wrap_socket(self._socket.accept()[0], server_side=True) as line:
            line.recv(4096)
            line.sendall(b"\x20\x03\x00\x00\x00" + self._payload)
            self.ended.wait(30.0)


def packet(payload: bytes) -> bytes:
    """Return an MQTT 5 PUBLISH with QoS 0 on topic t."""
    body = struct.pack(">H", 1) + b"t\0" + payload
    return bytes((0x30, len(body))) + body


@pytest.mark.parametrize("count", [2, 33, 200])
def test_packets_that_share_a_tls_record_do_not_wait_for_the_next_one(site, count):
    """After the record nothing makes the socket readable any more; what TLS has decrypted must be looked for."""
    payloads = [b"%05d" % k for k in range(count)]
    scripted = ScriptedBroker(site, b"".join(map(packet, payloads)))
    scripted.start()
    broker = Broker("localhost", scripted.port, account=site.account("one-gateway"))
    try:
        with loop_of(broker) as loop:
            loop.turn_until(lambda: len(loop.received) >= count, "every packet of the record")
            assert loop.received == payloads
    finally:
        scripted.ended.set()
        scripted.join(5.0)


def test_a_read_with_nothing_there_does_not_wait(ways):
    with loop_of(ways[0]) as loop:
        loop.turn_until(lambda: loop.mqtt.connected, "the connection")
        for _ in range(1000):
            loop.mqtt.read()
        assert loop.mqtt.connected


def test_more_than_the_line_takes_at_once_is_written_when_it_can_be(ways):
    """A peer that does not read fills the buffers: publishing goes on, and everything arrives once it reads."""
    bridge = Listener(ways[1], "twin/one/state", "bridge")
    payload = b"x" * 32768
    try:
        with loop_of(ways[0]) as loop:
            loop.turn_until(lambda: loop.mqtt.connected, "the connection")
            for _ in range(200):
                loop.mqtt.client.publish("twin/one/state", payload, qos=1)
            loop.turn_until(lambda: len(bridge.messages) >= 200, "every message", 30.0)
    finally:
        bridge.close()
    assert bridge.messages == [("twin/one/state", payload)] * 200

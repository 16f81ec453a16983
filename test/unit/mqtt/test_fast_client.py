"""The lean paths of the MQTT client say exactly what paho's general ones say, and hold under threads."""

from __future__ import annotations

import contextlib
import socket
import threading

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from paho.mqtt import client as paho
from paho.mqtt._packet import decode_publish
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.exception import MalformedPacket
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from processes import wait_until

from construction_twin.mqtt.client import Broker, make_client
from construction_twin.mqtt.fast_client import DirectClient, FastClient, UserProperties, read_plain, received_pairs

TEXT = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0\ufeff"), max_size=40)
PAIRS = st.lists(st.tuples(TEXT, TEXT), max_size=5)
ASCII = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=16)


def paho_properties(pairs) -> Properties:
    properties = Properties(PacketTypes.PUBLISH)
    if pairs:
        properties.UserProperty = pairs
    return properties


def packet(topic: str, pairs, payload: bytes) -> bytes:
    """A PUBLISH of QoS 0 as paho makes it, without the fixed header."""
    name = topic.encode()
    return len(name).to_bytes(2, "big") + name + paho_properties(pairs).pack() + payload


@given(ASCII, st.lists(st.tuples(ASCII, ASCII), max_size=3), st.binary(max_size=80))
@example("twin/kr120/state", [("seq", "1"), ("stamp", "1764000000000000000"), ("command_stamp", "0")], b"+000.000")
def test_reads_a_joint_string_as_paho_does(topic, pairs, payload):
    data = packet(topic, pairs, payload)
    known = decode_publish(0x30, data, MQTTProtocolVersion.MQTTv5)
    plain = read_plain(data)
    if len(paho_properties(pairs).pack()) <= 128:
        assert plain is not None
        assert (plain[0], plain[1].UserProperty, plain[2]) == (topic.encode(), pairs, payload)
        assert (known.topic, known.payload) == (plain[0], plain[2])
    else:
        assert plain is None


@given(st.binary(max_size=120) | st.builds(packet, TEXT, PAIRS, st.binary(max_size=20)), st.data())
def test_whatever_it_reads_paho_reads_alike(data, draw):
    """Mutated packets too: the lean parser may decline, but never read something else, or what paho refuses."""
    if data and draw.draw(st.booleans()):
        at = draw.draw(st.integers(0, len(data) - 1))
        data = data[:at] + bytes([draw.draw(st.integers(0, 255))]) + data[at + 1 :]
    plain = read_plain(data)
    if plain is None:
        return
    try:
        known = decode_publish(0x30, data, MQTTProtocolVersion.MQTTv5)
    except MalformedPacket:
        pytest.fail(f"paho refuses {data!r}, which was read as {plain}")
    assert (known.topic, known.payload) == (plain[0], plain[2])
    assert list(getattr(known.properties, "UserProperty", ())) == plain[1].UserProperty


@pytest.fixture
def direct(broker, topics):
    """A connected DirectClient."""
    client = make_client(Broker(port=broker), "direct", topics.bridge_status, direct=True)
    assert isinstance(client, DirectClient)
    client.connect_async("127.0.0.1", broker)
    client.loop_start()
    wait_until(client.is_connected, what="connection")
    yield client
    client.disconnect()
    client.loop_stop()


def test_sends_in_the_thread_that_publishes(direct, topics):
    threads = []
    write = direct._sock_send
    direct._sock_send = lambda data: threads.append(threading.get_ident()) or write(data)
    for _ in range(20):
        direct.publish(topics.command, b"x")
    # nearly all: a thread that stands still in between leaves its packet to the other one
    assert threads.count(threading.get_ident()) >= 10


def test_packets_of_several_threads_stay_whole_and_in_order(direct, topics):
    """Payloads far larger than the socket's buffer, so that packets are sent in parts."""
    got: list[tuple[int, int]] = []
    ended = threading.Event()

    def on_message(client, userdata, message):
        head, _, body = bytes(message.payload).partition(b":")
        thread, number = map(int, head.split(b","))
        assert body == bytes([65 + thread]) * len(body)
        got.append((thread, number))
        if len(got) == 120:
            ended.set()

    direct.on_message = on_message
    direct.subscribe(topics.command, 0)

    def send(thread: int) -> None:
        for number in range(30):
            pairs = [("seq", str(number))]
            payload = b"%d,%d:" % (thread, number) + bytes([65 + thread]) * 30_000
            if number % 2:
                direct.send_stream(topics.command, payload, pairs)
            else:
                direct.publish(topics.command, payload, properties=UserProperties(pairs))

    senders = [threading.Thread(target=send, args=(thread,)) for thread in range(4)]
    for sender in senders:
        sender.start()
    for sender in senders:
        sender.join(20.0)
    assert ended.wait(20.0), f"{len(got)} of 120 came"
    for thread in range(4):
        numbers = [number for sender, number in got if sender == thread]
        assert numbers == list(range(30))


class Reader:
    """A client whose broker is the test: what its callbacks are given of the bytes that come in."""

    def __init__(self, kind: type[paho.Client], streams: tuple[str, ...] = ()):
        self.client = kind(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        self.ours, self.broker = socket.socketpair()
        self.ours.setblocking(False)
        self.client._sock = self.ours
        self.messages = []
        self.client.on_message = lambda _client, _data, message: self.take(
            message.topic, message.payload, received_pairs(message), message.retain
        )
        for topic in streams:
            self.client.on_stream(topic, lambda *content, topic=topic: self.take(topic, *content))

    def take(self, topic: str, payload: bytes, pairs, retained: bool) -> None:
        self.messages.append((topic, bytes(payload), pairs, bool(retained)))

    def hear(self, parts: list[bytes]) -> None:
        """Read what comes in such parts."""
        for part in parts:
            self.broker.sendall(part)
            # as many calls as packets could have come, and one more
            for _ in range(len(part) // 2 + 2):
                self.client.loop_read()

    def close(self) -> None:
        self.client._sock = None
        self.ours.close()
        self.broker.close()


def with_header(body: bytes, header: int = 0x30) -> bytes:
    return bytes([header]) + length_of(len(body)) + body


def length_of(value: int) -> bytes:
    packed = bytearray()
    paho.Client(CallbackAPIVersion.VERSION2)._pack_remaining_length(packed, value)
    return bytes(packed)


TOPICS = st.sampled_from(["twin/arm/state", "twin/arm/status", "größe"])
PACKETS = st.builds(
    with_header,
    st.builds(packet, TOPICS, PAIRS, st.binary(max_size=300) | st.just(b"x" * 20_000)),
    st.sampled_from([0x30, 0x31]),
) | st.just(b"\xd0\x00")


@given(st.lists(PACKETS, max_size=6), st.lists(st.integers(1, 400), max_size=8), st.booleans())
def test_a_stream_in_any_parts_is_read_as_paho_does(packets, cuts, as_stream):
    """Ping answers and long packets in between; whole packets, several at once, and pieces."""
    data, parts = b"".join(packets), []
    for cut in cuts:
        parts.append(data[:cut])
        data = data[cut:]
    parts = [part for part in (*parts, data) if part]
    lean = Reader(FastClient, ("twin/arm/state",) if as_stream else ())
    known = Reader(paho.Client)
    try:
        for reader in (lean, known):
            reader.hear(parts)
        assert lean.messages == known.messages
    finally:
        lean.close()
        known.close()


@given(pairs=PAIRS, payload=st.binary(max_size=300))
def test_sends_what_paho_sends(pairs, payload):
    sent = []
    for kind in (FastClient, paho.Client):
        client = kind(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        ours, broker = socket.socketpair()
        with ours, broker:
            client._sock = ours
            if kind is FastClient:
                client.send_stream("twin/arm/command", payload, pairs)
            else:
                client.publish("twin/arm/command", payload, properties=paho_properties(pairs))
            sent.append(broker.recv(100_000))
            client._sock = None
    assert sent[0] == sent[1]


def test_a_connection_that_is_lost_while_it_sends_is_noticed(direct, topics):
    lost = threading.Event()
    direct.on_disconnect = lambda *_: lost.set()
    direct._sock.shutdown(socket.SHUT_RDWR)
    direct.send_stream(topics.command, b"x")
    assert lost.wait(10.0)


class Socket:
    """Takes a first packet in part, and says in which threads it was used."""

    def __init__(self, client: paho.Client, meanwhile=lambda: None, part: int = 10):
        self.wire, self.threads = bytearray(), []
        self._meanwhile, self._part = meanwhile, part
        client._sock = self

    def send(self, data: bytes) -> int:
        self.threads.append(threading.get_ident())
        if self._part and not self.wire:
            self.wire += data[: self._part]
            self._meanwhile()
            return self._part
        self.wire += data
        return len(data)

    def close(self) -> None:
        """Nothing to close."""


def test_a_packet_that_was_begun_is_ended_before_another_thread_s():
    client = make_client(Broker(), "direct", "status", direct=True)
    other = threading.Thread(target=lambda: client.publish("B", b"bbbb"))

    def publish() -> None:
        other.start()
        wait_until(client.want_write, what="the other thread's packet in the queue")

    sock = Socket(client, publish)
    client.send_stream("A", b"a" * 30)
    other.join(10.0)
    first, second = packet("A", [], b"a" * 30), packet("B", [], b"bbbb")
    assert bytes(sock.wire) == with_header(first) + with_header(second)
    client._sock = None


def test_what_paho_s_thread_serves_is_used_by_no_other():
    """So it is with TLS: Python has no lock for a TLS socket that one thread reads and another writes."""
    client = FastClient(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
    started, ended = threading.Event(), threading.Event()
    client.loop_forever = lambda **_: started.set() or ended.wait(10.0)
    client.loop_start()
    sock = Socket(client, part=0)
    try:
        assert started.wait(10.0)
        client.send_stream("t", b"x")
        assert not sock.threads and client.want_write()
        client.loop_write()
        assert bytes(sock.wire) == with_header(packet("t", [], b"x"))
    finally:
        ended.set()
        client._sock = None


def test_a_callback_that_sends_on_a_lost_connection_returns():
    client = FastClient(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
    ours, broker = socket.socketpair()
    lost = []
    client.on_disconnect = lambda *_: lost.append(True)
    client.on_message = lambda *_: client.send_stream("t", b"x")
    with ours, broker:
        client._sock = ours
        broker.sendall(with_header(packet("other", [], b"x")))
        broker.shutdown(socket.SHUT_RD)
        reader = threading.Thread(target=client.loop_read, daemon=True)
        reader.start()
        reader.join(10.0)
        assert not reader.is_alive() and not lost and client.want_write()
        # found by the loop, then
        client.loop_write()
        assert lost
        client._sock = None


def test_a_broker_that_does_not_read_gets_everything_later():
    client = FastClient(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
    ours, broker = socket.socketpair()
    with ours, broker:
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        ours.setblocking(False)
        client._sock = ours
        numbers = 0
        while len(client._out_packet) < 3:
            client.send_stream("t", b"%06d" % numbers * 100)
            numbers += 1
        # what paho itself has to say goes behind what waits
        client.publish("t", b"end")
        expected = [b"%06d" % number * 100 for number in range(numbers)] + [b"end"]
        reader = Reader(FastClient)
        broker.setblocking(False)
        for _ in range(100 * numbers):
            with contextlib.suppress(BlockingIOError):
                reader.hear([broker.recv(4096)])
            client.loop_write()
            if len(reader.messages) == len(expected):
                break
        assert [payload for _, payload, _, _ in reader.messages] == expected
        reader.close()
        client._sock = None

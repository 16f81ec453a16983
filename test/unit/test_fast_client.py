"""The lean paths of the MQTT client say exactly what paho's general ones say, and hold under threads."""

from __future__ import annotations

import itertools
import threading

import pytest
from conftest import wait_until
from hypothesis import example, given
from hypothesis import strategies as st
from paho.mqtt import client as paho
from paho.mqtt._packet import decode_publish
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.exception import MalformedPacket
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

from construction_twin.mqtt.client import Broker, make_client, received_pairs, user_properties
from construction_twin.mqtt.fast_client import DirectClient, FastClient, UserProperties, read_plain

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


@given(PAIRS)
def test_packs_what_paho_packs(pairs):
    assert UserProperties(pairs).pack() == paho_properties(pairs).pack()


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
def received():
    """A client that is not connected, and what its callback is given."""
    client = FastClient(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
    messages = []
    client.on_message = lambda client, userdata, message: messages.append(message)

    def receive(header: int, data: bytes) -> paho.MQTTMessage:
        client._in_packet["command"], client._in_packet["packet"] = header, bytearray(data)
        client._handle_publish()
        return messages[-1]

    return receive


@pytest.mark.parametrize("retain", [0, 1])
@pytest.mark.parametrize("pairs", [[], [("seq", "7")], [("seq", "7" * 200)], [("größe", "7")]])
def test_callback_gets_the_same_message_on_both_paths(received, pairs, retain):
    message = received(0x30 | retain, packet("twin/arm/state", pairs, b"+000.000"))
    assert (message.topic, message.payload, message.retain) == ("twin/arm/state", b"+000.000", bool(retain))
    assert (message.qos, message.mid, message.dup) == (0, 0, False)
    assert received_pairs(message) == pairs


def test_other_properties_go_to_paho(received):
    properties = Properties(PacketTypes.PUBLISH)
    properties.ContentType = "text"
    message = received(0x30, b"\x00\x01t" + properties.pack() + b"x")
    assert message.properties.ContentType == "text" and message.payload == b"x"


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
    assert threads.count(threading.get_ident()) >= 20


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
            beside = user_properties([("seq", str(number))])
            direct.publish(
                topics.command, b"%d,%d:" % (thread, number) + bytes([65 + thread]) * 30_000, properties=beside
            )

    senders = [threading.Thread(target=send, args=(thread,)) for thread in range(4)]
    for sender in senders:
        sender.start()
    for sender in senders:
        sender.join(20.0)
    assert ended.wait(20.0), f"{len(got)} of 120 came"
    for thread in range(4):
        numbers = [number for sender, number in got if sender == thread]
        assert numbers == list(range(30))


def test_connects_again_when_the_broker_comes_back(broker_process, topics):
    client = make_client(Broker(port=broker_process.port), "direct", topics.bridge_status, direct=True)
    counts = itertools.count(1)
    connections = []
    client.on_connect = lambda *_: connections.append(next(counts))
    client.connect_async("127.0.0.1", broker_process.port)
    client.loop_start()
    wait_until(client.is_connected, what="connection")
    broker_process.kill()
    wait_until(
        lambda: not client.is_connected() or client.publish(topics.command, b"x").rc, what="the loss to be noticed"
    )
    broker_process.start()
    wait_until(lambda: len(connections) == 2 and client.is_connected(), 15.0, "a second connection")
    client.disconnect()
    client.loop_stop()
    assert not client._server.is_alive()

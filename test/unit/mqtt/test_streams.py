"""Streams and what is too large for the broker, over a real one; the paho that is needed."""

from __future__ import annotations

import threading

import pytest
from paho.mqtt import __version__ as paho_version
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.reasoncodes import ReasonCode
from processes import ROOT, BrokerProcess, wait_until

from construction_twin.core.errors import ConfigurationError
from construction_twin.mqtt import fast_client
from construction_twin.mqtt.client import Broker, ConnectionLog, make_client, subscriptions, unique_id
from construction_twin.mqtt.fast_client import DirectClient, FastClient


def test_the_pinned_paho_is_the_installed_one_and_was_tested():
    pinned = [line for line in (ROOT / "setup/requirements.txt").read_text().splitlines() if line.startswith("paho")]
    assert pinned == [f"paho-mqtt=={fast_client.TESTED_VERSIONS[-1]}"]
    assert paho_version in fast_client.TESTED_VERSIONS


def test_an_untested_paho_is_refused_in_one_sentence(monkeypatch):
    monkeypatch.setattr(fast_client, "paho_version", "2.9.9")
    with pytest.raises(
        ConfigurationError, match=r"paho-mqtt: found '2\.9\.9', expected version 2\.2\.0: install that one"
    ):
        Broker()


@pytest.mark.parametrize("direct", [True, False])
def test_a_stream_arrives_whole_in_order_and_with_its_properties(broker, topics, direct):
    sender = make_client(Broker(port=broker), unique_id("a", "s"), "w/1", direct=direct)
    receiver = make_client(Broker(port=broker), unique_id("a", "r"), "w/2", direct=direct)
    assert isinstance(sender, DirectClient) == direct
    got, subscribed, ended = [], threading.Event(), threading.Event()

    def take(payload, pairs, retained):
        got.append((payload, pairs, retained))
        if len(got) == 201:
            ended.set()

    receiver.on_stream(topics.command, take)
    receiver.on_connect = lambda client, *rest: client.subscribe(subscriptions([(topics.command, 0)]))
    receiver.on_subscribe = lambda *rest: subscribed.set()
    sender.send_stream(topics.command, b"before there is a connection: dropped")
    for client in (receiver, sender):
        client.connect_async("127.0.0.1", broker)
        client.loop_start()
    wait_until(sender.is_connected, what="connection")
    assert subscribed.wait(10.0)
    for number in range(200):
        sender.send_stream(topics.command, b"+%03d.000" % number, [("seq", str(number)), ("session", "s1")])
    sender.publish(topics.command, b"kept", 0, True).wait_for_publish(5.0)
    assert ended.wait(10.0)
    sender.publish(topics.command, b"", 0, True).wait_for_publish(5.0)
    for client in (sender, receiver):
        client.disconnect()
        client.loop_stop()
    beside = [[("seq", str(number)), ("session", "s1")] for number in range(200)]
    assert [pairs for _, pairs, _ in got[:200]] == beside
    assert [payload for payload, _, _ in got[:200]] == [b"+%03d.000" % number for number in range(200)]
    # the flag shows on what is published while one listens
    assert got[200] == (b"kept", [], True)


def test_what_is_larger_than_the_broker_takes_is_not_sent_and_said_once_with_both_sizes(tmp_path, topics):
    config = tmp_path / "mosquitto.conf"
    config.write_text((ROOT / "config" / "mosquitto.conf").read_text() + "\nmax_packet_size 2000\n")
    process, said, lost = BrokerProcess(config), [], []
    process.start()
    report = ConnectionLog(Broker(port=process.port), said.append)
    client = make_client(Broker(port=process.port), unique_id("a", "s"), "w/1", direct=True)
    client.on_connect = lambda c, u, f, code, properties: report.connected(c, properties)
    client.on_disconnect = lambda *rest: lost.append(rest)
    client.connect_async("127.0.0.1", process.port)
    client.loop_start()
    wait_until(lambda: client.largest == 2000, what="the broker's limit")
    # header up to 5, length of the topic 2, id 2, no properties 1
    most = 2000 - 10 - len(topics.status)
    for _ in range(2):
        assert client.publish(topics.status, b"x" * (most + 1), 1).rc == MQTTErrorCode.MQTT_ERR_PAYLOAD_SIZE
    assert client.publish(topics.status, "ü" * (most // 2 + 1), 1).rc == MQTTErrorCode.MQTT_ERR_PAYLOAD_SIZE
    fits = client.publish(topics.status, b"x" * most, 1)
    fits.wait_for_publish(10.0)
    client.disconnect()
    client.loop_stop()
    process.kill()
    assert fits.is_published() and lost and not any(each[3].is_failure for each in lost)
    assert len(said) == 1 and f"{topics.status} is not sent: 2001 bytes, and the broker takes 2000" in said[0]


def test_where_somebody_else_says_why_there_never_was_a_connection_only_its_loss_is_said():
    said: list[str] = []
    report = ConnectionLog(Broker(port=1), said.append, first=False)
    report.failed(ConnectionRefusedError(111, "Connection refused"))
    assert report.sentence == "broker 127.0.0.1:1: Connection refused" and said == []
    report.connected(FastClient(CallbackAPIVersion.VERSION2), None)
    report.lost(ReasonCode(PacketTypes.DISCONNECT, "Server shutting down"))
    report.failed(ConnectionRefusedError(111, "Connection refused"))
    assert ["lost" in said[0], "Connection refused" in said[1]] == [True, True]

"""A paho client set up the way this package needs it: MQTT 5 or 3.1.1, TCP_NODELAY, a last will, user properties.

Standard library and paho-mqtt only. Without TCP_NODELAY, traffic in both directions on one connection waits for the peer's
delayed acknowledgement, up to 40 ms.
"""

from __future__ import annotations

import json
import socket
from dataclasses import dataclass

from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.subscribeoptions import SubscribeOptions

from construction_twin.errors import ConfigurationError

_PROTOCOLS = {"5": MQTTProtocolVersion.MQTTv5, "3.1.1": MQTTProtocolVersion.MQTTv311}


@dataclass(frozen=True)
class Broker:
    """Where the broker is and how to talk to it.

    Attributes
    ----------
    host : str
    port : int
    protocol : str
        ``5`` or ``3.1.1``.
    keepalive : int
        [s]
    """

    host: str = "127.0.0.1"
    port: int = 1883
    protocol: str = "5"
    keepalive: int = 5

    def __post_init__(self):
        if self.protocol not in _PROTOCOLS:
            raise ConfigurationError("protocol", self.protocol, "one of " + ", ".join(sorted(_PROTOCOLS)))


def make_client(broker: Broker, client_id: str, will_topic: str) -> paho.Client:
    """Return a client that is not connected yet.

    Parameters
    ----------
    broker : Broker
    client_id : str
    will_topic : str
        Status topic; the broker publishes ``{"state": "offline"}`` there, retained, when the connection is lost.

    Returns
    -------
    client : paho.Client
        Call `connect_async` and a loop on it.
    """
    client = paho.Client(CallbackAPIVersion.VERSION2, client_id=client_id, protocol=_PROTOCOLS[broker.protocol])
    client.will_set(will_topic, json.dumps({"state": "offline", "reason": "connection lost"}), qos=1, retain=True)
    client.on_socket_open = lambda client, userdata, sock: sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    client.reconnect_delay_set(min_delay=1, max_delay=2)
    return client


def subscriptions(client: paho.Client, topics: list[tuple[str, int]]) -> list[tuple[str, int | SubscribeOptions]]:
    """Return topics and their QoS in the form that `client.subscribe` takes, so that a retain flag stays visible.

    Without "retain as published" a broker shows the flag only on what it had stored, not on what is published while we listen.
    MQTT 3.1.1 has no such option.
    """
    if client.protocol != MQTTProtocolVersion.MQTTv5:
        return list(topics)
    return [(topic, SubscribeOptions(qos=qos, retainAsPublished=True)) for topic, qos in topics]


def user_properties(pairs: list[tuple[str, str]]) -> Properties:
    """Return MQTT 5 user properties for a publish."""
    properties = Properties(PacketTypes.PUBLISH)
    properties.UserProperty = pairs
    return properties


def received_pairs(message: paho.MQTTMessage) -> list[tuple[str, str]]:
    """Return a message's user properties; empty under MQTT 3.1.1 or when it has none."""
    return list(getattr(message.properties, "UserProperty", ()))

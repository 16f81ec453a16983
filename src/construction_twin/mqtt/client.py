"""A paho client set up the way this package needs it: MQTT 5 or 3.1.1, TLS, TCP_NODELAY, a last will.

Standard library and paho-mqtt only. Without TCP_NODELAY, traffic in both directions on one connection waits for the peer's
delayed acknowledgement, up to 40 ms.
"""

from __future__ import annotations

import json
import secrets
import socket
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
from paho.mqtt.reasoncodes import ReasonCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.network import is_loopback
from construction_twin.mqtt.account import Account
from construction_twin.mqtt.fast_client import DirectClient, FastClient, is_tested
from construction_twin.mqtt.plain_client import PlainClient

_PROTOCOLS = {"5": MQTTProtocolVersion.MQTTv5, "3.1.1": MQTTProtocolVersion.MQTTv311}


@dataclass(frozen=True)
class Broker:
    """Where the broker is and how to talk to it: `protocol` ``5`` or ``3.1.1``, `keepalive` in s, without an account anonymous.

    Raises:
        ConfigurationError: When the protocol is another one, or a password would cross a network in clear.
    """

    host: str = "127.0.0.1"
    port: int = 1883
    protocol: str = "5"
    keepalive: int = 5
    account: Account | None = None

    def __post_init__(self):
        if self.protocol not in _PROTOCOLS:
            raise ConfigurationError("protocol", self.protocol, f"one of {', '.join(sorted(_PROTOCOLS))}")
        if self.account is not None and not self.encrypted and not is_loopback(self.host):
            expected = f"the CA of {self.host}'s certificate: a password crosses a network in TLS only"
            raise ConfigurationError(f"{self.account.name}: ca_file", "", expected)

    @property
    def encrypted(self) -> bool:
        """True when the connection is TLS."""
        return self.account is not None and bool(self.account.ca_file)


def unique_id(robot: str, role: str) -> str:
    """Return a client id that cannot be guessed: a client that connects with another one's id takes its connection away."""
    return f"{robot}-{role}-{secrets.token_hex(8)}"


#: What the broker says in a client's place when its connection is lost.
OFFLINE = json.dumps({"state": "offline", "reason": "connection lost"})


def offline_word(run: str, connection: int) -> str:
    """Return what the broker says in a client's place when its connection is lost.

    It says so of a run of the client's program, and of one of that run's connections: a broker may notice late that one is lost.
    """
    return json.dumps({"state": "offline", "reason": "connection lost", "run": run, "connection": connection})


def make_client(
    broker: Broker,
    client_id: str,
    will_topic: str,
    will: str = OFFLINE,
    direct: bool = False,
    will_retained: bool = True,
) -> PlainClient:
    """Return a client that is not connected yet: a fast one where the installed paho was tested with it.

    Args:
        client_id: See `unique_id`.
        will_topic: The broker publishes `will` there when the connection is lost.
        will: Empty: the topic's retained message is taken away.
        direct: Send from the thread that publishes, where the socket allows it (not with TLS); for a client served by `loop_start`.
    """
    kind: type[PlainClient] = PlainClient
    if is_tested():
        kind = DirectClient if direct and not broker.encrypted else FastClient
    client = kind(CallbackAPIVersion.VERSION2, client_id=client_id, protocol=_PROTOCOLS[broker.protocol])
    client.will_set(will_topic, will, qos=1, retain=will_retained)
    # the same on a TLS socket: it hands the option to the TCP socket below
    client.on_socket_open = _without_delay
    client.reconnect_delay_set(min_delay=1, max_delay=2)
    if broker.account is not None and broker.account.user:
        client.username_pw_set(broker.account.user, broker.account.password())
    if broker.account is not None and broker.encrypted:
        client.tls_set_context(broker.account.context())
    return client


def _without_delay(client: paho.Client, userdata: object, sock: Any) -> None:
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def watch_answer(client: paho.Client, mid: int, on_refused: Callable[[ReasonCode], None]) -> None:
    """Call `on_refused` with the reason code when the broker's access rules refuse one message that was just published.

    For one message only: a callback for every published message would cost time with each command. MQTT 3.1.1 has no such answer.
    Call this from the thread that serves the client, so that the answer to `mid` cannot be here already.
    """

    def on_publish(client, userdata, answered, reason_code, properties) -> None:
        if answered == mid:
            client.on_publish = None
            if reason_code.is_failure:
                on_refused(reason_code)

    client.on_publish = on_publish


def subscriptions(client: paho.Client, topics: list[tuple[str, int]]) -> list[tuple[str, int | SubscribeOptions]]:
    """Return topics and their QoS in the form that `client.subscribe` takes, so that a retain flag stays visible.

    Without "retain as published" a broker shows the flag only on what it had stored, not on what is published while we listen.
    MQTT 3.1.1 has no such option.
    """
    if client.protocol != MQTTProtocolVersion.MQTTv5:
        return list(topics)
    return [(topic, SubscribeOptions(qos=qos, retainAsPublished=True)) for topic, qos in topics]

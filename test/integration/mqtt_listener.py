"""The newest message of some MQTT topics, and what a broker has retained, for the integration tests."""

from __future__ import annotations

import uuid
from collections.abc import Sequence

from paho.mqtt import client as paho
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion


class MqttListener:
    """Listens on a broker of this machine until `close`."""

    def __init__(self, port: int, topics: Sequence[str]):
        #: Payload of the newest message by topic.
        self.last: dict[str, bytes] = {}
        self._client = paho.Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
        self._client.on_connect = lambda client, *_: [client.subscribe(topic, 0) for topic in topics]
        self._client.on_message = lambda _c, _u, message: self.last.update({message.topic: message.payload})
        self._client.connect_async("127.0.0.1", port)
        self._client.loop_start()

    def close(self) -> None:
        """End the connection."""
        self._client.disconnect()
        self._client.loop_stop()


def retained(port: int) -> dict[str, bytes]:
    """Return the payload of each message that a broker of this machine retains now, by topic; nothing while there is no broker."""
    found: dict[str, bytes] = {}
    client = paho.Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5)
    # what is retained comes before what is published after the subscription
    end, over = f"retained_until/{uuid.uuid4()}", []
    client.on_subscribe = lambda c, *_: c.publish(end, qos=1)

    def take(_client: paho.Client, _data: object, message: paho.MQTTMessage) -> None:
        if message.topic == end:
            over.append(True)
        elif message.retain:
            found[message.topic] = message.payload

    client.on_message = take
    try:
        client.connect("127.0.0.1", port)
    except OSError:
        return {}
    client.subscribe("#", 1)
    while not over and client.loop(1.0) == paho.MQTT_ERR_SUCCESS:
        pass
    client.disconnect()
    return found if over else {}

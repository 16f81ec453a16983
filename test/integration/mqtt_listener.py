"""The newest message of some MQTT topics, for the integration tests."""

from __future__ import annotations

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

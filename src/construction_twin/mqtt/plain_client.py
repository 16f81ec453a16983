"""A paho client that sends and receives streams of joint strings over paho's public interface alone.

Slower than `fast_client` (50 to 100 us more per message), and right with every version of paho 2. Standard library and paho-mqtt
only.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from paho.mqtt import client as paho
from paho.mqtt.enums import MQTTErrorCode, MQTTProtocolVersion
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties

#: How paho begins the name of its thread; the client's id follows.
_PAHO_THREAD = "paho-mqtt-client-"
#: Most that a packet holds beside topic and payload, without properties [bytes].
_AROUND = 10
#: What a stream's callback takes: payload, user properties, whether the message was retained.
StreamCallback = Callable[[bytes, list[tuple[str, str]], bool], None]


def received_pairs(message: paho.MQTTMessage) -> list[tuple[str, str]]:
    """Return a message's user properties; empty under MQTT 3.1.1 or when it has none."""
    return list(getattr(message.properties, "UserProperty", ()))


class PlainClient(paho.Client):
    """A paho client with streams: topics of which many messages come or go per second. It sends nothing that is too large.

    Attributes:
        largest: Longest packet that the broker takes, as it said last [bytes]; None: any.
        on_too_large: Takes the sentence about a longer one, once per topic.
    """

    largest: int | None = None
    on_too_large: Callable[[str], object] | None = None

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self._too_large: set[str] = set()

    def publish(self, topic, payload=None, qos=0, retain=False, properties=None) -> paho.MQTTMessageInfo:
        """Publish as paho does; what is too large for the broker gets `MQTT_ERR_PAYLOAD_SIZE`."""
        if self.largest is not None:
            content = payload.encode() if isinstance(payload, str) else payload or b""
            beside = len(properties.pack()) if properties else 0
            if self.is_too_large(topic, len(topic.encode()) + len(content) + beside + _AROUND):
                info = paho.MQTTMessageInfo(0)
                info.rc = MQTTErrorCode.MQTT_ERR_PAYLOAD_SIZE
                return info
        return super().publish(topic, payload, qos, retain, properties)

    def is_too_large(self, topic: str, size: int) -> bool:
        """Return whether a packet [bytes] is longer than what the broker takes, and say so the first time."""
        if self.largest is None or size <= self.largest:
            return False
        if topic not in self._too_large and self.on_too_large is not None:
            self._too_large.add(topic)
            self.on_too_large(
                f"{topic} is not sent: {size} bytes, and the broker takes {self.largest} (its max_packet_size)"
            )
        return True

    def loop_start(self) -> MQTTErrorCode:
        """Serve the connection in a thread of paho's."""
        result = super().loop_start()
        for thread in threading.enumerate():
            # with paho's name a traceback would write the client's id into a log
            if thread.name.startswith(_PAHO_THREAD):
                thread.name = "mqtt"
        return result

    def on_stream(self, topic: str, callback: StreamCallback) -> None:
        """Call ``callback(payload, pairs, retained)`` in the thread that serves the connection for each message on `topic`.

        `pairs` are the user properties; the topic has no wildcards.
        """
        self.message_callback_add(
            topic,
            lambda client, data, message: callback(bytes(message.payload), received_pairs(message), message.retain),
        )

    def send_stream(self, topic: str, payload: bytes, pairs: list[tuple[str, str]] | None = None) -> None:
        """Publish with QoS 0; while there is no connection the message is dropped. MQTT 3.1.1 has no user properties."""
        properties = None
        if pairs and self.protocol == MQTTProtocolVersion.MQTTv5:
            properties = Properties(PacketTypes.PUBLISH)
            properties.UserProperty = pairs
        self.publish(topic, payload, 0, False, properties)

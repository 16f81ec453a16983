"""A paho client for 250 messages a second each way, without what a joint string does not need.

Standard library and paho-mqtt only. What it saves per message, measured on its own: paho builds a table of all MQTT 5
properties for each message it sends or receives (25 and 50 us), and hands what another thread publishes to its own thread.
"""

from __future__ import annotations

import struct
import threading

from paho.mqtt import client as paho
from paho.mqtt.enums import MQTTErrorCode, MQTTProtocolVersion

_USER_PROPERTY = 0x26
_LENGTH = struct.Struct("!H")
#: The loop looks after a connection that another thread has found lost at least this often [s].
_LOOP_TIMEOUT = 0.1


class UserProperties:
    """User properties as paho's `publish` takes them and as a received message has them, and no others.

    Parameters
    ----------
    pairs : list of (str, str)
    """

    __slots__ = ("UserProperty",)

    def __init__(self, pairs: list[tuple[str, str]]):
        self.UserProperty = pairs

    def pack(self) -> bytes:
        """Return their bytes in a packet, with the length before them."""
        parts = []
        for pair in self.UserProperty:
            parts.append(b"\x26")
            for text in pair:
                data = text.encode()
                parts += (_LENGTH.pack(len(data)), data)
        packed = b"".join(parts)
        return _variable_length(len(packed)) + packed

    def __repr__(self) -> str:
        return f"UserProperties({self.UserProperty})"


def _variable_length(value: int) -> bytes:
    digits = bytearray()
    while value > 127:
        digits.append(value & 127 | 128)
        value >>= 7
    digits.append(value)
    return bytes(digits)


def read_plain(packet: bytes) -> tuple[bytes, UserProperties, bytes] | None:
    """Return topic, properties and payload of an MQTT 5 PUBLISH of QoS 0.

    Parameters
    ----------
    packet : bytes
        All that follows the fixed header.

    Returns
    -------
    parts : tuple or None
        None when there is anything in it but at most 127 bytes of user properties in printable ASCII: paho may look at it.
    """
    start = 2 + int.from_bytes(packet[:2], "big")
    if start >= len(packet) or packet[start] > 127 or start + 1 + packet[start] > len(packet):
        return None
    at, end, pairs = start + 1, start + 1 + packet[start], []
    while at < end:
        if packet[at] != _USER_PROPERTY:
            return None
        name, at = _text(packet, at + 1, end)
        value, at = _text(packet, at, end)
        if name is None or value is None:
            return None
        pairs.append((name, value))
    return bytes(packet[2:start]), UserProperties(pairs), bytes(packet[end:])


def _text(packet: bytes, at: int, end: int) -> tuple[str | None, int]:
    begin = at + 2
    stop = begin + int.from_bytes(packet[at:begin], "big")
    data = packet[begin:stop]
    if stop > end or begin > end or not data.isascii():
        return None, end
    text = data.decode("ascii")
    return (text if text.isprintable() else None), stop


class FastClient(paho.Client):
    """Reads joint strings without paho's general parser, whatever else comes in with it."""

    def _handle_publish(self) -> MQTTErrorCode:
        # paho has no public place for this; test_fast_client compares the outcome with paho's own
        header = self._in_packet["command"]
        plain = None
        if self._protocol == MQTTProtocolVersion.MQTTv5 and not header & 0x0E:
            plain = read_plain(self._in_packet["packet"])
        if plain is None:
            return super()._handle_publish()
        message = paho.MQTTMessage(topic=plain[0])
        message.retain = bool(header & 1)
        _, message.properties, message.payload = plain
        self._handle_on_message(message)
        return MQTTErrorCode.MQTT_ERR_SUCCESS


class DirectClient(FastClient):
    """Serves the connection in a thread, and sends from the thread that publishes instead of waking that one.

    For sockets without TLS: Python's TLS sockets are not made for one thread that reads and another that writes.
    """

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self._writing = threading.RLock()
        self._server: threading.Thread | None = None

    def loop_start(self) -> MQTTErrorCode:
        """Connect, and serve the connection until `disconnect`; with paho's own `loop_start` only its thread would send."""
        options = {"timeout": _LOOP_TIMEOUT, "retry_first_connection": True}
        self._server = threading.Thread(target=self.loop_forever, kwargs=options, name="mqtt", daemon=True)
        self._server.start()
        return MQTTErrorCode.MQTT_ERR_SUCCESS

    def loop_stop(self) -> MQTTErrorCode:
        """Wait for the thread, after `disconnect`; at most 2 s, while it tries to connect."""
        if self._server is not None:
            self._server.join(2.0)
        return MQTTErrorCode.MQTT_ERR_SUCCESS

    def loop_write(self) -> MQTTErrorCode:
        """Send what is queued; one thread at a time, so that packets keep their order and are never mixed."""
        with self._writing:
            return super().loop_write()

"""A paho client that sends and reads joint strings by a shorter code path, with private parts of the tested paho.

Per message paho builds a table of all MQTT 5 properties (25 and 50 us), reads a packet in three pieces, keeps a record with a lock
of each that it sends, and hands what another thread publishes to its own.
"""

from __future__ import annotations

import socket
import struct
import threading
import time
from collections.abc import Callable

from paho.mqtt import __version__ as paho_version
from paho.mqtt import client as paho
from paho.mqtt.enums import MQTTErrorCode
from paho.mqtt.properties import VariableByteIntegers

from construction_twin.core.errors import ConfigurationError

#: Versions of paho-mqtt with which the tests of this module have passed; setup/requirements.txt pins the last one.
TESTED_VERSIONS = ("2.2.0",)
#: What a stream's callback takes: payload, user properties, whether the message was retained.
StreamCallback = Callable[[bytes, list[tuple[str, str]], bool], None]
#: Most that a packet holds beside topic and payload, without properties [bytes].
_AROUND = 10
_USER_PROPERTY = 0x26
_LENGTH = struct.Struct("!H")
#: How much of what has come in is read before it is taken from the socket; a longer packet is left to paho [bytes].
_AHEAD = 2048
#: The loop notices a connection that another thread has found lost within this time [s].
_LOOP_TIMEOUT = 0.1


class UserProperties:
    """User properties and no others, as paho's `publish` takes them and a received message has them."""

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
        return VariableByteIntegers.encode(len(packed)) + packed


def read_plain(packet: bytes) -> tuple[bytes, UserProperties, bytes] | None:
    """Split the body of a PUBLISH of QoS 0 into topic, user properties (ASCII, at most 127 bytes) and payload; None: for paho."""
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


def publish_span(ahead: bytes) -> tuple[int, int] | None:
    """Return begin and end of the body of a complete PUBLISH of QoS 0 below 16 kB; None: anything else."""
    if len(ahead) < 3 or ahead[0] & 0xFE != paho.PUBLISH:
        return None
    start, length = 2, ahead[1]
    if length > 127:
        if ahead[2] > 127:
            return None
        start, length = 3, (length & 127) | ahead[2] << 7
    return (start, start + length) if start + length <= len(ahead) else None


def check_paho() -> None:
    """Raise ConfigurationError where the installed paho was not tested: its private parts may be others."""
    if paho_version not in TESTED_VERSIONS:
        raise ConfigurationError("paho-mqtt", paho_version, f"version {' or '.join(TESTED_VERSIONS)}: install that one")


def received_pairs(message: paho.MQTTMessage) -> list[tuple[str, str]]:
    """Return a message's user properties."""
    return list(getattr(message.properties, "UserProperty", ()))


class FastClient(paho.Client):
    """A client with streams: topics of which many messages come or go per second.

    Attributes:
        largest: Longest packet that the broker takes [bytes]; it would hang up on a longer one. None: any.
        on_too_large: Logs a longer one, once per topic.
    """

    largest: int | None = None
    on_too_large: Callable[[str], object] = print

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self._too_large: set[str] = set()
        self._streams: dict[bytes, StreamCallback] = {}
        self._writing = threading.RLock()

    def publish(self, topic, payload=None, qos=0, retain=False, properties=None) -> paho.MQTTMessageInfo:
        """Publish as paho does; what is too large for the broker gets `MQTT_ERR_PAYLOAD_SIZE`."""
        content = payload.encode() if isinstance(payload, str) else payload or b""
        size = len(topic.encode()) + len(content) + _AROUND
        if self.largest is None or size <= self.largest:
            return super().publish(topic, payload, qos, retain, properties)
        if topic not in self._too_large:
            self._too_large.add(topic)
            self.on_too_large(
                f"{topic} is not sent: {size} bytes, and the broker takes {self.largest} (max_packet_size)"
            )
        info = paho.MQTTMessageInfo(0)
        info.rc = MQTTErrorCode.MQTT_ERR_PAYLOAD_SIZE
        return info

    def loop_start(self) -> MQTTErrorCode:
        """Serve the connection in a thread of paho's."""
        result = super().loop_start()
        if self._thread is not None:
            # with paho's name a traceback would write the client's id into a log
            self._thread.name = "mqtt"
        return result

    def on_stream(self, topic: str, callback: StreamCallback) -> None:
        """Call ``callback(payload, user properties, retained)`` for each message on `topic`, in the connection's thread."""
        self._streams[topic.encode()] = callback
        # what is left to paho, as a message with other properties
        self.message_callback_add(
            topic,
            lambda client, data, message: callback(bytes(message.payload), received_pairs(message), message.retain),
        )

    def send_stream(self, topic: str, payload: bytes, pairs: list[tuple[str, str]] | None = None) -> None:
        """Publish with QoS 0, from the caller's thread unless paho has one of its own; dropped without a connection."""
        name = topic.encode()
        body = _LENGTH.pack(len(name)) + name + (UserProperties(pairs).pack() if pairs else b"\0") + payload
        packet = b"\x30" + VariableByteIntegers.encode(len(body)) + body
        with self._writing:
            sock = self._sock
            if sock is None:
                return
            if self._thread is not None or self._out_packet:
                # with `loop_start` of paho only its thread sends: two threads must not use one TLS socket
                self._packet_queue(paho.PUBLISH, packet, 0, 0, paho.MQTTMessageInfo(0))
                return
            try:
                sent = sock.send(packet)
            except OSError:
                # full, or lost: paho finds the same below, and handles it
                sent = 0
            if sent == len(packet):
                with self._msgtime_mutex:
                    self._last_msg_out = time.monotonic()
                return
            self._send_rest(packet, sent)

    def _send_rest(self, packet: bytes, sent: int) -> None:
        # before what other threads have queued since: a packet that was begun is sent to its end first
        info = paho.MQTTMessageInfo(0)
        self._out_packet.appendleft(
            {
                "command": paho.PUBLISH,
                "mid": 0,
                "qos": 0,
                "pos": sent,
                "to_process": len(packet) - sent,
                "packet": packet,
                "info": info,
            }
        )
        # a callback must not find the connection lost while paho calls it; the loop goes on then
        if self._in_callback_mutex.acquire(False):
            self._in_callback_mutex.release()
            self.loop_write()

    def loop_write(self) -> MQTTErrorCode:
        """Send what is queued; one thread at a time, so that packets keep their order and are never mixed."""
        with self._writing:
            return super().loop_write()

    def _packet_read(self) -> MQTTErrorCode:
        """Read the next packet in one piece where it is a joint string; leave others to paho."""
        sock: object = self._sock
        # only a TCP socket shows bytes without taking them; a TLS socket does not
        if type(sock) is not socket.socket or self._in_packet["command"]:
            return super()._packet_read()
        try:
            ahead = sock.recv(_AHEAD, socket.MSG_PEEK)
        except OSError:
            return super()._packet_read()
        span = publish_span(ahead)
        plain = read_plain(ahead[span[0] : span[1]]) if span is not None else None
        if span is None or plain is None:
            return super()._packet_read()
        try:
            sock.recv(span[1])
        except OSError:
            # closed meanwhile by a thread that could not send
            return super()._packet_read()
        self._deliver(plain, bool(ahead[0] & 1))
        with self._msgtime_mutex:
            self._last_bytes_received = time.monotonic()
        return MQTTErrorCode.MQTT_ERR_SUCCESS

    def _handle_publish(self) -> MQTTErrorCode:
        header = self._in_packet["command"]
        plain = None if header & 0x0E else read_plain(bytes(self._in_packet["packet"]))
        if plain is None:
            return super()._handle_publish()
        self._deliver(plain, bool(header & 1))
        return MQTTErrorCode.MQTT_ERR_SUCCESS

    def _deliver(self, plain: tuple[bytes, UserProperties, bytes], retained: bool) -> None:
        topic, properties, payload = plain
        callback = self._streams.get(topic)
        if callback is not None:
            callback(payload, properties.UserProperty, retained)
            return
        message = paho.MQTTMessage(topic=topic)
        message.retain, message.payload = retained, payload
        message.properties = properties  # type: ignore[assignment]  # has what paho's users read of it: UserProperty
        self._handle_on_message(message)


class DirectClient(FastClient):
    """Serves the connection in a thread, and sends from the thread that publishes; without TLS, which needs one thread for both."""

    def __init__(self, *arguments, **options):
        super().__init__(*arguments, **options)
        self._server: threading.Thread | None = None

    def _loop_rc_handle(self, rc: MQTTErrorCode) -> MQTTErrorCode:
        # the thread that serves the connection finds a loss too, and handles it: a sending thread would call `on_disconnect` with
        # paho's locks in another order, and maybe after the next connection is there
        return super()._loop_rc_handle(rc) if threading.current_thread() is self._server else rc

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

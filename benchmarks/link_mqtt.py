"""The MQTT end of the link benchmark: the smallest MQTT 5 client that can measure, so that the figures are the bridge's.

QoS 0 only, one thread, one socket with TCP_NODELAY.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator


def _text(text: bytes) -> bytes:
    return struct.pack("!H", len(text)) + text


def _varint(value: int) -> bytes:
    digits = bytearray()
    while True:
        value, digit = divmod(value, 128)
        digits.append(digit | (0x80 if value else 0))
        if not value:
            return bytes(digits)


def read_varint(data: bytes | bytearray, at: int) -> tuple[int, int] | None:
    """Return value and position after it, None while its bytes are not there yet."""
    value = shift = 0
    while at < len(data):
        byte = data[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at
    return None


def publish_packet(topic: str, payload: bytes, pairs: list[tuple[str, str]] = (), retain: bool = False) -> bytes:
    """Return a PUBLISH packet of QoS 0 with user properties."""
    properties = b"".join(b"\x26" + _text(name.encode()) + _text(value.encode()) for name, value in pairs)
    body = _text(topic.encode()) + _varint(len(properties)) + properties + payload
    return bytes([0x30 | retain]) + _varint(len(body)) + body


def read_publish(body: bytes) -> tuple[str, bytes, list[tuple[str, str]]]:
    """Return topic, payload and user properties of a PUBLISH of QoS 0; other properties are not expected here."""
    end = 2 + struct.unpack_from("!H", body)[0]
    length, at = read_varint(body, end)
    pairs, stop = [], at + length
    while at < stop:
        if body[at] != 0x26:
            raise ValueError(f"property {body[at]:#x} is not a user property")
        pair = []
        at += 1
        for _ in range(2):
            size = struct.unpack_from("!H", body, at)[0]
            pair.append(body[at + 2 : at + 2 + size].decode())
            at += 2 + size
        pairs.append(tuple(pair))
    return body[2:end].decode(), body[stop:], pairs


class MqttEnd:
    """A connection to the broker.

    Args:
        port: Of the broker on this machine.
        name: Client id.
        topics: Subscribed to.
    """

    def __init__(self, port: int, name: str, topics: list[str]):
        self.socket = socket.create_connection(("127.0.0.1", port))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._data = bytearray()
        self._send(0x10, _text(b"MQTT") + b"\x05\x02\x00\x00\x00" + _text(name.encode()))
        self._expect(0x20)
        self._send(0x82, b"\x00\x01\x00" + b"".join(_text(topic.encode()) + b"\x00" for topic in topics))
        self._expect(0x90)

    def publish(self, packet: bytes) -> None:
        """Send a packet of `publish_packet`; waits while the broker takes no more."""
        self.socket.sendall(packet)

    def receive(self) -> Iterator[bytes]:
        """Read once, and return the PUBLISH packets that are complete now, without their fixed headers."""
        for kind, body in self._packets():
            if kind & 0xF0 == 0x30:
                yield body

    def close(self) -> None:
        """Leave the broker."""
        self._send(0xE0, b"")
        self.socket.close()

    def _send(self, kind: int, body: bytes) -> None:
        self.socket.sendall(bytes([kind]) + _varint(len(body)) + body)

    def _expect(self, kind: int) -> None:
        for found, _ in self._packets():
            if found == kind:
                return
        raise ConnectionError(f"the broker did not answer with packet {kind:#x}")

    def _packets(self) -> Iterator[tuple[int, bytes]]:
        data = self.socket.recv(65536)
        if not data:
            raise ConnectionError("the broker has closed the connection")
        self._data += data
        while len(self._data) > 1 and (header := read_varint(self._data, 1)):
            length, at = header
            if len(self._data) < at + length:
                return
            kind, body = self._data[0], bytes(self._data[at : at + length])
            del self._data[: at + length]
            yield kind, body

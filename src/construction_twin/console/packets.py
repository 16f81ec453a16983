"""MQTT packets as far as the pipe has to know them: where each ends, of which kind it is, and who logs in.

Only the fixed header is read, and of CONNECT and CONNACK the few fields that are logged or decide whether somebody is logged in.
MQTT 5.0, sections 2.1, 3.1 and 3.2; MQTT 3.1.1 has the same. Pure.
"""

from __future__ import annotations

from dataclasses import dataclass

from construction_twin.core.errors import PayloadError
from construction_twin.core.sentences import Sentence

CONNECT, CONNACK, PUBLISH, DISCONNECT = 1, 2, 3, 14
#: Answers to a login by which the broker says that account or password is wrong: MQTT 3.1.1, 3.2.2.3, and MQTT 5.0, 3.2.2.2.
WRONG_PASSWORD = frozenset((4, 5, 134, 135))
#: What a client may send: CONNECT, PUBLISH, PUBACK, PUBREC, PUBREL, PUBCOMP, SUBSCRIBE, UNSUBSCRIBE, PINGREQ, DISCONNECT, AUTH.
FROM_CLIENT = frozenset((1, 3, 4, 5, 6, 7, 8, 10, 12, 14, 15))
#: The reserved flags of each of them that are not 0.
_FLAGS = {6: 2, 8: 2, 10: 2}
_LONGEST_LENGTH = 4
#: Most packets that are read at once: more of them in one frame would keep the other connections waiting.
_MOST = 2000


@dataclass(frozen=True, slots=True)
class Packet:
    """One MQTT packet.

    Attributes:
        kind: Type of the control packet.
        data: All of it, with its fixed header.
        body: Where its variable header begins in `data`.
    """

    kind: int
    data: bytes
    body: int


class PacketReader:
    """Cuts a stream of bytes into packets.

    Args:
        largest: Longest packet that is read [bytes].
        from_client: The first byte of each must be one that a client sends. It is refused before the rest has come.
    """

    def __init__(self, largest: int, from_client: bool = False):
        self._largest = largest
        self._from_client = from_client
        self._rest = bytearray()

    def feed(self, data: bytes) -> list[Packet]:
        """Take bytes; return the packets that are complete now.

        Raises:
            PayloadError: ``mqtt`` for a first byte or a length that is none of MQTT, ``size`` for a packet that is too long, or too
                many at once.
        """
        self._rest += data
        packets = []
        while (packet := self._next()) is not None:
            packets.append(packet)
            if len(packets) > _MOST:
                raise PayloadError("size", Sentence("view.packet.many", most=_MOST))
        return packets

    def first(self, data: bytes) -> Packet | None:
        """Take bytes; return the first packet once it is complete. What comes behind it is not read, and may be of any length.

        Raises:
            PayloadError: As `feed`.
        """
        self._rest += data
        return self._next()

    def _next(self) -> Packet | None:
        rest = self._rest
        if rest and self._from_client and not _is_from_client(rest[0]):
            raise PayloadError("mqtt", Sentence("view.packet.first_byte", byte=f"{rest[0]:02x}"))
        length, shift, at = 0, 0, 1
        while True:
            if at >= len(rest):
                return None
            byte = rest[at]
            length |= (byte & 0x7F) << shift
            at, shift = at + 1, shift + 7
            if not byte & 0x80:
                break
            if at > _LONGEST_LENGTH:
                raise PayloadError("mqtt", Sentence("view.packet.length"))
        if at + length > self._largest:
            raise PayloadError("size", Sentence("view.packet.large", bytes=at + length, most=self._largest))
        if len(rest) < at + length:
            return None
        packet = Packet(rest[0] >> 4, bytes(rest[: at + length]), at)
        del rest[: at + length]
        return packet


def _is_from_client(first: int) -> bool:
    kind, flags = first >> 4, first & 0x0F
    return kind in FROM_CLIENT and (kind == PUBLISH or flags == _FLAGS.get(kind, 0))


class ClientStream:
    """What a browser sends: CONNECT first and once, then only what a client may send.

    Args:
        largest: Longest packet [bytes].

    Attributes:
        account: User name of CONNECT; "" before it, and for an anonymous client.
        anonymous: CONNECT has neither user name nor password, or has not come.
        connected: CONNECT has come.
        ended: DISCONNECT has come: the broker hangs up next, and that is no fault.
    """

    def __init__(self, largest: int):
        self._reader = PacketReader(largest, from_client=True)
        self.account = ""
        self.anonymous = True
        self.connected = False
        self.ended = False

    def feed(self, data: bytes) -> list[Packet]:
        """Take bytes; return the packets that may pass.

        Raises:
            PayloadError: ``mqtt`` or ``size``; nothing of what came may pass then.
        """
        packets = self._reader.feed(data)
        for packet in packets:
            if (packet.kind == CONNECT) == self.connected:
                found = (
                    Sentence("view.packet.second_connect")
                    if self.connected
                    else Sentence("view.packet.kind", kind=packet.kind)
                )
                raise PayloadError("mqtt", Sentence("view.packet.one_connect", found=found))
            if packet.kind == CONNECT:
                self.account, self.anonymous = user_name(packet), not has_credentials(packet)
                self.connected = True
            self.ended = self.ended or packet.kind == DISCONNECT
        return packets


def user_name(connect: Packet) -> str:
    """Return the user name of a CONNECT packet, "" when it has none.

    Raises:
        PayloadError: ``mqtt`` when it is not a CONNECT of MQTT 3.1.1 or 5.
    """
    fields = _Fields(connect.data, connect.body)
    if fields.text() != "MQTT" or (version := fields.byte()) not in (4, 5):
        raise PayloadError("mqtt", Sentence("view.packet.protocol"))
    flags = fields.byte()
    fields.skip(2)
    if version == 5:
        fields.skip(fields.number())
    fields.text()
    if flags & 0x04:
        if version == 5:
            fields.skip(fields.number())
        fields.text()
        fields.skip(fields.short())
    return fields.text() if flags & 0x80 else ""


def has_credentials(connect: Packet) -> bool:
    """Return whether a CONNECT that `user_name` can read has a user name, a password, or both."""
    # behind the name of the protocol, with its length, and the version
    return bool(connect.data[connect.body + 7] & 0xC0)


def reason_code(connack: Packet) -> int | None:
    """Return the broker's answer to a login, 0 when the client is logged in; None when the packet is none."""
    if connack.kind != CONNACK or len(connack.data) < connack.body + 2:
        return None
    return connack.data[connack.body + 1]


class _Fields:
    """Reads the fields of a packet one after the other."""

    def __init__(self, data: bytes, at: int):
        self._data = data
        self.at = at

    def _take(self, count: int) -> bytes:
        end = self.at + count
        if end > len(self._data):
            raise PayloadError("mqtt", Sentence("view.packet.short"))
        taken, self.at = self._data[self.at : end], end
        return taken

    def skip(self, count: int) -> None:
        """Pass over bytes."""
        self._take(count)

    def byte(self) -> int:
        """Return one byte as a number."""
        return self._take(1)[0]

    def short(self) -> int:
        """Return a number of two bytes."""
        return int.from_bytes(self._take(2), "big")

    def number(self) -> int:
        """Return a number of one to four bytes, seven bits in each (MQTT 5.0, section 1.5.5)."""
        value, shift = 0, 0
        while True:
            byte = self.byte()
            value |= (byte & 0x7F) << shift
            if not byte & 0x80:
                return value
            shift += 7
            if shift > 21:
                raise PayloadError("mqtt", Sentence("view.packet.connect_length"))

    def data(self) -> bytes:
        """Return bytes with their length before them."""
        return self._take(self.short())

    def text(self) -> str:
        """Return a text with its length before it."""
        try:
            return self.data().decode()
        except UnicodeDecodeError as error:
            raise PayloadError("mqtt", Sentence("view.packet.text")) from error

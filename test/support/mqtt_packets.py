"""MQTT packets, byte by byte: what no client library would send, too."""

from __future__ import annotations


def text(value: str) -> bytes:
    return len(value.encode()).to_bytes(2, "big") + value.encode()


def packet(kind: int, body: bytes = b"", flags: int = 0) -> bytes:
    length, digits = len(body), b""
    while True:
        length, digit = divmod(length, 128)
        digits += bytes([digit | (0x80 if length else 0)])
        if not length:
            return bytes([kind << 4 | flags]) + digits + body


def connect(user: str = "", version: int = 5, will: bool = False, client: str = "client") -> bytes:
    flags = (0x80 if user else 0) | (0x04 if will else 0)
    body = text("MQTT") + bytes([version, flags]) + b"\0\x0a" + (b"\0" if version == 5 else b"") + text(client)
    if will:
        body += (b"\0" if version == 5 else b"") + text("a/topic") + text("gone")
    return packet(1, body + (text(user) if user else b""))

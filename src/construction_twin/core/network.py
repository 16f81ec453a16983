"""Addresses and ports of this machine, and UDP sockets that tell each datagram's time of arrival.

Standard library only, Windows included.
"""

from __future__ import annotations

import ipaddress
import socket
import struct
import sys
import time

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError

#: Largest telegram [bytes]. With every block declared a KR C4's exceeds 1 kB (docs/rsi.md, section 2) and stays below 2 kB; what is
#: longer than this is none, and taking it apart would only keep the loop that answers.
MAX_TELEGRAM = 8192
#: Linux: ask the kernel for each datagram's time of arrival, so that the reply time includes waiting for the processor. Python has
#: no name for it; 35 on x86 and ARM, 64 bit.
_SO_TIMESTAMPNS = 35
#: Windows: reading into less than the datagram is an error there, so there is room for any [bytes].
_LARGEST_DATAGRAM = 65535


def bind(host: str, port: int) -> socket.socket:
    """Return a UDP socket bound for RSI; ConstructionTwinError when the port is taken or the address is not ours."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.bind((host, port))
    except OSError as error:
        sock.close()
        raise ConstructionTwinError(
            f"cannot listen for RSI on UDP {host}:{port}: {error.strerror}; another gateway (or KUKA's "
            "TestServer) may hold the port, or the address is not this machine's"
        ) from error
    sock.setblocking(False)
    enable_timestamps(sock)
    return sock


def enable_timestamps(sock: socket.socket) -> bool:
    """Enable the kernel's arrival stamps for `receive`; return whether there are any (Linux)."""
    if sys.platform != "linux":
        return False
    sock.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    return True


def address_of(host: str, option: str) -> str:
    """Return the one IPv4 address of a host, to be compared with a datagram's source."""
    try:
        found = {str(entry[4][0]) for entry in socket.getaddrinfo(host, None, socket.AF_INET, socket.SOCK_DGRAM)}
    except (OSError, ValueError) as error:
        expected = f"an IPv4 address, or a name that this machine can look up ({error})"
        raise ConfigurationError(option, host, expected) from error
    if len(found) > 1:
        expected = f"one address; the name stands for {', '.join(sorted(found))}, give the one that RSI comes from"
        raise ConfigurationError(option, host, expected)
    return found.pop()


def receive(sock: socket.socket) -> tuple[bytes, int, tuple]:
    """Read one datagram: data (too long: just enough to be refused), arrival on the wall clock [ns], sender.

    BlockingIOError: there is none; another OSError is what the system reports, e.g. "port unreachable" for a reply.
    """
    if not hasattr(sock, "recvmsg"):  # Windows
        data, source = sock.recvfrom(_LARGEST_DATAGRAM)
        return data, time.time_ns(), source
    data, ancillary, _, source = sock.recvmsg(MAX_TELEGRAM + 1, 64)
    return data, _arrival(ancillary), source


def _arrival(ancillary) -> int:
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_TIMESTAMPNS:
            seconds, nanoseconds = struct.unpack("qq", data[:16])
            return seconds * 1_000_000_000 + nanoseconds
    return time.time_ns()


def is_loopback(host: str) -> bool:
    """Return whether `host` is a loopback address, or ``localhost``."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def port_is_free(kind: socket.SocketKind, port: int, host: str = "127.0.0.1") -> bool:
    """Return whether a socket of this kind (SOCK_STREAM or SOCK_DGRAM) could be bound to `port` on an address of this machine."""
    with socket.socket(socket.AF_INET, kind) as probe:
        if kind is socket.SOCK_STREAM:
            # a listener blocks the port, a connection that was closed a moment ago does not
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError:
            return False
    return True

"""Addresses and ports of this machine. Standard library only."""

from __future__ import annotations

import ipaddress
import socket


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

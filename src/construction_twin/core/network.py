"""Addresses and ports of this machine. Standard library only."""

from __future__ import annotations

import ipaddress
import os
import socket
from pathlib import Path

#: Linux: the state of a listening socket in /proc/<pid>/net/tcp.
_LISTEN = "0A"


def is_loopback(host: str) -> bool:
    """Return whether `host` is this machine itself, reached from nowhere else; of all names only ``localhost`` is known to be."""
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


def listening_ports(pid: int, or_any: bool = False) -> set[int]:
    """Return the TCP ports on which a process of this machine listens; empty for one that has ended.

    Args:
        or_any: Of a process whose files nobody but root may see (another user's, or a program with capabilities of its own): the
            ports on which any process listens; else none.
    """
    try:
        links = [os.readlink(entry.path) for entry in os.scandir(f"/proc/{pid}/fd")]
        rows = [row.split() for name in ("tcp", "tcp6") for row in _lines(f"/proc/{pid}/net/{name}")]
    except PermissionError:
        rows = [row.split() for name in ("tcp", "tcp6") for row in _lines(f"/proc/net/{name}")] if or_any else []
        return {_port(row) for row in rows if row[3] == _LISTEN}
    except OSError:
        return set()
    inodes = {link[len("socket:[") : -1] for link in links if link.startswith("socket:[")}
    return {_port(row) for row in rows if row[3] == _LISTEN and row[9] in inodes}


def _port(row: list[str]) -> int:
    return int(row[1].rpartition(":")[2], 16)


def _lines(path: str) -> list[str]:
    """Return the rows below the headline of a table of the kernel's; none where the kernel has no such table."""
    return Path(path).read_text().splitlines()[1:] if os.path.exists(path) else []

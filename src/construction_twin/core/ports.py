"""Is a port of the loopback interface free? Standard library only."""

from __future__ import annotations

import socket


def port_is_free(kind: socket.SocketKind, port: int) -> bool:
    """Return whether a socket of this kind (SOCK_STREAM or SOCK_DGRAM) could be bound to `port` on 127.0.0.1."""
    with socket.socket(socket.AF_INET, kind) as probe:
        if kind is socket.SOCK_STREAM:
            # a listener is in the way, a connection that was closed a moment ago is not
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
    return True

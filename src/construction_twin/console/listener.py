"""Listening sockets that count what they accept: a connection that never ends its TLS handshake is known to nobody else."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
from collections.abc import Callable
from typing import Any

from construction_twin.console.connection_limits import OpenConnections

#: Connections that the kernel keeps until they are accepted.
_BACKLOG = 100


class _Counted(socket.socket):
    """An accepted connection, which leaves its place when it is closed."""

    on_close: Callable[[int], None] | None = None

    def close(self) -> None:
        """Close it, and leave its place."""
        # the number is free for the next one as soon as it is closed
        if self.on_close is not None and self.fileno() >= 0:
            self.on_close(self.fileno())
        super().close()


class Listener(socket.socket):
    """A TCP socket that gives what it accepts a place, by its file descriptor.

    Args:
        family: Of its address.
        on_full: Called with the address of a connection whose place another one gets.
    """

    def __init__(
        self,
        family: int,
        connections: OpenConnections,
        on_full: Callable[[str], None],
    ):
        super().__init__(family, socket.SOCK_STREAM)
        self._limits = connections
        self._on_full = on_full
        self._open: dict[int, _Counted] = {}

    def accept(self) -> tuple[socket.socket, Any]:
        """Return the next connection and its address (called by asyncio); the oldest client may have to end for it."""
        accepted, address = super().accept()
        connection = _Counted(fileno=accepted.detach())
        number = connection.fileno()
        connection.on_close = self._leave
        self._open[number] = connection
        oldest = self._limits.enter(number, address[0])
        if oldest is not None and oldest in self._open:
            self._end(self._open[oldest])
        return connection, address

    def _end(self, connection: socket.socket) -> None:
        # a peer that has just gone has no address
        with contextlib.suppress(OSError):
            self._on_full(connection.getpeername()[0])
            # its transport, or its TLS handshake, sees the end and closes it
            connection.shutdown(socket.SHUT_RDWR)

    def _leave(self, number: int) -> None:
        del self._open[number]
        self._limits.leave(number)


async def listeners(
    host: str,
    port: int,
    connections: OpenConnections,
    on_full: Callable[[str], None],
) -> list[Listener]:
    """Return a listening socket for each address of a host.

    Args:
        on_full: As of `Listener`.

    Raises:
        OSError: When there is no such address, or somebody else holds the port.
    """
    found = await asyncio.get_running_loop().getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
    made: list[Listener] = []
    with contextlib.ExitStack() as undo:
        for family, address in dict.fromkeys((each[0], each[4]) for each in found):
            try:
                made.append(undo.enter_context(Listener(family, connections, on_full)))
            except OSError as error:
                # localhost has an address of IPv6 where the kernel has none
                if error.errno != errno.EAFNOSUPPORT or family != socket.AF_INET6:
                    raise
                continue
            made[-1].setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            if family == socket.AF_INET6:
                made[-1].setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            made[-1].bind(address)
            made[-1].setblocking(False)
            made[-1].listen(_BACKLOG)
        undo.pop_all()
    return made

"""One TCP connection, which has to ask for something soon, and on which a request can be answered without the library."""

from __future__ import annotations

import asyncio

from websockets.asyncio.server import ServerConnection
from websockets.protocol import State

_END_OF_REQUEST = b"\r\n\r\n"


class HttpConnection(ServerConnection):
    """A connection of the library on which a request can also be answered without it.

    Until a request is answered, whatever a client sends behind it is forgotten: the library would keep all of it, and take it for
    frames of a WebSocket.
    """

    _ending = b""
    #: The peer has half-closed the connection: it sends no more, and may still read.
    half_closed = False
    written = False
    #: Of the browser, once its request for a WebSocket is answered.
    ticket = ""

    @property
    def is_asking(self) -> bool:
        """True between the end of the request and the answer of the library, which is that there is a WebSocket."""
        return self.request is not None and self.state is State.CONNECTING

    def data_received(self, data: bytes) -> None:
        """Pass on what has come (called by asyncio)."""
        if self.is_asking:
            return
        if self.request is None:
            together = self._ending + data
            end = together.find(_END_OF_REQUEST)
            if end >= 0:
                data = data[: end + len(_END_OF_REQUEST) - len(self._ending)]
            self._ending = together[1 - len(_END_OF_REQUEST) :]
        super().data_received(data)

    def eof_received(self) -> bool | None:  # type: ignore[override]  # the library's returns None always
        """Return whether the connection stays open for what is still to be written (called by asyncio)."""
        if self.is_asking:
            self.half_closed = True
            # once both have ended nobody else would close it; with TLS there is no such thing as half a connection
            return not self.written and self.transport.can_write_eof()
        super().eof_received()
        return None


def connection_type(request_s: float) -> type[HttpConnection]:
    """Return the class of a server's connections.

    Args:
        request_s: Longest wait for the whole request [s].
    """

    class TimedHttpConnection(HttpConnection):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            super().connection_made(transport)
            self.waiting = asyncio.get_running_loop().call_later(request_s, self.give_up)

        def give_up(self) -> None:
            if self.request is None:
                self.transport.abort()

        def connection_lost(self, exc: Exception | None) -> None:
            self.waiting.cancel()
            super().connection_lost(exc)

    return TimedHttpConnection

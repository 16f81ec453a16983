"""A file over HTTP, written as fast as its reader takes it: one time limit is for no progress, a long one for the whole file.

`websockets` writes an answer at once, and gives all of it the time that the end of a WebSocket has; with TLS asyncio cuts off what
has not gone out 30 s after that. So whoever needs longer for a building model got a part of it. Here the answer is written in
pieces, each when the one before it has gone out, and the connection ends when the reader has all of it.
"""

from __future__ import annotations

import asyncio
import dataclasses
import socket

from websockets.http11 import Request, Response

from construction_twin.console.http_connection import HttpConnection

#: Bytes that are written at once.
_PIECE = 65536
#: What the kernel keeps of an answer [bytes]: much more, and a slow reader would seem to take nothing for a long time.
_KERNEL = 262144
#: A reader that takes less in the long run is cut off [bytes/s]: a building model of 64 MB may take more than an hour.
SLOWEST = 16384


async def deliver(connection: HttpConnection, request: Request, answer: Response, stall_s: float) -> bool:
    """Write an answer and end the connection; return whether the reader took it.

    Args:
        connection: The connection, whose request has been read.
        request: Of a HEAD only the head of the answer is written.
        answer: Whole, with its length and ``Connection: close``.
        stall_s: A reader that takes nothing for so long is cut off [s], and whoever takes longer than this and the body at
            `SLOWEST`.
    """
    transport = connection.transport
    kernel = transport.get_extra_info("socket")
    kernel.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _KERNEL)
    # a drained connection is one whose bytes have left this process; with a limit of 0 asyncio's TLS pauses with nothing to write
    transport.set_write_buffer_limits(high=1, low=0)
    body = b"" if request.method == "HEAD" else answer.body
    head = dataclasses.replace(answer, body=b"").serialize()
    try:
        async with asyncio.timeout(stall_s + len(body) / SLOWEST):
            for piece in (head, *(body[at : at + _PIECE] for at in range(0, len(body), _PIECE))):
                if transport.is_closing():
                    return False
                transport.write(piece)
                async with asyncio.timeout(stall_s):
                    await connection.drain()
            # the rest is in the kernel. With TLS, closing waits for the reader; without, only the reader's own end shows that it
            # has all, and a connection that is closed before the reader has stopped writing is reset
            if transport.can_write_eof() and not connection.half_closed:
                connection.written = True
                transport.write_eof()
            else:
                transport.close()
            async with asyncio.timeout(stall_s):
                await connection.wait_closed()
    except (TimeoutError, OSError):
        return False
    finally:
        transport.abort()
        await connection.wait_closed()
    return True

"""A camera's pictures to one browser, as fast as it takes them: who is slow misses pictures, and gets no old one for a new one.

The answer has no end: it is a row of packets, each a head and a JPEG. The head says how old the picture is, when it was sent, and
whether the camera is there; where no other picture has come for half a second, it comes alone. So the page can always say how old
its picture is: what is late on the way shows by the time of sending.
"""

from __future__ import annotations

import asyncio
import socket
import struct
from collections.abc import Callable

from construction_twin.console.camera import Camera
from construction_twin.console.http_connection import HttpConnection

#: Bytes of the JPEG, its age [ms], time of sending since the answer began [ms], whether the camera is there. Big-endian.
HEAD = struct.Struct(">IIIB")
#: A head comes at least so often [s].
BEAT_S = 0.5
#: What the kernel keeps for a browser [bytes]: more, and a slow one would get old pictures.
_KERNEL = 65536
_MOST_MS = 2**32 - 1


async def deliver_pictures(
    connection: HttpConnection, head: bytes, camera: Camera, may_see: Callable[[], bool], browser: str, stall_s: float
) -> str:
    """Write pictures until somebody ends it; return who, in a word: ``right``, ``browser`` or ``stall``.

    Args:
        head: Of HTTP's answer.
        may_see: Asked before each packet.
        browser: Whose, for the number of viewers.
        stall_s: A browser that takes nothing for so long is cut off [s].
    """
    transport, clock = connection.transport, asyncio.get_running_loop().time
    transport.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _KERNEL)
    transport.set_write_buffer_limits(high=1, low=0)
    began, shown = clock(), 0
    try:
        async with camera.viewed(browser):
            transport.write(head)
            while may_see():
                if transport.is_closing():
                    return "browser"
                picture, now = camera.newest, clock()
                fresh = picture is not None and picture.number > shown
                jpeg = picture.jpeg if picture is not None and fresh else b""
                age = 0 if picture is None else round(1000 * (now - picture.at))
                sent = min(round(1000 * (now - began)), _MOST_MS)
                transport.write(HEAD.pack(len(jpeg), min(age, _MOST_MS), sent, picture is not None) + jpeg)
                shown = picture.number if picture is not None else shown
                async with asyncio.timeout(stall_s):
                    await connection.drain()
                # what came while this one went out is sent at once
                if camera.newest is picture:
                    await camera.change(BEAT_S)
            return "right"
    except TimeoutError:
        return "stall"
    except OSError:
        return "browser"
    finally:
        transport.abort()
        await connection.wait_closed()

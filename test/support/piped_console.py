"""The console in this process, with real sockets, and mosquitto with accounts behind it."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator

import aiohttp
import pytest
from mqtt_packets import packet, text

from construction_twin.extensions.console.server import ConsoleServer, ServerSettings

CONNACK_OK = b"\x20\x02\0\0"
PING, PONG = b"\xc0\0", b"\xd0\0"


@contextlib.asynccontextmanager
async def serving(served: ServerSettings, port: int) -> AsyncIterator[None]:
    """Serve on loopback until the block ends."""
    ready = asyncio.Event()
    task = asyncio.create_task(ConsoleServer(served).run("127.0.0.1", port, ready.set))
    await asyncio.wait_for(ready.wait(), 10)
    try:
        yield
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.wait_for(task, 10)


class Closed(Exception):
    """The server has closed the WebSocket.

    Attributes:
        code, reason: Of its close frame; 1006 without one.
    """

    def __init__(self, code: int, reason: str):
        self.code, self.reason = code, reason
        super().__init__(f"{code} {reason}")


class Tab:
    """A WebSocket of a browser, as a page's."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse):
        self._socket = socket

    async def send(self, data: bytes | str) -> None:
        await (self._socket.send_str(data) if isinstance(data, str) else self._socket.send_bytes(data))

    async def recv(self) -> bytes:
        """Return the next message; Closed when there is none any more."""
        message = await asyncio.wait_for(self._socket.receive(), 10)
        if message.type is aiohttp.WSMsgType.BINARY:
            return message.data
        raise Closed(self._socket.close_code or 1006, message.extra or "")

    async def leave(self) -> None:
        await self._socket.close()

    async def closed(self) -> tuple[int, str]:
        """Wait until the server has closed; return code and reason."""
        with pytest.raises(Closed) as caught:
            while True:
                await self.recv()
        return caught.value.code, caught.value.reason


class Browser:
    """A browser at an address of this machine: it keeps cookies for all of its tabs.

    Args:
        url: Of the page.
        tls: What it trusts.
    """

    def __init__(self, url: str, address: str = "127.0.0.1", tls=True):
        self._url, self._tls = url, tls
        connector = aiohttp.TCPConnector(local_addr=(address, 0))
        jar = aiohttp.CookieJar(unsafe=True)
        self._session = aiohttp.ClientSession(connector=connector, cookie_jar=jar)

    async def __aenter__(self) -> Browser:
        return self

    async def __aexit__(self, *_) -> None:
        await self._session.close()

    async def get(self, path: str = "", **headers: str) -> tuple[aiohttp.ClientResponse, bytes]:
        """Return the answer, and its body as it came."""
        async with self._session.get(self._url + path, headers=headers, ssl=self._tls) as answer:
            return answer, await answer.read()

    async def status(self, path: str) -> int:
        return (await self.get(path))[0].status

    @contextlib.asynccontextmanager
    async def tab(self, origin: str | None = "", protocols=("mqtt",)) -> AsyncIterator[Tab]:
        """Open a WebSocket; "": of this server's page."""
        origin = self._url.rstrip("/") if origin == "" else origin
        async with self._session.ws_connect(
            self._url + "mqtt", origin=origin, protocols=protocols, ssl=self._tls, max_msg_size=0
        ) as opened:
            yield Tab(opened)


@contextlib.asynccontextmanager
async def browser_at(port: int, address: str = "127.0.0.1", **more) -> AsyncIterator[Tab]:
    """Open a page in a browser of its own."""
    async with Browser(f"http://127.0.0.1:{port}/", address) as browser, browser.tab(**more) as tab:
        yield tab


def login(user: str = "ada", password: str = "secret") -> bytes:
    return packet(
        1, text("MQTT") + b"\x04\xc2\0\x0a" + text(f"test-{time.monotonic_ns()}") + text(user) + text(password)
    )


async def logs_in(tab: Tab, user: str = "ada") -> None:
    """Log in, and see it accepted."""
    await tab.send(login(user))
    assert await tab.recv() == CONNACK_OK

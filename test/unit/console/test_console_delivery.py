"""Files over slow networks: all of a file arrives, however long that takes; who takes nothing is cut off."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import logging
import os
import socket
import ssl
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from construction_twin.broker.access import Site
from construction_twin.broker.make_site import SiteFolder
from construction_twin.console import server
from construction_twin.console.pipe import BrokerAddress, PipeLimits
from construction_twin.console.server import ConsoleServer, ServerSettings
from construction_twin.console.static_files import StaticFile

PORT = 28490
LARGE = os.urandom(20_000_000)
FILE = StaticFile.of("building.glb", LARGE)
SMALL = StaticFile.of("index.html", b"<!doctype html><title>console</title>")


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    SiteFolder(folder).make(Site(hosts=("localhost",), robots=("one",), port=28491, folder=str(folder / "broker")))
    return folder


@contextlib.asynccontextmanager
async def running(tls: ssl.SSLContext | None = None, **more) -> AsyncIterator[None]:
    files = {"/building.glb": FILE, "/index.html": SMALL}
    served = ServerSettings(files, None, BrokerAddress("127.0.0.1", 1), tls=tls, **more)
    ready = asyncio.Event()
    task = asyncio.create_task(ConsoleServer(served).run("127.0.0.1", PORT, ready))
    await asyncio.wait_for(ready.wait(), 10)
    try:
        yield
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.wait_for(task, 10)


def contexts(site: Path) -> tuple[ssl.SSLContext, ssl.SSLContext]:
    """Return the server's and a client's."""
    own = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    own.load_cert_chain(site / "broker/server.crt", site / "broker/server.key")
    return own, ssl.create_default_context(cafile=site / "ca/ca.crt")


async def ask(request: bytes, trust: ssl.SSLContext | None = None) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """Return a connection with little room for what comes, on which a request has been sent."""
    plain = socket.socket()
    plain.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 65536)
    plain.setblocking(False)
    await asyncio.get_running_loop().sock_connect(plain, ("127.0.0.1", PORT))
    more = {"ssl": trust, "server_hostname": "localhost"} if trust else {}
    reader, writer = await asyncio.open_connection(sock=plain, limit=16384, **more)
    writer.write(request)
    return reader, writer


def get(path: str = "/building.glb", method: str = "GET") -> bytes:
    return f"{method} {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode()


async def rest(reader: asyncio.StreamReader) -> bytes:
    return await asyncio.wait_for(reader.read(), 60)


@pytest.mark.parametrize("secure", (False, True))
def test_a_slow_network_gets_all_of_a_large_file(site, secure):
    """The reader takes several times what the server waits for nothing, and longer than the library waits at an end."""
    own, trust = contexts(site) if secure else (None, None)
    stall = 1.0

    async def scene() -> None:
        async with running(own, file_stall_s=stall):
            reader, writer = await ask(get(), trust)
            received = bytearray()
            # what the reader's clock does is no matter: it is slow, never silent
            for _ in range(8):
                received += await asyncio.wait_for(reader.readexactly(400_000), 10)
                await asyncio.sleep(0.4 * stall)
            received += await rest(reader)
            head, _, body = bytes(received).partition(b"\r\n\r\n")
            assert head.startswith(b"HTTP/1.1 200 OK\r\n")
            assert (len(body), hashlib.sha256(body).digest()) == (len(LARGE), hashlib.sha256(LARGE).digest())
            writer.close()

    asyncio.run(scene())


@pytest.mark.parametrize("secure", (False, True))
def test_who_takes_nothing_is_cut_off_and_nobody_else(site, secure, caplog):
    own, trust = contexts(site) if secure else (None, None)

    async def scene() -> None:
        async with running(own, file_stall_s=0.5):
            reader, writer = await ask(get(), trust)
            async with asyncio.timeout(10):
                while "did not take all of '/building.glb'" not in caplog.text:
                    await asyncio.sleep(0.05)
            received = b""
            with contextlib.suppress(ConnectionError, ssl.SSLError):
                received = await rest(reader)
            assert len(received) < len(LARGE)
            writer.transport.abort()
            reader, writer = await ask(get("/"), trust)
            assert (await rest(reader)).endswith(SMALL.body)
            writer.close()

    with caplog.at_level(logging.WARNING, "console"):
        asyncio.run(scene())


def test_a_handshake_of_tls_that_does_not_end_is_cut_off(site):
    async def scene() -> None:
        async with running(contexts(site)[0], limits=PipeLimits(login_s=0.3)):
            # nothing, and the head of a handshake
            for begun in (b"", b"\x16\x03\x01\x02\0\x01\0"):
                reader, writer = await ask(begun)
                assert await asyncio.wait_for(reader.read(), 10) == b""
                writer.close()

    asyncio.run(scene())


@pytest.mark.parametrize(
    ("request_", "status"),
    (
        (b"GET /" + b"a" * 20_000 + b" HTTP/1.1\r\n\r\n", b"414"),
        (b"GET / HTTP/1.1\r\nX: " + b"a" * 20_000 + b"\r\n\r\n", b"431"),
        (b"GET / HTTP/1.1\r\n" + b"X: a\r\n" * 200 + b"\r\n", b"431"),
        # no HTTP, no version that it speaks, and a body: no answer
        (b"\x16\x03\x01 \0\r\n\r\n", b""),
        (b"GET / HTTP/2.0\r\n\r\n", b""),
        (b"POST / HTTP/1.1\r\nContent-Length: 1000000000\r\n\r\n", b""),
    ),
)
def test_a_head_that_is_too_long_or_none_is_refused_at_once_and_not_logged(caplog, request_, status):
    async def scene() -> None:
        async with running():
            reader, writer = await ask(request_)
            assert (await asyncio.wait_for(reader.read(), 10))[9:12] == status
            writer.close()

    with caplog.at_level(logging.ERROR):
        asyncio.run(scene())
    assert not caplog.records


def test_who_takes_a_little_for_ever_is_cut_off(monkeypatch, caplog):
    monkeypatch.setattr(server, "SLOWEST", 1e7)

    async def scene() -> None:
        # 2.5 s for 20 MB; this reader never stalls and would need 20 s
        async with running(file_stall_s=0.5):
            reader, writer = await ask(get())
            async with asyncio.timeout(10):
                while "did not take all of '/building.glb'" not in caplog.text:
                    await reader.read(16_384)
                    await asyncio.sleep(0.016)
            writer.transport.abort()

    with caplog.at_level(logging.WARNING, "console"):
        asyncio.run(scene())


def test_a_server_that_stops_does_not_wait_for_a_slow_reader():
    async def scene() -> None:
        async with running(file_stall_s=300.0):
            reader, writer = await ask(get())
            await asyncio.wait_for(reader.readexactly(1000), 10)
        # `running` has waited for the server, 10 s at most
        writer.transport.abort()

    asyncio.run(scene())


def test_a_reader_that_leaves_or_ends_its_own_side_harms_nothing(caplog):
    async def scene() -> None:
        async with running():
            reader, writer = await ask(get())
            await asyncio.wait_for(reader.readexactly(1000), 10)
            writer.transport.abort()
            reader, writer = await ask(get())
            writer.write_eof()
            assert (await rest(reader)).endswith(LARGE[-1000:])
            writer.close()
            # a second request behind the first, and more that nobody reads: one answer
            reader, writer = await ask(get("/") * 2 + b"x" * 100_000)
            answer = await rest(reader)
            assert answer.count(b"HTTP/1.1") == 1
            assert answer.endswith(SMALL.body)
            writer.close()

    with caplog.at_level(logging.ERROR):
        asyncio.run(scene())
    assert not caplog.records


def test_only_the_head_where_that_is_asked_for_and_no_other_method():
    async def scene() -> None:
        async with running():
            for method, status in (("HEAD", b"200"), ("POST", b"405"), ("DELETE", b"405")):
                reader, writer = await ask(get(method=method))
                head, _, body = (await rest(reader)).partition(b"\r\n\r\n")
                assert head.split()[1] == status
                assert (f"Content-Length: {len(LARGE)}".encode() in head) == (method == "HEAD")
                assert (body == b"") == (method == "HEAD")
                writer.close()

    asyncio.run(scene())

"""Files over slow networks: all of a file arrives, however long that takes; who takes nothing is cut off."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import hashlib
import logging
import os
import socket
import ssl
from pathlib import Path

import pytest
from mqtt_packets import connect
from piped_console import CONNACK_OK, PING, PONG, Browser, browser_at, serving

from construction_twin.broker.access import Site
from construction_twin.broker.make_site import make_site
from construction_twin.extensions.console.pipe import BrokerAddress, PipeLimits
from construction_twin.extensions.console.server import ServerSettings

PORT, BROKER_PORT = 28490, 28491
LARGE = os.urandom(20_000_000)
SMALL = b"<!doctype html><title>console</title>"
running = functools.partial(serving, port=PORT)


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    make_site(folder, Site(hosts=("localhost",), robots=("one",), port=BROKER_PORT, folder=str(folder / "broker")))
    return folder


@pytest.fixture(scope="module")
def page(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("page")
    (folder / "building.glb").write_bytes(LARGE)
    (folder / "index.html").write_bytes(SMALL)
    return folder


def settings(page: Path, tls: ssl.SSLContext | None = None, **more) -> ServerSettings:
    return ServerSettings(page, None, BrokerAddress("127.0.0.1", BROKER_PORT), tls=tls, **more)


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
    return f"{method} {path} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n".encode()


async def rest(reader: asyncio.StreamReader) -> bytes:
    return await asyncio.wait_for(reader.read(), 60)


async def until_cut_off(writer: asyncio.StreamWriter) -> None:
    """Wait until the server's side of a connection is gone; what it has sent is not taken."""
    remote = f":{writer.get_extra_info('sockname')[1]:04X} 01 "
    async with asyncio.timeout(10):
        while any(
            f":{PORT:04X} " in line and remote in line for line in Path("/proc/net/tcp").read_text().splitlines()
        ):
            await asyncio.sleep(0.05)


@pytest.mark.parametrize("secure", (False, True))
def test_a_slow_network_gets_all_of_a_large_file(site, page, secure):
    """The reader takes several times what the server waits for nothing."""
    own, trust = contexts(site) if secure else (None, None)
    stall = 1.0

    async def scene() -> None:
        async with running(settings(page, own, file_stall_s=stall)):
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
def test_who_takes_nothing_is_cut_off_and_nobody_else(site, page, secure, caplog):
    own, trust = contexts(site) if secure else (None, None)

    async def scene() -> None:
        async with running(settings(page, own, file_stall_s=0.5)):
            reader, writer = await ask(get(), trust)
            await until_cut_off(writer)
            received = b""
            with contextlib.suppress(ConnectionError, ssl.SSLError):
                received = await rest(reader)
            assert len(received) < len(LARGE)
            writer.transport.abort()
            reader, writer = await ask(get("/"), trust)
            assert (await rest(reader)).endswith(SMALL)
            writer.close()

    with caplog.at_level(logging.ERROR):
        asyncio.run(scene())
    assert not caplog.records


def test_a_message_waits_for_no_file(page):
    """A stop is as small as this ping; a reader of a file takes nothing meanwhile, and others all they can get."""

    async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readexactly(len(connect()))
        writer.write(CONNACK_OK)
        while await reader.read(2):
            writer.write(PONG)

    async def scene() -> None:
        limits = PipeLimits(frames_per_s=1e6, burst_frames=1e6)
        server = await asyncio.start_server(echo, "127.0.0.1", BROKER_PORT)
        async with server, running(settings(page, limits=limits)), browser_at(PORT) as tab:
            await tab.send(connect())
            await tab.recv()
            _, stalled = await ask(get())
            async with Browser(f"http://127.0.0.1:{PORT}/") as browser:
                load = asyncio.create_task(browser.get("building.glb"))
                pings = 0
                while not load.done():
                    await tab.send(PING)
                    assert await tab.recv() == PONG
                    pings += 1
                assert (await load)[1] == LARGE
            # between the pieces of the file
            assert pings > 2
            stalled.transport.abort()

    asyncio.run(scene())


def test_a_handshake_of_tls_that_does_not_end_is_cut_off(site, page):
    async def scene() -> None:
        async with running(settings(page, contexts(site)[0], ask_s=0.3)):
            # nothing, and the head of a handshake
            for begun in (b"", b"\x16\x03\x01\x02\0\x01\0"):
                reader, writer = await ask(begun)
                assert await asyncio.wait_for(reader.read(), 10) == b""
                writer.close()

    asyncio.run(scene())


@pytest.mark.parametrize("begun", (b"", b"GET / HTTP/1.1\r\n", get().replace(b"close", b"keep-alive") + b"GET"))
def test_who_asks_for_nothing_is_cut_off(page, begun):
    async def scene() -> None:
        async with running(settings(page, ask_s=0.3)):
            reader, writer = await ask(begun)
            assert len(await rest(reader)) >= (len(LARGE) if b"building" in begun else 0)
            writer.close()

    asyncio.run(scene())


@pytest.mark.parametrize(
    ("request_", "status"),
    (
        (b"GET /" + b"a" * 200_000 + b" HTTP/1.1\r\n\r\n", b"400"),
        (b"\x16\x03\x01 \0\r\n\r\n", b"400"),
        (b"POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000000\r\n\r\n", b"405"),
    ),
)
def test_a_request_that_is_too_long_or_none_is_refused_at_once_and_not_logged(page, caplog, request_, status):
    async def scene() -> None:
        async with running(settings(page)):
            reader, writer = await ask(request_)
            assert (await asyncio.wait_for(reader.readexactly(12), 10))[9:] == status
            with contextlib.suppress(ConnectionError):
                await rest(reader)
            writer.close()

    with caplog.at_level(logging.INFO):
        asyncio.run(scene())
    assert not [record for record in caplog.records if record.name != "asyncio"]


def test_a_server_that_stops_does_not_wait_for_a_slow_reader(page):
    async def scene() -> None:
        async with running(settings(page, file_stall_s=300.0)):
            reader, writer = await ask(get())
            await asyncio.wait_for(reader.readexactly(1000), 10)
        # `running` has waited for the server, 10 s at most
        writer.transport.abort()

    asyncio.run(scene())

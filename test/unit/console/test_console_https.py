"""The console's TLS port: browsers are kept to https, and who types http there is told so, at the cost of a handshake at most."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import logging
import ssl
from argparse import Namespace
from functools import partial
from pathlib import Path

import pytest
from piped_console import serving
from sentence_checks import expects
from websockets.asyncio.client import connect as websocket
from websockets.exceptions import InvalidStatus

from construction_twin.broker.access import Site
from construction_twin.broker.make_site import SiteFolder
from construction_twin.console.connection_limits import ConnectionLimits
from construction_twin.console.pipe import BrokerAddress, PipeLimits
from construction_twin.console.program import settings_of
from construction_twin.console.server import ServerSettings
from construction_twin.console.static_files import StaticFile
from construction_twin.core.errors import ConfigurationError

PORT = 28474
PAGE = {"/index.html": StaticFile.of("index.html", b"<!doctype html><title>console</title>")}
HSTS = "Strict-Transport-Security"
running = partial(serving, port=PORT)


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    SiteFolder(folder).make(Site(hosts=("localhost",), robots=("one",), port=28475, folder=str(folder / "broker")))
    return folder


def settings(site: Path | None, **more) -> ServerSettings:
    own = None
    if site is not None:
        own = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
        own.load_cert_chain(site / "broker/server.crt", site / "broker/server.key")
    return ServerSettings(
        PAGE, None, None, BrokerAddress("127.0.0.1", 1), tls=own, **({"names": ("localhost",)} | more)
    )


def trust(site: Path) -> ssl.SSLContext:
    return ssl.create_default_context(cafile=site / "ca/ca.crt")


def header(path: str, site: Path | None) -> tuple[int, list[str]]:
    """Return the status of a path, and what stands in the header."""
    if site is None:
        connection = http.client.HTTPConnection("localhost", PORT, timeout=10)
    else:
        connection = http.client.HTTPSConnection("localhost", PORT, timeout=10, context=trust(site))
    connection.request("GET", path)
    answer = connection.getresponse()
    answer.read()
    connection.close()
    return answer.status, answer.headers.get_all(HSTS) or []


async def ask(request: bytes, *more: bytes, address: str = "127.0.0.1") -> bytes:
    """Send without TLS, in parts; return all that is answered by the end of the connection."""
    reader, writer = await asyncio.open_connection("127.0.0.1", PORT, local_addr=(address, 0))
    try:
        writer.write(request)
        for part in more:
            await asyncio.sleep(0.05)
            writer.write(part)
        with contextlib.suppress(ConnectionError):
            return await asyncio.wait_for(reader.read(), 10)
        return b""
    finally:
        writer.transport.abort()


def plain(host: str, line: str = "GET /?theme=dark") -> bytes:
    return f"{line} HTTP/1.1\r\nHost: {host}\r\n\r\n".encode()


def test_with_tls_every_answer_keeps_the_browser_to_https_for_a_week(site):
    async def scene() -> None:
        async with running(settings(site)):
            for path, status in (("/", 200), ("/nothing", 404), ("/private/runs.json", 403)):
                assert await asyncio.to_thread(header, path, site) == (status, ["max-age=604800"])
            url = f"wss://localhost:{PORT}/mqtt"
            with pytest.raises(InvalidStatus) as caught:
                await websocket(url, ssl=trust(site), origin="https://evil.example", subprotocols=["mqtt"])
            assert caught.value.response.headers.get_all(HSTS) == ["max-age=604800"]
            own = f"https://localhost:{PORT}"
            async with websocket(url, ssl=trust(site), origin=own, subprotocols=["mqtt"]) as client:
                assert client.response.headers.get_all(HSTS) == ["max-age=604800"]
        async with running(settings(site, hsts_s=0)):
            assert await asyncio.to_thread(header, "/", site) == (200, ["max-age=0"])

    asyncio.run(scene())


def test_without_tls_no_answer_speaks_of_https():
    async def scene() -> None:
        async with running(settings(None)):
            assert await asyncio.to_thread(header, "/", None) == (200, [])
            own = f"http://localhost:{PORT}"
            url = f"ws://localhost:{PORT}/mqtt"
            async with websocket(url, origin=own, subprotocols=["mqtt"]) as client:
                assert client.response.headers.get_all(HSTS) == []
            assert (await ask(plain(f"localhost:{PORT}"))).startswith(b"HTTP/1.1 200 OK")

    asyncio.run(scene())


def test_who_types_http_is_sent_to_https_and_gets_the_page_there(site, caplog):
    async def scene() -> None:
        async with running(settings(site)):
            request = plain(f"localhost:{PORT}")
            for parts in ((request,), (request[:1], request[1:20], request[20:])):
                head = (await ask(*parts)).partition(b"\r\n\r\n")[0].decode()
                assert head.startswith("HTTP/1.1 307 ")
                assert f"\r\nLocation: https://localhost:{PORT}/?theme=dark\r\n" in head and HSTS not in head
            for request in (plain("evil.example"), plain("localhost", "POST /"), b"GET " + b"x" * 20_000):
                answer = await ask(request)
                assert answer.startswith(b"HTTP/1.1 400 ") and b"Location" not in answer
                assert answer.count(f"https://localhost:{PORT}/".encode()) == 2
            assert (await asyncio.to_thread(header, "/?theme=dark", site))[0] == 200

    with caplog.at_level(logging.INFO):
        asyncio.run(scene())
    assert "127.0.0.1 asked by http; told to use https" in caplog.text
    assert not [record for record in caplog.records if record.levelno > logging.INFO]


def test_what_is_neither_tls_nor_http_gets_no_answer_of_http(site):
    async def scene() -> None:
        async with running(settings(site)):
            for junk in (b"\x10\x0c\0\x04MQTT", b"get / HTTP/1.1\r\n\r\n", b"\x16junk", bytes(100)):
                assert b"HTTP" not in await ask(junk)
            assert (await asyncio.to_thread(header, "/", site))[0] == 200

    asyncio.run(scene())


def test_half_a_request_without_tls_has_no_more_time_than_a_handshake(site):
    async def scene() -> None:
        async with running(settings(site, limits=PipeLimits(login_s=0.3))):
            assert await ask(b"GET / HTTP/1.1\r\nHost: local") == b""
            # byte by byte neither
            assert await ask(b"G", *[b"E"] * 20) == b""

    asyncio.run(scene())


def test_requests_without_tls_have_no_more_places_than_handshakes_and_keep_nobody_out(site):
    connections = ConnectionLimits(anonymous=24, anonymous_per_address=8)

    async def scene() -> None:
        served = settings(site, connections=connections, limits=PipeLimits(login_s=300.0))
        async with running(served), contextlib.AsyncExitStack() as held:
            readers = []
            for number in range(80):
                reader, writer = await asyncio.open_connection(
                    "127.0.0.1", PORT, local_addr=(f"127.0.0.{2 + number % 4}", 0)
                )
                held.callback(writer.transport.abort)
                writer.write(b"GET / HTTP/1.1\r\nX: " + b"x" * 1000)
                readers.append(reader)
            # the oldest have ended, those that fill the connections have not
            ended = [asyncio.create_task(reader.read()) for reader in readers]
            done, pending = await asyncio.wait(ended[:56], timeout=10)
            assert len(done) == 56 and not pending
            assert not any(task.done() for task in ended[56:])
            assert (await asyncio.to_thread(header, "/", site))[0] == 200
            assert (await ask(plain(f"localhost:{PORT}"))).startswith(b"HTTP/1.1 307 ")
            for task in ended:
                task.cancel()
            await asyncio.gather(*ended, return_exceptions=True)

    asyncio.run(scene())


def arguments(site: Path, **more) -> Namespace:
    values = {"certificate": site / "broker/server.crt", "key": site / "broker/server.key", "listen": "0.0.0.0"} | {
        "page": None, "private": None, "rights": None, "origin": [], "hsts": 60,
        "pairings": None,
        "broker_host": "127.0.0.1", "broker_port": 1, "broker_ca": None,
    }  # fmt: skip
    return Namespace(**(values | more))


def test_the_names_of_a_server_are_those_of_its_certificate_and_where_it_listens(site):
    assert list(settings_of(arguments(site)).names) == ["localhost"]
    assert list(settings_of(arguments(site, listen="127.0.0.1")).names) == ["localhost", "127.0.0.1"]
    assert list(settings_of(arguments(site, listen="127.0.0.1", certificate=None, key=None)).names) == []
    assert settings_of(arguments(site)).hsts_s == 60


@pytest.mark.parametrize("seconds", (-1, 365 * 24 * 3600 + 1))
def test_browsers_are_bound_for_a_year_at_most(site, seconds):
    with pytest.raises(ConfigurationError, check=expects("expected.range", "--hsts")):
        settings_of(arguments(site, hsts=seconds))

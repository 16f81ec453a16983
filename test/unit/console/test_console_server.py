"""The console's program with real sockets and a real broker: what passes, what is refused, what is logged."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import http.client
import logging
import re
import signal
import socket
import ssl
import sys
import time
from collections.abc import AsyncIterator, Iterator
from http.cookies import SimpleCookie
from pathlib import Path

import pytest
from mqtt_packets import connect, packet, text
from piped_console import CONNACK_OK, MOSQUITTO, PING, PONG, broker_with, browser_at, closed, login, serving, started
from websockets.asyncio.client import connect as websocket
from websockets.exceptions import ConnectionClosed, InvalidStatus

from construction_twin.broker import make_site
from construction_twin.console.command_line import main
from construction_twin.console.connection_limits import ConnectionLimits
from construction_twin.console.pipe import BROKER_AWAY, NOT_MQTT, TOO_MUCH, BrokerAddress, PipeLimits
from construction_twin.console.server import ServerSettings
from construction_twin.console.static_files import read_folder

PORT, BROKER_PORT = 28480, 28481
ORIGIN = f"http://127.0.0.1:{PORT}"
#: A browser's request for the WebSocket.
UPGRADE = (
    f"GET /mqtt HTTP/1.1\r\nHost: 127.0.0.1:{PORT}\r\n"
    f"Origin: {ORIGIN}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Protocol: mqtt\r\n\r\n"
).encode()


@pytest.fixture(scope="module")
def broker(tmp_path_factory) -> Iterator[None]:
    """Mosquitto with one account, `ada` with password `secret`."""
    with broker_with(tmp_path_factory.mktemp("broker"), BROKER_PORT, "ada"):
        yield


def page(folder: Path) -> Path:
    (folder / "page").mkdir()
    (folder / "page/index.html").write_text("<!doctype html><title>console</title>" + " " * 2000)
    (folder / "page/app-0123456789ab.js").write_text("export const answer = 42;\n" * 100)
    return folder / "page"


def settings(folder: Path, **more) -> ServerSettings:
    values = {"private": None, "broker": BrokerAddress("127.0.0.1", BROKER_PORT)} | more
    return ServerSettings(read_folder(page(folder)), **values)


running = functools.partial(serving, port=PORT)


def browser(origin: str | None = ORIGIN, **more):
    return browser_at(PORT, origin=origin, **more)


def get(path: str, **headers: str) -> tuple[http.client.HTTPResponse, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", PORT, timeout=10)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer, body


def test_bytes_reach_the_broker_and_come_back(broker, tmp_path, caplog):
    async def scene() -> None:
        async with running(settings(tmp_path)), browser() as client:
            await client.send(login())
            assert await client.recv() == CONNACK_OK
            # one packet in many frames, and many in one
            await client.send(PING[:1])
            await client.send(PING[1:] + PING)
            answer = b""
            while len(answer) < 4:
                answer += await asyncio.wait_for(client.recv(), 10)
            assert answer == PONG + PONG

    with caplog.at_level(logging.INFO, "console"):
        asyncio.run(scene())
    assert "127.0.0.1 logged in as 'ada'" in caplog.text


def test_a_browser_that_logs_out_is_no_fault_of_the_broker(broker, tmp_path, caplog):
    async def scene() -> None:
        async with running(settings(tmp_path)), browser() as client:
            await client.send(login() + packet(14))
            assert (await closed(client))[0] == 1000

    with caplog.at_level(logging.INFO, "console"):
        asyncio.run(scene())
    assert "the browser has left" in caplog.text


def test_a_wrong_password_is_the_broker_s_answer_and_opens_nothing(broker, tmp_path):
    async def scene() -> None:
        private = tmp_path / "private"
        private.mkdir()
        (private / "robot.json").write_text("{}")
        async with running(settings(tmp_path, private=private)), browser() as client:
            ticket = client.response.headers["Set-Cookie"].partition(";")[0]
            await client.send(login(password="guess"))
            assert (await client.recv())[3] in (4, 5)
            assert await closed(client) == (BROKER_AWAY, "the broker has refused the login")
            answer, _ = await asyncio.to_thread(get, "/private/robot.json", Cookie=ticket)
            assert answer.status == 403
            async with browser() as good:
                ticket = good.response.headers["Set-Cookie"].partition(";")[0]
                await good.send(login())
                assert await good.recv() == CONNACK_OK
                answer, body = await asyncio.to_thread(get, "/private/robot.json", Cookie=ticket)
                assert (answer.status, body) == (200, b"{}")
            answer, _ = await asyncio.to_thread(get, "/private/../page/index.html", Cookie=ticket)
            assert answer.status in (403, 404)

    asyncio.run(scene())


def test_a_browser_s_second_page_does_not_take_the_first_one_s_files_away(broker, tmp_path):
    """Each page begins with a connection that logs nobody in, and a browser keeps one cookie per name for all of its pages."""
    private = tmp_path / "private"
    private.mkdir()
    (private / "robot.json").write_text("{}")
    jar: SimpleCookie = SimpleCookie()

    def cookies(path: str) -> dict[str, str]:
        """Return the header that a browser with this jar sends (RFC 6265, section 5.1.4)."""
        fitting = [
            each for each in jar.values() if path == each["path"] or path.startswith(each["path"].rstrip("/") + "/")
        ]
        return {"Cookie": "; ".join(f"{each.key}={each.value}" for each in fitting)} if fitting else {}

    @contextlib.asynccontextmanager
    async def page_of_it() -> AsyncIterator:
        async with browser(additional_headers=cookies("/mqtt")) as client:
            jar.load(client.response.headers["Set-Cookie"])
            yield client

    async def scene() -> None:
        async with running(settings(tmp_path, private=private)), page_of_it() as first:
            await first.send(login())
            assert await first.recv() == CONNACK_OK
            async with page_of_it():
                answer, _ = await asyncio.to_thread(get, "/private/robot.json", **cookies("/private/robot.json"))
                assert answer.status == 200
            answer, _ = await asyncio.to_thread(get, "/private/robot.json", **cookies("/private/robot.json"))
            assert answer.status == 200

    asyncio.run(scene())


@pytest.mark.parametrize("closes", ("the earlier one", "the later one"))
def test_two_tabs_that_connect_at_once_outlive_each_other(broker, tmp_path, closes):
    """Each gets a ticket, because neither shows one; the browser keeps the later one for both."""
    private = tmp_path / "private"
    private.mkdir()
    (private / "robot.json").write_text("{}")

    async def scene() -> None:
        async with running(settings(tmp_path, private=private)), browser() as earlier, browser() as later:
            kept = later.response.headers["Set-Cookie"].partition(";")[0]
            for client in (earlier, later):
                await client.send(login())
                assert await client.recv() == CONNACK_OK
            gone, left = (earlier, later) if closes == "the earlier one" else (later, earlier)
            await gone.send(packet(14))
            await closed(gone)
            answer, _ = await asyncio.to_thread(get, "/private/robot.json", Cookie=kept)
            assert answer.status == 200
            await left.send(packet(14))
            await closed(left)
            async with asyncio.timeout(10):
                while (await asyncio.to_thread(get, "/private/robot.json", Cookie=kept))[0].status != 403:
                    pass

    asyncio.run(scene())


@pytest.mark.parametrize("origin", (None, "https://evil.example", "http://127.0.0.1:1"))
def test_another_site_s_page_is_refused(broker, tmp_path, origin):
    async def scene() -> None:
        async with running(settings(tmp_path)):
            with pytest.raises(InvalidStatus) as caught:
                async with browser(origin):
                    pass
            assert caught.value.response.status_code == 403

    asyncio.run(scene())


@pytest.mark.parametrize(
    ("sent", "code"),
    (
        ("a text frame", NOT_MQTT),
        (b"junk that is no MQTT", NOT_MQTT),
        (connect() + connect(), NOT_MQTT),
        (b"\x10\xff\xff\x7f", TOO_MUCH),
    ),
)
def test_what_is_no_mqtt_ends_the_connection_and_nobody_else_s(broker, tmp_path, sent, code):
    async def scene() -> None:
        async with running(settings(tmp_path)), browser() as good, browser() as bad:
            await good.send(login())
            assert await good.recv() == CONNACK_OK
            await bad.send(sent)
            assert (await closed(bad))[0] == code
            await good.send(PING)
            assert await asyncio.wait_for(good.recv(), 10) == PONG

    asyncio.run(scene())


def test_who_says_nothing_or_too_much_is_cut_off(broker, tmp_path):
    limits = PipeLimits(login_s=0.2, packets_per_s=1.0, burst_packets=10.0)

    async def scene() -> None:
        async with running(settings(tmp_path, limits=limits)):
            async with browser() as silent:
                assert (await closed(silent))[0] == NOT_MQTT
            async with browser() as loud:
                await loud.send(login())
                with contextlib.suppress(ConnectionClosed):
                    for _ in range(100):
                        await loud.send(PING)
                assert (await closed(loud))[0] == TOO_MUCH

    asyncio.run(scene())


def test_who_answers_no_ping_is_cut_off_whatever_he_sends(broker, tmp_path):
    """No library is this browser: each of them answers pings by itself."""

    async def scene() -> None:
        async with running(settings(tmp_path, limits=PipeLimits(ping_s=0.3))):
            reader, writer = await asyncio.open_connection("127.0.0.1", PORT)
            writer.write(UPGRADE)
            await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 10)
            received = b""
            # a short frame, masked with zeros
            for sent in (login(), *[PING] * 100):
                writer.write(bytes([0x82, 0x80 | len(sent), 0, 0, 0, 0]) + sent)
                with contextlib.suppress(TimeoutError):
                    received = await asyncio.wait_for(reader.readuntil(b"keepalive ping timeout"), 0.1)
                    break
            assert PONG in received
            writer.close()

    asyncio.run(scene())


def test_who_takes_nothing_of_what_he_is_shown_is_cut_off(tmp_path, caplog):
    async def flood(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readexactly(len(login()))
        writer.write(CONNACK_OK)
        with contextlib.suppress(ConnectionError):
            while True:
                writer.write(packet(3, text("view") + bytes(60_000)))
                await writer.drain()

    async def scene() -> None:
        server = await asyncio.start_server(flood, "127.0.0.1", 28483)
        served = settings(
            tmp_path, broker=BrokerAddress("127.0.0.1", 28483), limits=PipeLimits(stall_s=0.3, ping_s=300.0)
        )
        async with server, running(served), browser() as client:
            await client.send(login())
            client.transport.pause_reading()
            end = time.monotonic() + 10
            while "the browser took nothing for 0.3 s" not in caplog.text:
                assert time.monotonic() < end
                await asyncio.sleep(0.05)
            client.transport.abort()

    with caplog.at_level(logging.INFO, "console"):
        asyncio.run(scene())


def test_a_broker_that_is_not_there_is_told_at_once(tmp_path):
    async def scene() -> None:
        async with running(settings(tmp_path, broker=BrokerAddress("127.0.0.1", 28482))), browser() as client:
            assert await closed(client) == (BROKER_AWAY, "the broker cannot be reached")

    asyncio.run(scene())


def test_a_broker_that_goes_away_is_told_within_a_second(tmp_path):
    async def scene() -> None:
        gone: list[asyncio.StreamWriter] = []
        server = await asyncio.start_server(lambda reader, writer: gone.append(writer), "127.0.0.1", 28483)
        async with server, running(settings(tmp_path, broker=BrokerAddress("127.0.0.1", 28483))), browser() as client:
            await client.send(login())
            while not gone:
                await asyncio.sleep(0.01)
            gone[0].close()
            went = time.monotonic()
            assert (await closed(client))[0] == BROKER_AWAY
            assert time.monotonic() - went < 1.0

    asyncio.run(scene())


def test_a_client_that_subscribes_with_its_login_gets_a_long_message_with_the_answer(tmp_path):
    """A client need not wait for CONNACK before it subscribes (MQTT 5.0, section 3.1.4): a stored plan may come with it."""
    long = packet(3, text("twin/kr120/plan") + b"x" * 100_000)

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readexactly(len(login()))
        writer.write(CONNACK_OK + long)

    async def scene() -> None:
        server = await asyncio.start_server(answer, "127.0.0.1", 28483)
        async with server, running(settings(tmp_path, broker=BrokerAddress("127.0.0.1", 28483))), browser() as client:
            await client.send(login())
            came = b""
            while len(came) < len(CONNACK_OK + long):
                came += await asyncio.wait_for(client.recv(), 10)
            assert came == CONNACK_OK + long

    asyncio.run(scene())


@pytest.mark.parametrize(
    ("limits", "why"),
    (
        (ConnectionLimits(logins=2), "too many connections are logged in"),
        (ConnectionLimits(logins_per_address=2), "too many connections from this address are logged in"),
        (ConnectionLimits(logins_per_account=2), "too many connections are logged in to this account"),
    ),
)
def test_no_more_logins_than_allowed(broker, tmp_path, limits, why):
    async def scene() -> None:
        async with running(settings(tmp_path, connections=limits)), browser() as one, browser() as two:
            for client in (one, two):
                await client.send(login())
                assert await client.recv() == CONNACK_OK
            async with browser() as third:
                await third.send(login())
                assert await closed(third) == (TOO_MUCH, why)
            await one.send(packet(14))
            assert (await closed(one))[0] == 1000
            # its place is free as soon as its connection has ended
            await one.wait_closed()
            async with asyncio.timeout(10):
                while not await logs_in():
                    pass

    async def logs_in() -> bool:
        async with browser() as client:
            await client.send(login())
            try:
                return await client.recv() == CONNACK_OK
            except ConnectionClosed:
                return False

    asyncio.run(scene())


def test_who_has_logged_in_stays_and_others_get_in_whoever_fills_the_places(broker, tmp_path):
    """Four addresses hold every anonymous connection: with nothing, half a request, a WebSocket that does not log in."""
    connections = ConnectionLimits(anonymous=24, anonymous_per_address=8)
    half = f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{PORT}\r\n".encode()

    async def scene() -> None:
        # nobody is cut off for being late
        served = settings(tmp_path, connections=connections, limits=PipeLimits(login_s=300.0))
        async with running(served), browser() as first, contextlib.AsyncExitStack() as held:
            await first.send(login())
            assert await first.recv() == CONNACK_OK
            for number in range(80):
                address = f"127.0.0.{2 + number % 4}"
                _, writer = await asyncio.open_connection("127.0.0.1", PORT, local_addr=(address, 0))
                held.callback(writer.transport.abort)
                writer.write((b"", half, UPGRADE)[number // 4 % 3])
            assert (await asyncio.to_thread(get, "/"))[0].status == 200
            async with browser() as late:
                await late.send(login())
                assert await late.recv() == CONNACK_OK
                for client in (first, late):
                    await client.send(PING)
                    assert await asyncio.wait_for(client.recv(), 10) == PONG

    asyncio.run(scene())


def test_with_tls_nobody_s_unfinished_handshakes_keep_others_out(tmp_path):
    site = tmp_path / "site"
    assert make_site.main([str(site), "--host", "localhost", "--robot", "kr120"]) == 0
    own = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    own.load_cert_chain(site / "broker/server.crt", site / "broker/server.key")
    trust = ssl.create_default_context(cafile=site / "ca/ca.crt")
    connections = ConnectionLimits(anonymous=24, anonymous_per_address=8)

    async def scene() -> None:
        served = settings(tmp_path, connections=connections, tls=own, limits=PipeLimits(login_s=300.0))
        async with running(served), contextlib.AsyncExitStack() as held:
            readers = []
            for number in range(80):
                reader, writer = await asyncio.open_connection(
                    "127.0.0.1", PORT, local_addr=(f"127.0.0.{2 + number % 4}", 0)
                )
                held.callback(writer.transport.abort)
                readers.append(reader)
            # the oldest have ended, those that fill the connections have not
            ended = [asyncio.create_task(reader.read()) for reader in readers]
            done, pending = await asyncio.wait(ended[:56], timeout=10)
            assert len(done) == 56 and not pending
            assert not any(task.done() for task in ended[56:])
            reader, writer = await asyncio.open_connection("127.0.0.1", PORT, ssl=trust, server_hostname="localhost")
            writer.write(f"GET / HTTP/1.1\r\nHost: localhost:{PORT}\r\n\r\n".encode())
            assert (await asyncio.wait_for(reader.read(), 10)).startswith(b"HTTP/1.1 200")
            writer.close()

    asyncio.run(scene())


def test_the_page_comes_with_a_strict_policy_and_is_asked_for_again_only_when_it_changed(tmp_path):
    async def scene() -> None:
        async with running(settings(tmp_path)):
            answer, body = await asyncio.to_thread(get, "/", **{"Accept-Encoding": "gzip"})
            assert answer.status == 200
            assert len(body) < 200
            assert answer.headers["Content-Encoding"] == "gzip"
            policy = answer.headers["Content-Security-Policy"]
            assert "default-src 'none'" in policy and "unsafe" not in policy
            assert answer.headers["Cache-Control"] == "no-cache"
            answer, body = await asyncio.to_thread(get, "/", **{"If-None-Match": answer.headers["ETag"]})
            assert (answer.status, body) == (304, b"")
            answer, _ = await asyncio.to_thread(get, "/app-0123456789ab.js")
            assert "immutable" in answer.headers["Cache-Control"]
            assert answer.headers["Content-Type"] == "text/javascript; charset=utf-8"
            for path in ("/nothing", "/../pyproject.toml", "//etc/passwd", "/private/robot.json"):
                answer, _ = await asyncio.to_thread(get, path)
                assert answer.status in (403, 404), path

    asyncio.run(scene())


def test_who_is_logged_in_learns_who_has_which_right_as_it_is_now(broker, tmp_path):
    rights = tmp_path / "rights.json"
    rights.write_text('{"robots": {}}')

    async def scene() -> None:
        async with running(settings(tmp_path, rights=rights)), browser() as client:
            ticket = client.response.headers["Set-Cookie"].partition(";")[0]
            assert (await asyncio.to_thread(get, "/private/rights.json"))[0].status == 403
            await client.send(login())
            assert await client.recv() == CONNACK_OK
            for text in ('{"robots": {}}', '{"robots": {"one": {"stop": {"ada": "ada"}}}}'):
                rights.write_text(text)
                answer, body = await asyncio.to_thread(get, "/private/rights.json", Cookie=ticket)
                assert (answer.status, body.decode()) == (200, text)
            rights.unlink()
            assert (await asyncio.to_thread(get, "/private/rights.json", Cookie=ticket))[0].status == 404

    asyncio.run(scene())


def test_ten_thousand_junk_frames_leave_it_alive(broker, tmp_path):
    async def scene() -> None:
        async with running(settings(tmp_path)), browser() as good:
            await good.send(login())
            assert await good.recv() == CONNACK_OK

            async def junk(number: int) -> None:
                async with browser() as bad:
                    with contextlib.suppress(ConnectionClosed):
                        for k in range(500):
                            await bad.send(bytes([(number * 37 + k) % 256]) * (k % 50))

            await asyncio.gather(*map(junk, range(20)))
            await good.send(PING)
            assert await asyncio.wait_for(good.recv(), 10) == PONG

    asyncio.run(scene())


@pytest.mark.parametrize(
    ("arguments", "words"),
    (
        (["--listen", "192.168.1.10"], "--certificate"),
        (["--broker-host", "192.168.1.10"], "--broker-ca"),
        (["--certificate", "a.pem"], "both or neither"),
        (["--certificate", "a.pem", "--key", "b.pem"], "readable files in PEM"),
    ),
)
def test_what_would_send_passwords_in_the_clear_is_refused(tmp_path, capsys, arguments, words):
    assert main(["--page", str(page(tmp_path)), *arguments]) == 1
    assert words in capsys.readouterr().out


def test_without_a_page_it_only_pipes(broker, tmp_path):
    async def scene() -> None:
        served = ServerSettings({}, None, BrokerAddress("127.0.0.1", BROKER_PORT))
        async with running(served), browser() as client:
            await client.send(login())
            assert await client.recv() == CONNACK_OK
            for path in ("/", "/index.html"):
                assert (await asyncio.to_thread(get, path))[0].status == 404

    asyncio.run(scene())


def test_a_login_that_comes_byte_by_byte_has_no_more_time(broker, tmp_path):
    async def scene() -> None:
        async with running(settings(tmp_path, limits=PipeLimits(login_s=0.5))), browser() as client:
            with contextlib.suppress(ConnectionClosed):
                for byte in login() * 100:
                    await client.send(bytes([byte]))
                    await asyncio.sleep(0.1)
            assert await closed(client) == (NOT_MQTT, "no CONNECT within 0.5 s")

    asyncio.run(scene())


def test_a_connection_that_asks_for_nothing_is_closed(tmp_path):
    async def scene() -> None:
        async with running(settings(tmp_path, limits=PipeLimits(login_s=0.5))):
            reader, writer = await asyncio.open_connection("127.0.0.1", PORT)
            with contextlib.suppress(ConnectionError):
                assert await asyncio.wait_for(reader.read(), 10) == b""
            writer.close()

    asyncio.run(scene())


@pytest.mark.parametrize("ends", ("with its request", "once it has all"))
def test_a_reader_that_has_its_file_takes_up_no_connection(tmp_path, caplog, ends):
    async def scene() -> None:
        # what has not left its place by then has to go for the next one, and is told
        async with running(settings(tmp_path, connections=ConnectionLimits(anonymous_per_address=4))):
            for _ in range(12):
                reader, writer = await asyncio.open_connection("127.0.0.1", PORT)
                writer.write(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{PORT}\r\n\r\n".encode())
                if ends == "with its request":
                    writer.write_eof()
                answer = await asyncio.wait_for(reader.read(), 10)
                assert answer.startswith(b"HTTP/1.1 200") and b"console</title>" in answer
                writer.close()
                await writer.wait_closed()

    asyncio.run(scene())
    assert "did not take all" not in caplog.text and "too many connections" not in caplog.text


def test_a_private_file_is_the_one_of_now(broker, tmp_path):
    private = tmp_path / "private"
    private.mkdir()
    (private / "building.glb").write_bytes(b"old")
    (private / "hostname").symlink_to("/etc/hostname")

    async def scene() -> None:
        async with running(settings(tmp_path, private=private)), browser() as client:
            ticket = client.response.headers["Set-Cookie"].partition(";")[0]
            await client.send(login())
            assert await client.recv() == CONNACK_OK
            _, body = await asyncio.to_thread(get, "/private/building.glb", Cookie=ticket)
            assert body == b"old"
            (private / "building.glb").write_bytes(b"a new one")
            _, body = await asyncio.to_thread(get, "/private/building.glb", Cookie=ticket)
            assert body == b"a new one"
            (private / "building.glb").unlink()
            for name in ("building.glb", "hostname"):
                answer, _ = await asyncio.to_thread(get, f"/private/{name}", Cookie=ticket)
                assert answer.status == 404, name

    asyncio.run(scene())


def test_what_could_not_be_delivered_is_never_delivered_later(tmp_path):
    """The broker stops reading; the browser is told and cut off; the broker reads again."""

    async def scene() -> None:
        came: list[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = []
        server = await asyncio.start_server(lambda *both: came.append(both), "127.0.0.1", 28483, limit=1024)
        limits = PipeLimits(bytes_per_s=1e9, burst_bytes=1e9, packets_per_s=1e6, burst_packets=1e6)
        served = settings(tmp_path, broker=BrokerAddress("127.0.0.1", 28483), limits=limits)
        async with server, running(served), browser() as client:
            await client.send(login())
            sent = bytearray()
            with pytest.raises(ConnectionClosed) as caught:
                for number in range(1000):
                    sent += (data := packet(3, number.to_bytes(4, "big") * 15_000))
                    await asyncio.wait_for(client.send(data), 10)
            assert caught.value.rcvd.code == BROKER_AWAY
            reader, writer = came[0]
            received = bytearray()
            with contextlib.suppress(ConnectionError):
                while data := await asyncio.wait_for(reader.read(65536), 10):
                    received += data
            # what was in the kernel's buffers at most; of the newest nothing
            assert len(received) < len(sent) - 60_000
            writer.close()

    asyncio.run(scene())


def test_a_site_s_accounts_come_through_with_tls_on_both_sides(tmp_path):
    site, port, broker_port = tmp_path / "site", 28484, 28485
    made = ["--host", "localhost", "--robot", "kr120", "--port", str(broker_port)]
    assert make_site.main([str(site), *made]) == 0
    configuration = tmp_path / "mosquitto.conf"
    configuration.write_text((site / "broker/mosquitto.conf").read_text() + "\nuser root\n")
    command = [
        sys.executable, Path(__file__).parents[3] / "nodes/console", "--port", str(port),
        "--certificate", site / "broker/server.crt", "--key", site / "broker/server.key",
        "--broker-host", "localhost", "--broker-port", str(broker_port), "--broker-ca", site / "ca/ca.crt",
    ]  # fmt: skip
    trust = ssl.create_default_context(cafile=site / "ca/ca.crt")

    async def answers(account: str, password: str, topic: str) -> tuple[int, int]:
        """Return the reason codes of the login and, 255 without one, of a message with QoS 1."""
        url, origin = f"wss://localhost:{port}/mqtt", f"https://localhost:{port}"
        async with websocket(url, ssl=trust, origin=origin, subprotocols=["mqtt"]) as client:
            assert "; Secure" in client.response.headers["Set-Cookie"]
            start = text("MQTT") + b"\x05\xc2\0\x0a\0" + text("tablet") + text(account) + text(password)
            await client.send(packet(1, start))
            accepted = (await asyncio.wait_for(client.recv(), 10))[3]
            if accepted:
                return accepted, 255
            await client.send(packet(3, text(topic) + b"\0\x01\0{}", flags=2))
            # a PUBACK without a reason code says 0
            return accepted, (await asyncio.wait_for(client.recv(), 10) + b"\0\0\0")[4]

    with started([MOSQUITTO, "-c", configuration], broker_port), started(command, port) as console:
        passwords = {
            name: (site / f"accounts/kr120-{name}/password").read_text().strip() for name in ("reviewer", "viewer")
        }
        review, refused = "twin/kr120/review/kr120-reviewer", 0x87
        assert asyncio.run(answers("kr120-reviewer", passwords["reviewer"], review))[0] == 0
        assert asyncio.run(answers("kr120-reviewer", passwords["reviewer"], review))[1] != refused
        assert asyncio.run(answers("kr120-viewer", passwords["viewer"], review)) == (0, refused)
        assert asyncio.run(answers("kr120-viewer", passwords["reviewer"], review)) == (refused, 255)
        with socket.create_connection(("127.0.0.1", port), 5) as plain:
            plain.sendall(f"GET / HTTP/1.1\r\nHost: localhost:{port}\r\n\r\n".encode())
            assert plain.recv(1000) == b"", "no page without TLS"
        console.send_signal(signal.SIGINT)
        said, _ = console.communicate(timeout=10)
    assert console.returncode == 0
    assert re.match(rf"console: wss://127.0.0.1:{port}/mqtt\n", said)

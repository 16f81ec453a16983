"""The console's program with real sockets and a real broker: what passes, what is refused, what is logged."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import gzip
import logging
import re
import shutil
import signal
import socket
import ssl
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import aiohttp
import pytest
from mqtt_packets import connect, packet, text
from piped_console import (
    CONNACK_OK,
    PING,
    PONG,
    Browser,
    browser_at,
    login,
    logs_in,
    serving,
)

from construction_twin.broker import make_site
from construction_twin.core.errors import ConfigurationError
from construction_twin.core.units import NANOSECONDS
from construction_twin.extensions.console.pipe import (
    BROKER_AWAY,
    NOT_MQTT,
    TOO_MUCH,
    BrokerAddress,
    PipeLimits,
    TokenBucket,
)
from construction_twin.extensions.console.program import main
from construction_twin.extensions.console.server import ServerSettings, origin_refusal

MOSQUITTO = shutil.which("mosquitto", path="/usr/sbin:/usr/bin")
PORT, BROKER_PORT, FAKE_BROKER_PORT = 28480, 28481, 28483
URL = f"http://127.0.0.1:{PORT}/"
PAGE = "<!doctype html><title>console</title>"
#: A browser's request for the WebSocket.
UPGRADE = (
    f"GET /mqtt HTTP/1.1\r\nHost: 127.0.0.1:{PORT}\r\n"
    f"Origin: {URL[:-1]}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Protocol: mqtt\r\n\r\n"
).encode()


@contextlib.contextmanager
def started(command: list, port: int) -> Iterator[subprocess.Popen]:
    """Start a program; wait until its port is open."""
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    try:
        end = time.monotonic() + 10
        while time.monotonic() < end and process.poll() is None:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
                break
            time.sleep(0.02)
        assert process.poll() is None
        yield process
    finally:
        process.terminate()
        process.communicate(timeout=10)


@pytest.fixture(scope="module")
def broker(tmp_path_factory) -> Iterator[None]:
    """Mosquitto with one account, `ada` with password `secret`."""
    folder = tmp_path_factory.mktemp("broker")
    passwords, configuration = folder / "passwords", folder / "mosquitto.conf"
    passwords.write_text("ada:secret\n")
    passwords.chmod(0o600)
    subprocess.run(["mosquitto_passwd", "-U", passwords], check=True)
    access = f"allow_anonymous false\npassword_file {passwords}\nuser root\n"
    configuration.write_text(f"listener {BROKER_PORT} 127.0.0.1\n{access}")
    with started([MOSQUITTO, "-c", configuration], BROKER_PORT):
        yield


def settings(folder: Path, **more) -> ServerSettings:
    (folder / "page/docs").mkdir(parents=True)
    (folder / "page/index.html").write_text(PAGE)
    (folder / "page/index.html.gz").write_bytes(gzip.compress(PAGE.encode()))
    (folder / "page/app-0123456789ab.js").write_text("export const answer = 42;\n" * 100)
    (folder / "private").mkdir()
    (folder / "private/robot.json").write_text("{}")
    values = {"private": folder / "private", "broker": BrokerAddress("127.0.0.1", BROKER_PORT)} | more
    return ServerSettings(folder / "page", **values)


def fake_broker(folder: Path, **more) -> ServerSettings:
    return settings(folder, broker=BrokerAddress("127.0.0.1", FAKE_BROKER_PORT), **more)


running = functools.partial(serving, port=PORT)
tab_of = functools.partial(browser_at, PORT)
browser = functools.partial(Browser, URL)


def test_bytes_reach_the_broker_and_come_back(broker, tmp_path, caplog):
    async def scene() -> None:
        async with running(settings(tmp_path)), tab_of() as tab:
            await logs_in(tab)
            # one packet in many frames, and many in one
            await tab.send(PING[:1])
            await tab.send(PING[1:] + PING)
            answer = b""
            while len(answer) < 4:
                answer += await tab.recv()
            assert answer == PONG + PONG

    with caplog.at_level(logging.INFO, "console"):
        asyncio.run(scene())
    assert "127.0.0.1 logged in" in caplog.text


def test_a_wrong_password_is_the_broker_s_answer_and_opens_nothing(broker, tmp_path, caplog):
    async def scene() -> None:
        async with running(settings(tmp_path, limits=PipeLimits(wrong_s=0.0))), browser() as stranger:
            async with stranger.tab() as tab:
                await tab.send(login(password="guess"))
                assert (await tab.recv())[3] == 5
                assert (await tab.closed())[0] == BROKER_AWAY
            assert await stranger.status("private/robot.json") == 403
            # who has mistyped gets in, and files go with the connection
            async with stranger.tab() as tab:
                assert await stranger.status("private/robot.json") == 403
                await logs_in(tab)
                answer, body = await stranger.get("private/robot.json")
                assert (answer.status, body) == (200, b"{}")
                async with browser() as other:
                    assert await other.status("private/robot.json") == 403
            async with asyncio.timeout(10):
                while await stranger.status("private/robot.json") != 403:
                    pass

    with caplog.at_level(logging.INFO, "console"):
        asyncio.run(scene())
    assert "127.0.0.1: wrong account or password" in caplog.text


def test_the_answer_to_a_wrong_password_comes_late_and_to_a_right_or_to_none_at_once(broker, tmp_path):
    async def scene() -> None:
        clock = asyncio.get_running_loop().time
        served = settings(tmp_path, limits=PipeLimits(wrong_s=1.0))
        async with running(served), tab_of() as tab:
            began = clock()
            await tab.send(login(password="guess"))
            await tab.recv()
            assert clock() - began >= 1.0
        # whatever comes at all here has not waited
        async with running(ServerSettings(None, None, served.broker, limits=PipeLimits(wrong_s=300.0))):
            async with tab_of() as tab:
                await logs_in(tab)
            for version, refused in ((4, 5), (5, 0x87)):
                async with tab_of() as tab:
                    await tab.send(connect(version=version))
                    assert (await tab.recv())[3] == refused

    asyncio.run(scene())


@pytest.mark.parametrize("closes", (0, 1))
def test_all_tabs_of_a_browser_are_one_session(broker, tmp_path, closes):
    """A second page begins with a connection that logs nobody in; both have files as long as one of them is logged in."""

    async def scene() -> None:
        async with running(settings(tmp_path)), browser() as mine, contextlib.AsyncExitStack() as open_tabs:
            answer, _ = await mine.get()
            assert "HttpOnly; SameSite=Strict" in answer.headers["Set-Cookie"]
            assert "Path" not in answer.headers["Set-Cookie"]
            tabs = [await open_tabs.enter_async_context(mine.tab()) for _ in range(2)]
            await logs_in(tabs[0])
            assert await mine.status("private/robot.json") == 200
            await logs_in(tabs[1])
            await tabs[closes].leave()
            assert await mine.status("private/robot.json") == 200
            await tabs[1 - closes].leave()
            async with asyncio.timeout(10):
                while await mine.status("private/robot.json") != 403:
                    pass

    asyncio.run(scene())


@pytest.mark.parametrize(
    "asked",
    ({"origin": None}, {"origin": "https://evil.example"}, {"origin": "http://127.0.0.1:1"}, {"protocols": ("other",)}),
)
def test_another_site_s_page_is_refused(broker, tmp_path, asked):
    async def scene() -> None:
        async with running(settings(tmp_path)):
            with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
                async with tab_of(**asked):
                    pass
            assert caught.value.status == 403

    asyncio.run(scene())


@pytest.mark.parametrize(
    ("origin", "host", "secure", "fits"),
    (
        ("http://127.0.0.1:8480", "127.0.0.1:8480", False, True),
        ("https://console.cell", "console.cell", True, True),
        ("https://console.cell:443", "console.cell", True, True),
        ("https://console.cell", "console.cell:443", True, True),
        ("http://console.cell", "console.cell", True, False),
        ("https://evil.example", "console.cell", True, False),
        ("https://console.cell.evil.example", "console.cell", True, False),
        ("https://console.cell@evil.example", "console.cell", True, False),
        ("null", "console.cell", True, False),
        ("https://[", "console.cell", True, False),
        (None, "console.cell", True, False),
        ("https://console.cell", None, True, False),
        ("https://other.cell", "console.cell", True, True),
        ("http://localhost:8480", "localhost:8480", False, True),
        ("http://[::1]:8480", "[::1]:8480", False, True),
        # the name of somebody else, who lets it lead to 127.0.0.1 once his page is loaded
        ("http://evil.example:8480", "evil.example:8480", False, False),
        ("http://localhost.evil.example", "localhost.evil.example", False, False),
        ("http://127.0.0.1:8480, http://127.0.0.1:8480", "127.0.0.1:8480", False, False),
    ),
)
def test_only_the_server_s_own_page_and_named_origins_may_connect(origin, host, secure, fits):
    assert bool(origin_refusal(origin, host, secure, frozenset({"https://other.cell"}))) is not fits


@pytest.mark.parametrize(
    ("sent", "code"),
    (
        ("a text frame", NOT_MQTT),
        (b"junk that is no MQTT", BROKER_AWAY),
        (connect() + connect(), BROKER_AWAY),
        (bytes(70_000), aiohttp.WSCloseCode.MESSAGE_TOO_BIG),
    ),
)
def test_what_is_no_mqtt_ends_the_connection_and_nobody_else_s(broker, tmp_path, sent, code):
    async def scene() -> None:
        async with running(settings(tmp_path)), tab_of() as good, tab_of() as bad:
            await logs_in(good)
            await bad.send(sent)
            assert (await bad.closed())[0] == code
            await good.send(PING)
            assert await good.recv() == PONG

    asyncio.run(scene())


def test_a_browser_s_packets_reach_the_broker_but_not_more_of_them_than_allowed(broker, tmp_path):
    limits = PipeLimits(frames_per_s=1.0, burst_frames=10.0)

    async def scene() -> None:
        async with running(settings(tmp_path, limits=limits)), tab_of() as loud:
            await logs_in(loud)
            with contextlib.suppress(ConnectionError):
                for _ in range(100):
                    await loud.send(PING)
            assert (await loud.closed())[0] == TOO_MUCH

    asyncio.run(scene())


def test_a_login_that_does_not_come_or_byte_by_byte_is_cut_off(broker, tmp_path):
    async def scene() -> None:
        async with running(settings(tmp_path, limits=PipeLimits(login_s=0.5))):
            async with tab_of() as tab:
                assert await tab.closed() == (NOT_MQTT, "no login within 0.5 s")
            async with tab_of() as tab:
                with pytest.raises(ConnectionError):
                    for byte in login():
                        await tab.send(bytes([byte]))
                        await asyncio.sleep(0.1)

    asyncio.run(scene())


def test_who_answers_no_ping_is_cut_off(broker, tmp_path):
    """No library is this browser: each of them answers pings by itself."""

    async def scene() -> None:
        async with running(settings(tmp_path, limits=PipeLimits(ping_s=0.3))):
            reader, writer = await asyncio.open_connection("127.0.0.1", PORT)
            # a short frame, masked with zeros
            writer.write(UPGRADE + bytes([0x82, 0x80 | len(login()), 0, 0, 0, 0]) + login())
            received = await asyncio.wait_for(reader.read(), 10)
            assert CONNACK_OK in received and b"\x89\0" in received
            writer.close()

    asyncio.run(scene())


def test_who_takes_nothing_of_what_he_is_shown_is_cut_off(tmp_path):
    ended = asyncio.Event()

    async def flood(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readexactly(len(login()))
        writer.write(CONNACK_OK)
        with contextlib.suppress(ConnectionError):
            while True:
                writer.write(packet(3, text("view") + bytes(60_000)))
                await writer.drain()
        ended.set()

    async def scene() -> None:
        server = await asyncio.start_server(flood, "127.0.0.1", FAKE_BROKER_PORT)
        served = fake_broker(tmp_path, stall_s=0.5, limits=PipeLimits(ping_s=300.0))
        async with server, running(served):
            reader, writer = await asyncio.open_connection("127.0.0.1", PORT, limit=1024)
            writer.write(UPGRADE + bytes([0x82, 0x80 | len(login()), 0, 0, 0, 0]) + login())
            await asyncio.wait_for(ended.wait(), 10)
            writer.transport.abort()

    asyncio.run(scene())


def test_a_broker_that_is_not_there_is_told_at_once(tmp_path):
    async def scene() -> None:
        async with running(fake_broker(tmp_path)), tab_of() as tab:
            code, why = await tab.closed()
            assert (code, why.startswith("the broker 127.0.0.1:28483 cannot be reached")) == (BROKER_AWAY, True)

    asyncio.run(scene())


def test_a_broker_that_goes_away_is_told(tmp_path):
    async def scene() -> None:
        gone: list[asyncio.StreamWriter] = []
        server = await asyncio.start_server(lambda reader, writer: gone.append(writer), "127.0.0.1", FAKE_BROKER_PORT)
        async with server, running(fake_broker(tmp_path)), tab_of() as tab:
            await tab.send(login())
            while not gone:
                await asyncio.sleep(0.01)
            gone[0].write(CONNACK_OK)
            assert await tab.recv() == CONNACK_OK
            gone[0].close()
            assert (await tab.closed())[0] == BROKER_AWAY

    asyncio.run(scene())


@pytest.mark.parametrize("answer", (CONNACK_OK, b"\x20\x03\0\0\0", b"\x20\x84\x01\0\0\x81\x01" + bytes(129)))
def test_a_client_that_subscribes_with_its_login_gets_a_long_message_with_the_answer(tmp_path, answer):
    """A client need not wait for CONNACK before it subscribes (MQTT 5.0, section 3.1.4): a stored plan may come with it."""
    long = packet(3, text("twin/kr120/plan") + b"x" * 100_000)

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readexactly(len(login()))
        writer.write(answer + long)
        await reader.read()  # new Pythons close the connection of a writer that nobody keeps

    async def scene() -> None:
        server = await asyncio.start_server(serve, "127.0.0.1", FAKE_BROKER_PORT)
        async with server, running(fake_broker(tmp_path)), browser() as mine, mine.tab() as tab:
            await tab.send(login())
            came = b""
            while len(came) < len(answer + long):
                came += await tab.recv()
            assert came == answer + long
            assert await mine.status("private/robot.json") == 200

    asyncio.run(scene())


def test_who_has_logged_in_stays_and_others_get_in_whoever_fills_the_places(broker, tmp_path):
    """Four addresses hold every connection: with nothing, half a request, a WebSocket that does not log in."""
    half = f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{PORT}\r\n".encode()

    async def scene() -> None:
        # nobody is cut off for being late
        served = settings(
            tmp_path, connections=24, connections_per_peer=8, ask_s=300.0, limits=PipeLimits(login_s=300.0)
        )
        async with running(served), tab_of() as first, contextlib.AsyncExitStack() as held:
            await logs_in(first)
            for number in range(80):
                address = f"127.0.0.{2 + number % 4}"
                _, writer = await asyncio.open_connection("127.0.0.1", PORT, local_addr=(address, 0))
                held.callback(writer.close)
                writer.write((b"", half, UPGRADE)[number // 4 % 3])
            async with browser() as late:
                assert await late.status("") == 200
                async with late.tab() as tab:
                    await logs_in(tab)
                    for each in (first, tab):
                        await each.send(PING)
                        assert await each.recv() == PONG

    asyncio.run(scene())


def test_who_has_left_takes_up_no_place(tmp_path):
    async def scene() -> None:
        async with running(settings(tmp_path, connections_per_peer=2, ask_s=300.0)):
            reader, writer = await asyncio.open_connection("127.0.0.1", PORT)
            for _ in range(6):
                async with browser() as other:
                    assert await other.status("") == 200
            writer.write(b"GET / HTTP/1.0\r\n\r\n")
            assert (await asyncio.wait_for(reader.read(), 10)).startswith(b"HTTP/1.0 200")
            writer.close()

    asyncio.run(scene())


def test_with_tls_nobody_s_unfinished_handshakes_keep_others_out(tmp_path):
    site = tmp_path / "site"
    assert make_site.main([str(site), "--host", "localhost", "--robot", "kr120"]) == 0
    own = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    own.load_cert_chain(site / "broker/server.crt", site / "broker/server.key")
    trust = ssl.create_default_context(cafile=site / "ca/ca.crt")

    async def scene() -> None:
        served = settings(tmp_path, connections=24, connections_per_peer=8, tls=own, ask_s=300.0)
        async with running(served), contextlib.AsyncExitStack() as held:
            ended = []
            for number in range(80):
                reader, writer = await asyncio.open_connection(
                    "127.0.0.1", PORT, local_addr=(f"127.0.0.{2 + number % 4}", 0)
                )
                held.callback(writer.close)
                ended.append(asyncio.create_task(reader.read()))
            # the oldest have ended, those that fill the connections have not
            done, pending = await asyncio.wait(ended[:56], timeout=10)
            assert len(done) == 56 and not pending
            assert not any(task.done() for task in ended[56:])
            async with Browser(f"https://localhost:{PORT}/", tls=trust) as browser:
                answer, _ = await browser.get()
                assert answer.status == 200 and "; Secure" in answer.headers["Set-Cookie"]

    asyncio.run(scene())


def test_the_page_comes_with_a_strict_policy_and_is_asked_for_again_only_when_it_changed(tmp_path):
    async def scene() -> None:
        async def kept(name: str) -> str:
            (tmp_path / "page" / name).parent.mkdir(exist_ok=True)
            (tmp_path / "page" / name).touch()
            return (await mine.get(name))[0].headers["Cache-Control"]

        async with running(settings(tmp_path)), browser() as mine:
            answer, body = await mine.get()
            assert (answer.status, body.decode(), answer.headers["Content-Encoding"]) == (200, PAGE, "gzip")
            policy = answer.headers["Content-Security-Policy"]
            assert "default-src 'none'" in policy and "unsafe" not in policy
            assert answer.headers["Cache-Control"] == "no-cache"
            answer, body = await mine.get("", **{"If-None-Match": answer.headers["ETag"]})
            assert (answer.status, body) == (304, b"")
            answer, _ = await mine.get("app-0123456789ab.js")
            assert answer.headers["Content-Type"].endswith("/javascript")
            for name in ("app-5UIZRSMC.js", f"mesh/{'0af9' * 16}.stl", "app-0123456789ab.js"):
                assert "immutable" in await kept(name)
            for name in ("index.html", "robot-description.json", "kr120.building.glb", "run-20261123.json"):
                assert await kept(name) == "no-cache"
            assert "default-src 'none'" in (await mine.get("nothing"))[0].headers["Content-Security-Policy"]

    asyncio.run(scene())


@pytest.mark.parametrize(
    "path",
    (
        "/nothing", "/docs", "/docs/", "/../robot.json", "/%2e%2e/private/robot.json", "/docs/..%2f..%2fprivate/robot.json",
        "//etc/passwd", "/%2fetc/passwd", "/hostname", "/%00", "/" + "a" * 5000, "/.hidden", "/private/", "/private/hostname",
        "/private/../page/index.html", "/private/%2e%2e/page/index.html", "/private//etc/passwd", "/private/.hidden",
    ),
)  # fmt: skip
def test_no_path_leads_out_of_a_folder(broker, tmp_path, path):
    async def scene() -> None:
        served = settings(tmp_path)
        for folder in ("page", "private"):
            (tmp_path / folder / "hostname").symlink_to("/etc/hostname")
            (tmp_path / folder / ".hidden").write_text("")
        async with running(served), browser() as mine, mine.tab() as tab:
            await logs_in(tab)
            cookie = (await mine.get())[0].request_info.headers["Cookie"]
            # a library would tidy the path up
            reader, writer = await asyncio.open_connection("127.0.0.1", PORT)
            writer.write(f"GET {path} HTTP/1.0\r\nCookie: {cookie}\r\n\r\n".encode())
            assert (await asyncio.wait_for(reader.readexactly(12), 10)) == b"HTTP/1.0 404"
            writer.close()

    asyncio.run(scene())


def test_who_is_logged_in_learns_who_has_which_right_as_it_is_now(broker, tmp_path):
    rights = tmp_path / "rights.json"

    async def scene() -> None:
        async with running(settings(tmp_path, rights=rights)), browser() as mine, mine.tab() as tab:
            assert await mine.status("private/rights.json") == 403
            await logs_in(tab)
            assert await mine.status("private/rights.json") == 404
            for sentence in ('{"robots": {}}', '{"robots": {"one": {"stop": {"ada": "ada"}}}}'):
                rights.write_text(sentence)
                answer, body = await mine.get("private/rights.json")
                assert (answer.status, body.decode()) == (200, sentence)
            # the file is read anew each time, as the robot's model
            (tmp_path / "private/robot.json").write_text("[]")
            assert (await mine.get("private/robot.json"))[1] == b"[]"

    asyncio.run(scene())


@pytest.mark.parametrize(
    ("arguments", "words"),
    (
        (["--broker-host", "192.168.1.10"], "--broker-ca"),
        (["--certificate", "a.pem"], "both or neither"),
    ),
)
def test_what_cannot_work_or_would_send_passwords_in_the_clear_is_refused(arguments, words):
    with pytest.raises(ConfigurationError, match=words):
        main(arguments)


def test_without_a_page_it_only_pipes(broker):
    async def scene() -> None:
        served = ServerSettings(None, None, BrokerAddress("127.0.0.1", BROKER_PORT))
        async with running(served), browser() as mine, mine.tab() as tab:
            await logs_in(tab)
            for path in ("", "index.html", "private/robot.json", "private/rights.json"):
                assert await mine.status(path) == 404

    asyncio.run(scene())


def test_what_could_not_be_delivered_is_never_delivered_later(tmp_path):
    """The broker stops reading; the browser is told and cut off; the broker reads again."""

    async def scene() -> None:
        came: list[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = []

        def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            writer.write(CONNACK_OK)
            came.append((reader, writer))

        server = await asyncio.start_server(accept, "127.0.0.1", FAKE_BROKER_PORT, limit=1024)
        limits = PipeLimits(bytes_per_s=1e9, burst_bytes=1e9, frames_per_s=1e6, burst_frames=1e6)
        async with server, running(fake_broker(tmp_path, limits=limits)), tab_of() as tab:
            await logs_in(tab)
            sent = bytearray()
            with contextlib.suppress(ConnectionError):
                for number in range(1000):
                    sent += (data := packet(3, number.to_bytes(4, "big") * 15_000))
                    await asyncio.wait_for(tab.send(data), 10)
            assert (await tab.closed())[0] == BROKER_AWAY
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
    people = ["--person", "ada:approve", "--person", "vic:look"]
    made = ["--host", "localhost", "--robot", "kr120", "--port", str(broker_port), *people]
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
        async with Browser(f"https://localhost:{port}/", tls=trust) as browser, browser.tab() as tab:
            start = text("MQTT") + b"\x05\xc2\0\x0a\0" + text("tablet") + text(account) + text(password)
            await tab.send(packet(1, start))
            accepted = (await tab.recv())[3]
            if accepted:
                return accepted, 255
            await tab.send(packet(3, text(topic) + b"\0\x01\0{}", flags=2))
            came = b""
            # PUBACK behind the rest of CONNACK; without a reason code it says 0
            while not (answer := re.search(rb"\x40[\x02-\x04]\0\x01(.?)", came, re.DOTALL)):
                came += await tab.recv()
            return accepted, (answer[1] + b"\0")[0]

    with started([MOSQUITTO, "-c", configuration], broker_port), started(command, port) as console:
        ada, vic = ((site / f"accounts/{name}/password").read_text().strip() for name in ("ada", "vic"))
        review, refused = "twin/kr120/review/ada", 0x87
        accepted, answer = asyncio.run(answers("ada", ada, review))
        assert accepted == 0 and answer != refused
        assert asyncio.run(answers("vic", vic, review)) == (0, refused)
        assert asyncio.run(answers("vic", ada, review)) == (refused, 255)
        with socket.create_connection(("127.0.0.1", port), 5) as plain:
            plain.sendall(f"GET / HTTP/1.1\r\nHost: localhost:{port}\r\n\r\n".encode())
            assert plain.recv(1000) == b"", "no page without TLS"
        console.send_signal(signal.SIGINT)
        said, _ = console.communicate(timeout=10)
    assert console.returncode == 0
    assert re.match(rf"console: wss://127.0.0.1:{port}/mqtt\n", said)


def test_an_allowance_is_used_up_and_grows_again():
    bucket = TokenBucket(rate=2, burst=4)
    assert [bucket.spend(0) for _ in range(5)] == [True] * 4 + [False]
    assert bucket.spend(NANOSECONDS // 2)
    assert not bucket.spend(NANOSECONDS // 2)
    # it never holds more than the burst, and a clock that goes back gives nothing
    assert not bucket.spend(1000 * NANOSECONDS, 4.5)
    assert not bucket.spend(0, 4.5)


def test_a_bucket_of_bytes_is_exact_at_its_border_whatever_the_clock_shows():
    bucket, now = TokenBucket(rate=65536, burst=262_144), 987_654_321_987_654_321
    assert all(bucket.spend(now, 1024) for _ in range(256)) and not bucket.spend(now, 1)
    assert bucket.spend(now + NANOSECONDS, 65536) and not bucket.spend(now + NANOSECONDS, 1)

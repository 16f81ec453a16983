"""A camera through the console, with real sockets and a real broker: who sees it, how old it is, and what ends it."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import json
import ssl
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from mjpeg_camera import MjpegCamera, jpeg
from mqtt_packets import packet, text
from processes import wait_until
from site_broker import Listener, SiteBroker, free_ports
from websockets.sync.client import connect as websocket

from construction_twin.console.camera import CameraLimits
from construction_twin.console.camera_delivery import HEAD
from construction_twin.console.pipe import BrokerAddress, PipeLimits
from construction_twin.console.server import ConsoleServer, ServerSettings
from construction_twin.core.camera_address import cameras_of

PEOPLE = {"viewers": ("vic",), "reviewers": ("ada",)}
TOPIC = "twin/one/camera/front"


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Iterator[SiteBroker]:
    made = SiteBroker(tmp_path_factory.mktemp("site"), certificates=False, plc=False, **PEOPLE)
    made.start()
    yield made
    made.stop()


@pytest.fixture
def camera() -> Iterator[MjpegCamera]:
    with MjpegCamera() as made:
        yield made


class Console:
    """The console's server in a thread of its own, for one camera `front` of robot one."""

    def __init__(self, site: SiteBroker, camera: MjpegCamera, right_s: float = 30.0, **limits):
        self.port = free_ports()
        tls = ssl.create_default_context(cafile=str(site.folder / "ca/ca.crt"))
        quick = {"first_wait_s": 0.1, "longest_wait_s": 0.4, "silence_s": 0.6, "connect_s": 2.0} | limits
        settings = ServerSettings(
            {},
            None,
            None,
            BrokerAddress("localhost", site.site.port, tls),
            cameras=cameras_of([f"front={camera.url}@one"]),
            camera_limits=CameraLimits(**quick),
            camera_right_s=right_s,
            limits=PipeLimits(stall_s=1.0),
        )
        self._loop = asyncio.new_event_loop()
        ready = threading.Event()

        async def serve() -> None:
            opened = asyncio.Event()
            self._task = asyncio.current_task()
            server = asyncio.create_task(ConsoleServer(settings).run("127.0.0.1", self.port, opened))
            await opened.wait()
            ready.set()
            await server

        def run() -> None:
            with contextlib.suppress(asyncio.CancelledError):
                self._loop.run_until_complete(serve())

        self._thread = threading.Thread(target=run, daemon=True)
        self._thread.start()
        assert ready.wait(10.0)

    def close(self) -> None:
        assert self._task is not None
        self._loop.call_soon_threadsafe(self._task.cancel)
        self._thread.join(10.0)


class Browser:
    """A session of an account through the console's pipe, which has subscribed to all cameras, and its cookie."""

    def __init__(self, console: Console, account: str, password: str, subscribe: str = "twin/+/camera/+"):
        self._console = console
        origin = f"http://127.0.0.1:{console.port}"
        self.socket = websocket(
            f"ws://127.0.0.1:{console.port}/mqtt", origin=origin, subprotocols=["mqtt"], compression=None, legacy=True
        )
        self.cookie = self.socket.response.headers["Set-Cookie"].partition(";")[0]
        name = text(f"test-{time.monotonic_ns()}")
        self.socket.send(packet(1, text("MQTT") + b"\x04\xc2\0\x3c" + name + text(account) + text(password)))
        assert self.socket.recv(10.0)[:4] == b"\x20\x02\0\0"
        self.heard = b""
        if subscribe:
            self.socket.send(packet(8, b"\0\1" + text(subscribe) + b"\0", 2))

    def hear(self, seconds: float = 0.5) -> bytes:
        """Return everything that comes within a while."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            with contextlib.suppress(TimeoutError):
                self.heard += self.socket.recv(left)
        return self.heard

    def wait_for_topic(self) -> None:
        while TOPIC.encode() not in self.heard:
            self.heard += self.socket.recv(10.0)

    def look(self, path: str = "one/front", method: str = "GET") -> Stream:
        return Stream(self._console.port, path, self.cookie, method)

    def close(self) -> None:
        self.socket.close()


class Stream:
    """What the console sends of a camera."""

    def __init__(self, port: int, path: str, cookie: str = "", method: str = "GET"):
        self._connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10.0)
        self._connection.request(method, f"/private/camera/{path}", headers={"Cookie": cookie})
        self.answer = self._connection.getresponse()
        self.status = self.answer.status

    def packet(self) -> tuple[bytes, int, int, bool] | None:
        """Return the next JPEG ("" for none), its age [ms], time of sending [ms], whether the camera is there; None at the end."""
        head = self.answer.read(HEAD.size)
        if len(head) < HEAD.size:
            return None
        length, age, sent, there = HEAD.unpack(head)
        return self.answer.read(length), age, sent, bool(there)

    def picture(self) -> bytes:
        while True:
            found = self.packet()
            assert found is not None, "the stream has ended"
            if found[0]:
                return found[0]

    def ended_within(self, seconds: float) -> bool:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if self.packet() is None:
                return True
        return False

    def close(self) -> None:
        self.answer.close()
        self._connection.close()


@pytest.fixture
def robot(site) -> Iterator[Listener]:
    """The robot's programs, which announce the camera."""
    account = site.broker(site.account("one-bridge"))
    listener = Listener(account, "twin/one/plan", "one-bridge")
    listener.publish(TOPIC, json.dumps({"name": "front"}).encode(), retain=True)
    yield listener
    listener.publish(TOPIC, b"", retain=True)
    listener.close()


@pytest.fixture
def make(site, camera) -> Iterator:
    """Returns a console, and a browser of an account at it."""
    consoles: list[Console] = []
    browsers: list[Browser] = []

    def console(**more) -> Console:
        consoles.append(Console(site, camera, **more))
        return consoles[-1]

    def browser(at: Console, account: str = "one-viewer-vic", **more) -> Browser:
        password = (Path(site.folder) / "accounts" / account / "password").read_text().strip()
        browsers.append(Browser(at, account, password, **more))
        return browsers[-1]

    console.browser = browser  # type: ignore[attr-defined]
    yield console
    for each in browsers:
        each.close()
    for each in consoles:
        each.close()


def test_who_may_read_the_topic_sees_the_newest_picture_with_its_age(make, camera, robot):
    browser = make.browser(make())
    browser.wait_for_topic()
    stream = browser.look()
    assert stream.status == 200 and stream.answer.headers["Cache-Control"] == "no-store"
    camera.picture = jpeg(10)
    while True:
        jpeg_bytes, age, sent, there = stream.packet()
        if jpeg_bytes == camera.picture:
            break
    assert there and age < 1000 and sent < 10_000
    assert camera.requests == ["GET /stream?size=small HTTP/1.0"]
    stream.close()
    # the last who leaves ends the camera's connection
    wait_until(lambda: camera.open == 0, what="the camera's connection ending")


def test_a_subscription_that_the_broker_grants_is_no_right_where_it_delivers_nothing(make, camera, robot):
    """mosquitto grants every subscription where its rules stand in a file, and delivers nothing then."""
    browser = make.browser(make(), "two-viewer-vic", subscribe=TOPIC)
    heard = browser.hear(1.0)
    assert b"\x90\x03\0\1\0" in heard and TOPIC.encode() not in heard
    assert browser.look().status == 403
    assert camera.connections == 0


def test_without_the_topic_a_login_or_a_cookie_there_is_no_picture(make, camera, robot):
    console = make()
    nobody = Stream(console.port, "one/front")
    assert nobody.status == 403
    # logged in, and the topic was never asked for: the broker has said nothing
    silent = make.browser(console, subscribe="")
    silent.hear(0.3)
    assert silent.look().status == 403
    guessed = Stream(console.port, "one/front", f"console_ticket_{console.port}=guessed")
    assert guessed.status == 403
    browser = make.browser(console)
    browser.wait_for_topic()
    # one that there is not is not told from one that may not be seen; no other method, and no other address
    for path in ("one/side", "two/front", "", "one/front/../front", "http://127.0.0.1:1/"):
        assert browser.look(path).status == 403
    assert browser.look(method="HEAD").status == 405 and browser.look(method="POST").status == 405
    assert camera.connections == 0


def test_a_message_that_a_browser_makes_up_is_none(make, camera, site):
    """Nobody announces the camera here; the browser publishes the topic itself, inside of other messages, too."""
    browser = make.browser(make())
    body = text(TOPIC) + b"{}"
    browser.socket.send(packet(3, body))
    browser.socket.send(packet(3, text("twin/one/other") + packet(3, body)))
    browser.hear(0.6)
    assert browser.look().status == 403


def test_a_right_that_is_not_repeated_ends_and_with_the_session_at_once(make, robot):
    console = make(right_s=1.5)
    browser = make.browser(console)
    browser.wait_for_topic()
    stream = browser.look()
    stream.picture()
    robot.publish(TOPIC, b"{}")
    assert stream.ended_within(4.0)
    assert browser.look().status == 403
    robot.publish(TOPIC, b"{}")
    browser.hear(0.3)
    stream = browser.look()
    stream.picture()
    browser.close()
    assert stream.ended_within(1.4)


def test_a_right_ends_with_its_session_though_the_account_has_another_one(make, robot):
    console = make()
    heard, other = make.browser(console), make.browser(console, subscribe="")
    heard.wait_for_topic()
    # a ticket each, and one account
    stream = other.look()
    stream.picture()
    heard.close()
    assert stream.ended_within(3.0)
    assert other.look().status == 403


def test_all_who_look_share_one_connection_and_there_are_not_too_many(make, camera, robot):
    console = make(viewers=3, viewers_per_browser=2)
    vic, ada = make.browser(console), make.browser(console, "one-reviewer-ada")
    for browser in (vic, ada):
        browser.wait_for_topic()
    streams = [vic.look(), vic.look()]
    assert [each.status for each in streams] == [200, 200] and vic.look().status == 503
    streams.append(ada.look())
    assert streams[2].status == 200 and ada.look().status == 503
    for each in streams:
        each.picture()
    assert camera.connections == 1
    for each in streams:
        each.close()


def test_a_frozen_camera_is_gone_and_comes_back(make, camera, robot):
    browser = make.browser(make())
    browser.wait_for_topic()
    stream = browser.look()
    stream.picture()
    camera.frozen = True
    end = time.monotonic() + 5.0
    while (found := stream.packet())[3]:
        # the age of what was shown rises, and no old picture is sent again
        last = found
        assert time.monotonic() < end, "the camera is gone, and its picture is not"
    assert last[1] < 1500 and found[0] == b""
    camera.frozen = False
    camera.picture = jpeg(200)
    while stream.picture() != camera.picture:
        pass
    assert camera.connections >= 2
    stream.close()


def test_a_camera_that_is_off_is_tried_less_and_less_often(make, camera, robot):
    camera.close()
    browser = make.browser(make())
    browser.wait_for_topic()
    stream = browser.look()
    assert stream.status == 200
    for _ in range(3):
        assert stream.packet() == (b"", 0, pytest.approx(1000, abs=2000), False)
    # it comes under the same address again
    with MjpegCamera(port=camera.port) as again:
        assert stream.picture() == again.picture
    stream.close()


def test_who_is_slow_gets_the_newest_picture_and_holds_nobody_up(make, camera, robot):
    console = make()
    slow, quick = make.browser(console), make.browser(console, "one-reviewer-ada")
    for browser in (slow, quick):
        browser.wait_for_topic()
    camera.picture = jpeg(50) + bytes(300_000) + b"\xff\xd9"
    waiting = slow.look()
    fast = quick.look()
    for _ in range(20):
        fast.picture()
    # nothing was read of the slow one: after a second in which it took nothing it is cut off
    time.sleep(2.5)
    fast.picture()
    taken = 0
    with contextlib.suppress(http.client.IncompleteRead, AssertionError, OSError):
        while taken < 200:
            waiting.picture()
            taken += 1
    assert taken < 20
    fast.close()

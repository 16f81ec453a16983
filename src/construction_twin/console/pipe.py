"""One browser's connection: bytes between its WebSocket and the broker's TCP port, cut off where they are no MQTT or too many.

The broker decides who may do what; the pipe keeps what is not MQTT, too long, too fast or from another site's page away from it. It
changes nothing, and never keeps a packet: a browser that is not connected cannot have one sent later.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from construction_twin.console.packets import WRONG_PASSWORD, ClientStream, PacketReader, reason_code
from construction_twin.core.errors import PayloadError
from construction_twin.core.rate_limit import TokenBucket
from construction_twin.core.sentences import Sentence

log = logging.getLogger("console")
#: Close codes that the page knows (RFC 6455 leaves 4000 to 4999 to applications).
BROKER_AWAY, NOT_MQTT, TOO_MUCH, TOO_SLOW = 4001, 4002, 4003, 4004
#: Longest wait for a browser to take the end of its WebSocket, and to answer it [s].
CLOSE_S = 1.0
#: Bytes that are read from the broker at once.
_CHUNK = 65536
#: A broker that answers or takes nothing on TCP is gone after so long [s]. Else a verdict would wait for a quarter of an hour, and
#: be delivered when the network is back.
BROKER_SILENCE = 2


@dataclass(frozen=True)
class PipeLimits:
    """What one connection may do.

    Attributes:
        largest: Longest packet of a browser [bytes]: a motion is the longest, and is for planners' programs, not for this page.
        packets_per_s, bytes_per_s: What a browser may send in the long run.
        burst_packets, burst_bytes: And at once.
        login_s: Longest wait for the broker, and from then on for the whole CONNECT [s].
        wrong_s: Delay of the broker's answer to a wrong password [s].
        stall_s: A browser that takes nothing for so long is cut off [s]: what is shown there is old.
        ping_s: Time between pings, and longest wait for an answer, whatever else comes [s]. A browser that does not answer is gone:
            what it had sent before, and comes later, is not passed on.
    """

    largest: int = 65536
    packets_per_s: float = 50.0
    bytes_per_s: float = 65536.0
    burst_packets: float = 200.0
    burst_bytes: float = 262144.0
    login_s: float = 5.0
    wrong_s: float = 1.0
    stall_s: float = 5.0
    ping_s: float = 3.0


@dataclass(frozen=True)
class BrokerAddress:
    """Where the broker is."""

    host: str
    port: int
    tls: ssl.SSLContext | None = None


class Cut(Exception):
    """The connection has to end: the close code, and one sentence."""

    def __init__(self, code: int, sentence: str):
        self.code, self.sentence = code, sentence
        super().__init__(sentence)


class Login(Protocol):
    """What is told about the login of one connection."""

    def accepted(self, account: str) -> str:
        """Note that the broker has accepted it; return why it may not stay all the same, or an empty text."""

    def wrong(self, account: str) -> None:
        """Note that the broker says that user name or password is wrong."""


async def pipe(
    browser: ServerConnection,
    broker: BrokerAddress,
    limits: PipeLimits,
    login: Login,
    clock: Callable[[], int] = time.monotonic_ns,
) -> str:
    """Carry bytes until one side ends; return in one sentence how it ended.

    Args:
        login: Gets to know what became of it.
        clock: Returns a time from any origin [ns].
    """
    try:
        connecting = asyncio.open_connection(broker.host, broker.port, ssl=broker.tls)
        reader, writer = await asyncio.wait_for(connecting, limits.login_s)
    except (OSError, TimeoutError) as error:
        await _close(browser, BROKER_AWAY, Sentence("view.pipe.unreachable"))
        return Sentence(
            "view.pipe.unreachable_at",
            host=broker.host,
            port=broker.port,
            problem=str(error) or Sentence("view.pipe.no_answer"),
        )
    _notice_silence(writer.get_extra_info("socket"))
    stream = ClientStream(limits.largest)
    up = asyncio.create_task(_from_browser(browser, writer, stream, limits, clock))
    down = asyncio.create_task(_from_broker(browser, reader, stream, limits, login))
    try:
        done, _ = await asyncio.wait((up, down), return_when=asyncio.FIRST_COMPLETED)
        cut = next((task.exception() for task in done if task.exception() is not None), None)
        if cut is None:
            # its DISCONNECT, so that the broker publishes no last will, and what came before it
            await _finish(writer)
            return Sentence("view.pipe.browser_left")
        # what has not reached the broker by now never shall: a verdict that comes late moves an arm that nobody watches
        writer.transport.abort()
        if not isinstance(cut, Cut):
            raise cut
        await _close(browser, cut.code, cut.sentence)
        return cut.sentence
    finally:
        for task in (up, down):
            task.cancel()
        await asyncio.gather(up, down, return_exceptions=True)
        writer.transport.abort()


async def _close(browser: ServerConnection, code: int, sentence: str) -> None:
    # the library's own limit begins when the close frame has gone out, and to who takes nothing it never does
    with contextlib.suppress(TimeoutError):
        # a reason of a close frame has at most 123 bytes
        await asyncio.wait_for(browser.close(code, sentence[:100].encode("ascii", "replace").decode()), CLOSE_S)
    browser.transport.abort()


def _notice_silence(broker: socket.socket) -> None:
    broker.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    broker.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, 1)
    broker.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 1)
    broker.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPCNT, BROKER_SILENCE)
    broker.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, BROKER_SILENCE * 1000)


async def _finish(writer: asyncio.StreamWriter) -> None:
    writer.close()
    # a connection that breaks while it ends has ended
    with contextlib.suppress(OSError, TimeoutError):
        await asyncio.wait_for(writer.wait_closed(), BROKER_SILENCE)


async def _from_browser(
    browser: ServerConnection,
    writer: asyncio.StreamWriter,
    stream: ClientStream,
    limits: PipeLimits,
    clock: Callable[[], int],
) -> None:
    packets = TokenBucket(limits.packets_per_s, limits.burst_packets)
    volume = TokenBucket(limits.bytes_per_s, limits.burst_bytes)
    # of the whole CONNECT, not of a frame: byte by byte it would take for ever
    deadline = asyncio.get_running_loop().time() + limits.login_s
    too_much = Sentence("view.pipe.too_much", packets=limits.packets_per_s, bytes=limits.bytes_per_s)
    while True:
        try:
            async with asyncio.timeout_at(None if stream.connected else deadline):
                message = await browser.recv()
        except TimeoutError as error:
            raise Cut(NOT_MQTT, Sentence("view.pipe.no_connect", seconds=limits.login_s)) from error
        except ConnectionClosed:
            return
        if isinstance(message, str):
            raise Cut(NOT_MQTT, Sentence("view.pipe.text_frame"))
        now = clock()
        if not volume.take(now, len(message)):
            raise Cut(TOO_MUCH, too_much)
        try:
            passed = stream.feed(message)
        except PayloadError as error:
            raise Cut(TOO_MUCH if error.reason == "size" else NOT_MQTT, str(error)) from error
        # an empty frame costs time too
        if not packets.take(now, max(1, len(passed))):
            raise Cut(TOO_MUCH, too_much)
        for packet in passed:
            writer.write(packet.data)
        try:
            await asyncio.wait_for(writer.drain(), BROKER_SILENCE)
        except TimeoutError as error:
            raise Cut(BROKER_AWAY, Sentence("view.pipe.broker_slow", seconds=BROKER_SILENCE)) from error
        except OSError as error:
            raise Cut(BROKER_AWAY, Sentence("view.pipe.broken", problem=str(error))) from error


async def _from_broker(
    browser: ServerConnection,
    reader: asyncio.StreamReader,
    stream: ClientStream,
    limits: PipeLimits,
    login: Login,
) -> None:
    answer: PacketReader | None = PacketReader(limits.largest)
    refused = False
    while True:
        try:
            data = await reader.read(_CHUNK)
        except OSError as error:
            raise Cut(BROKER_AWAY, Sentence("view.pipe.broken", problem=str(error))) from error
        if not data and stream.ended:
            return
        if not data and refused:
            raise Cut(BROKER_AWAY, Sentence("view.pipe.refused"))
        if not data:
            raise Cut(BROKER_AWAY, Sentence("view.pipe.ended"))
        if answer is not None:
            try:
                first = answer.first(data)
            except PayloadError as error:
                raise Cut(BROKER_AWAY, Sentence("view.pipe.no_broker", problem=str(error))) from error
            if first is not None:
                answer = None
                code = reason_code(first)
                refused = code != 0
                # an attempt without any, as the page's first one, is no guess
                if code in WRONG_PASSWORD and not stream.anonymous:
                    login.wrong(stream.account)
                    await asyncio.sleep(limits.wrong_s)
                if not refused and (why := login.accepted(stream.account)):
                    raise Cut(TOO_MUCH, why)
        try:
            await asyncio.wait_for(browser.send(data), limits.stall_s)
        except TimeoutError as error:
            raise Cut(TOO_SLOW, Sentence("view.pipe.browser_slow", seconds=limits.stall_s)) from error
        except ConnectionClosed:
            return

"""One browser's connection: bytes between its WebSocket and the broker's TCP port, unchanged.

The broker decides who may do what. The pipe reads whether it has accepted the login, cuts off who sends too much, and keeps
nothing: a browser that is not connected cannot have a packet sent later.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
import time
from collections.abc import Callable
from dataclasses import dataclass

from aiohttp import WSMsgType, web

from construction_twin.core.units import NANOSECONDS

#: Close codes that the page knows (RFC 6455 leaves 4000 to 4999 to applications).
BROKER_AWAY, NOT_MQTT, TOO_MUCH = 4001, 4002, 4003
#: Answers to a login by which the broker says that account or password is wrong: MQTT 3.1.1, 3.2.2.3, and MQTT 5.0, 3.2.2.2.
WRONG_PASSWORD = frozenset((4, 5, 134, 135))
#: Longest wait for a browser to take the end of its WebSocket, and to answer it [s].
_CLOSE_S = 1.0
#: Bytes that are read from the broker at once.
_CHUNK = 65536
#: A broker that answers or takes nothing on TCP is gone after so long [s]. Else a verdict would wait for a quarter of an hour, and
#: be delivered when the network is back.
_BROKER_SILENCE_S = 2.0


@dataclass(frozen=True)
class PipeLimits:
    """What one connection may send, in the long run and at once.

    Attributes:
        largest: Longest frame [bytes].
        login_s: Longest wait for the broker, and then for its answer to the login [s].
        wrong_s: Delay of the answer to a wrong password [s].
        ping_s: Silence before a ping; after half as much again the browser is gone [s].
    """

    largest: int = 65536
    frames_per_s: float = 50.0
    bytes_per_s: float = 65536.0
    burst_frames: float = 200.0
    burst_bytes: float = 262144.0
    login_s: float = 5.0
    wrong_s: float = 1.0
    ping_s: float = 3.0


@dataclass(frozen=True)
class BrokerAddress:
    """Where the broker is."""

    host: str
    port: int
    tls: ssl.SSLContext | None = None


class PipeClosed(Exception):
    """The connection has to end: the close code, and why."""

    def __init__(self, code: int, why: str):
        self.code = code
        super().__init__(why)


def drop_silent_peer(connection: socket.socket, seconds: float) -> None:
    """Let the kernel end a connection after so many seconds without an acknowledgement of the peer."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPIDLE, max(1, round(seconds / 2)))
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_KEEPINTVL, 1)
    # counts in place of the number of keep-alive probes, and for a window that stays closed
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(seconds * 1000))


class TokenBucket:
    """Tokens that are used up and come back at a rate."""

    __slots__ = ("_burst", "_owed", "_rate", "_updated_at")

    def __init__(self, rate: float, burst: float):
        self._rate = rate
        # tokens are counted in ns, so that whole rates and bursts are exact
        self._burst = burst * NANOSECONDS
        self._owed: float = 0
        self._updated_at = 0

    def spend(self, now: int, amount: float = 1) -> bool:
        """Spend `amount` tokens; return False, and spend none, where there are fewer."""
        # a clock that goes back gives nothing
        owed = max(0, self._owed - max(0, now - self._updated_at) * self._rate) + amount * NANOSECONDS
        if owed > self._burst:
            return False
        self._owed, self._updated_at = owed, now
        return True


class Pipe:
    """Carries the bytes of one browser, and reports an accepted or a wrong login."""

    def __init__(
        self,
        browser: web.WebSocketResponse,
        limits: PipeLimits,
        on_accepted: Callable[[], None],
        on_wrong: Callable[[], None],
    ):
        self._browser = browser
        self._limits = limits
        self._on_accepted, self._on_wrong = on_accepted, on_wrong
        self._is_anonymous = False

    async def run(self, broker: BrokerAddress) -> str:
        """Carry bytes until one side ends; return how it ended."""
        try:
            async with asyncio.timeout(self._limits.login_s):
                reader, writer = await asyncio.open_connection(broker.host, broker.port, ssl=broker.tls)
        except (OSError, TimeoutError) as error:
            why = f"the broker {broker.host}:{broker.port} cannot be reached: {error or 'no answer'}"
            await self._close(BROKER_AWAY, why)
            return why
        drop_silent_peer(writer.get_extra_info("socket"), _BROKER_SILENCE_S)
        tasks = (
            asyncio.create_task(self._forward_to_broker(writer)),
            asyncio.create_task(self._forward_to_browser(reader)),
        )
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                task.result()
            # its DISCONNECT, so that the broker publishes no last will, and what came before it
            writer.close()
            with contextlib.suppress(OSError, TimeoutError):
                await asyncio.wait_for(writer.wait_closed(), _BROKER_SILENCE_S)
            return "the browser has left"
        except PipeClosed as closed:
            # what has not reached the broker by now is dropped: a late verdict would move an unwatched arm
            writer.transport.abort()
            await self._close(closed.code, str(closed))
            return str(closed)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            writer.transport.abort()

    async def _close(self, code: int, why: str) -> None:
        # to who takes nothing the library waits for ever; a reason has at most 123 bytes
        with contextlib.suppress(OSError, TimeoutError):
            reason = why[:100].encode("ascii", "replace")
            await asyncio.wait_for(self._browser.close(code=code, message=reason), _CLOSE_S)

    async def _forward_to_broker(self, writer: asyncio.StreamWriter) -> None:
        """Carry what the browser sends, until it leaves."""
        limits = self._limits
        frames = TokenBucket(limits.frames_per_s, limits.burst_frames)
        volume = TokenBucket(limits.bytes_per_s, limits.burst_bytes)
        is_first = True
        async for message in self._browser:
            if message.type is WSMsgType.ERROR:
                return
            if message.type is not WSMsgType.BINARY:
                raise PipeClosed(NOT_MQTT, "a text frame; MQTT is binary")
            now = time.monotonic_ns()
            if not frames.spend(now) or not volume.spend(now, len(message.data)):
                raise PipeClosed(
                    TOO_MUCH, f"more than {limits.frames_per_s:g} frames or {limits.bytes_per_s:g} bytes per second"
                )
            if is_first:
                is_first, self._is_anonymous = False, has_no_account(message.data)
            writer.write(message.data)
            try:
                await asyncio.wait_for(writer.drain(), _BROKER_SILENCE_S)
            except (OSError, TimeoutError) as error:
                raise PipeClosed(BROKER_AWAY, f"the broker takes nothing: {error or 'no answer'}") from error

    async def _forward_to_browser(self, reader: asyncio.StreamReader) -> None:
        """Carry what the broker sends, until the browser has left."""
        try:
            async with asyncio.timeout(self._limits.login_s):
                answer = await read_connack(reader)
        except TimeoutError as error:
            raise PipeClosed(NOT_MQTT, f"no login within {self._limits.login_s:g} s") from error
        except (OSError, asyncio.IncompleteReadError) as error:
            raise PipeClosed(BROKER_AWAY, "the broker has closed the connection") from error
        # an attempt without any account, as the page's first one, is no guess
        if answer[-1] in WRONG_PASSWORD and not self._is_anonymous:
            self._on_wrong()
            await asyncio.sleep(self._limits.wrong_s)
        if answer[-1] == 0:
            self._on_accepted()
        while answer:
            try:
                await self._browser.send_bytes(answer)
            except ConnectionError:
                return
            try:
                answer = await reader.read(_CHUNK)
            except OSError as error:
                raise PipeClosed(BROKER_AWAY, f"the broker is silent: {error}") from error
        raise PipeClosed(BROKER_AWAY, "the broker has closed the connection")


async def read_connack(reader: asyncio.StreamReader) -> bytes:
    """Return the broker's answer to a login up to its reason code (MQTT 5.0, section 3.2); `PipeClosed` without a broker."""
    # type, length, flags, reason code; each byte of the length says whether another one follows
    answer = await reader.readexactly(4)
    length = 1
    while answer[length] & 0x80 and length < 4:
        answer += await reader.readexactly(1)
        length += 1
    if answer[0] != 0x20:
        raise PipeClosed(BROKER_AWAY, "what answers there is no MQTT broker")
    return answer


def has_no_account(connect: bytes) -> bool:
    """Return whether the first bytes of a client are an anonymous CONNECT (MQTT 5.0, section 3.1.2)."""
    # name of the protocol, version, flags; what stands before the name is too short to hold it
    name = connect.find(b"\0\4MQTT")
    return name >= 0 and len(connect) > name + 7 and not connect[name + 7] & 0xC0

"""The console's server: files over HTTP, and WebSockets that are piped to the broker."""

from __future__ import annotations

import asyncio
import contextlib
import dataclasses
import http
import logging
import secrets
import socket
import ssl
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from construction_twin.console.connection_limits import ConnectionLimits, OpenConnections
from construction_twin.console.http_connection import HttpConnection, connection_type
from construction_twin.console.listener import Listener, listeners
from construction_twin.console.pipe import CLOSE_S, BrokerAddress, PipeLimits, pipe
from construction_twin.console.static_files import FileCache, StaticFile, names
from construction_twin.console.tickets import Tickets
from construction_twin.core.errors import ConfigurationError
from construction_twin.core.network import is_loopback
from construction_twin.core.rate_limit import TokenBucket


class Lines:
    """Lines that others can cause: not more of them than a disk can hold; the next one says how many were left out.

    Args:
        rate, burst: So many per second in the long run, and at once.
        clock: Returns a time from any origin [ns].
    """

    def __init__(self, rate: float, burst: float, clock: Callable[[], int]):
        self._clock = clock
        self._bucket = TokenBucket(rate, burst)
        self._left_out = 0

    def write(self, level: int, sentence: str) -> None:
        """Write a line, or count it."""
        if self._bucket.take(self._clock()):
            more = f" ({self._left_out} lines before it were left out)" if self._left_out else ""
            log.log(level, "%s%s", sentence, more)
            self._left_out = 0
        else:
            self._left_out += 1


class Logins:
    """The logins of a server.

    Args:
        clock: Returns a time from any origin [ns].
    """

    def __init__(self, connections: OpenConnections, tickets: Tickets, clock: Callable[[], int]):
        self.connections = connections
        self.tickets = tickets
        self.lines = Lines(1, 20, clock)
        self.wrong_lines = Lines(1, 20, clock)


class ConnectionLogin:
    """The login of one connection, as the pipe tells of it.

    Args:
        number: Of the connection, by which its place is known.
        peer: Its address.
        ticket: Of its browser.

    Attributes:
        is_wrong: Its password was refused, which has been told.
    """

    def __init__(self, logins: Logins, number: int, peer: str, ticket: str):
        self._logins = logins
        self._number, self._peer, self._ticket = number, peer, ticket
        self._account: str | None = None
        self.is_wrong = False

    def accepted(self, account: str) -> str:
        """Note that the broker has accepted it; return why it may not stay all the same, or an empty text."""
        logins = self._logins
        if why := logins.connections.login(self._number, account):
            logins.lines.write(logging.WARNING, f"{self._peer} refused as {shown(account)}: {why}")
            return why
        self._account = account
        logins.tickets.login(self._ticket, account)
        logins.lines.write(logging.INFO, f"{self._peer} logged in as {shown(account)}")
        return ""

    def wrong(self, account: str) -> None:
        """Note that the broker says that user name or password is wrong."""
        self.is_wrong = True
        self._logins.wrong_lines.write(logging.WARNING, f"{self._peer}: wrong password for {shown(account)}")

    def end(self) -> None:
        """Note that the connection has ended."""
        if self._account is not None:
            self._logins.tickets.logout(self._ticket, self._account)


def shown(account: str) -> str:
    """Return an account for the log: a browser chooses the text."""
    return repr(account[:64]) if account else "nobody (no account)"


log = logging.getLogger("console")
#: Bytes that are written at once.
_PIECE = 65536
#: What the kernel keeps of an answer [bytes]: much more, and a slow reader would seem to take nothing for a long time.
_KERNEL = 262144
#: A reader that takes less in the long run is cut off [bytes/s]: a building model of 64 MB may take more than an hour.
SLOWEST = 16384


async def deliver(connection: HttpConnection, request: Request, answer: Response, stall_s: float) -> bool:
    """Write an answer and end the connection; return whether the reader took it.

    In pieces, each when the one before has gone out: `websockets` writes all at once, in the time that the end of a WebSocket has.

    Args:
        connection: The connection, whose request has been read.
        request: Of a HEAD only the head of the answer is written.
        answer: Whole, with its length and ``Connection: close``.
        stall_s: A reader that takes nothing for so long is cut off [s], and whoever takes longer than this and the body at
            `SLOWEST`.
    """
    transport = connection.transport
    kernel = transport.get_extra_info("socket")
    kernel.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _KERNEL)
    # a drained connection is one whose bytes have left this process; with a limit of 0 asyncio's TLS pauses with nothing to write
    transport.set_write_buffer_limits(high=1, low=0)
    body = b"" if request.method == "HEAD" else answer.body
    head = dataclasses.replace(answer, body=b"").serialize()
    try:
        async with asyncio.timeout(stall_s + len(body) / SLOWEST):
            for piece in (head, *(body[at : at + _PIECE] for at in range(0, len(body), _PIECE))):
                if transport.is_closing():
                    return False
                transport.write(piece)
                async with asyncio.timeout(stall_s):
                    await connection.drain()
            # the rest is in the kernel. With TLS, closing waits for the reader; without, only the reader's own end shows that it
            # has all, and a connection that is closed before the reader has stopped writing is reset
            if transport.can_write_eof() and not connection.half_closed:
                connection.written = True
                transport.write_eof()
            else:
                transport.close()
            async with asyncio.timeout(stall_s):
                await connection.wait_closed()
    except (TimeoutError, OSError):
        return False
    finally:
        transport.abort()
        await connection.wait_closed()
    return True


def origin_refusal(origin: str | None, host: str | None, secure: bool, allowed: frozenset[str]) -> str:
    """Return in one sentence why a page may not open a WebSocket; "" when it may (RFC 6455, section 10.2).

    The name that the browser connected to counts as well: after DNS rebinding a foreign page has the same origin as this server.

    Args:
        origin: Header `Origin`.
        host: Header `Host`.
        secure: The server speaks TLS.
        allowed: Further origins that may, as browsers write them: ``https://console.cell``.
    """
    if origin is None:
        return "no Origin: expected a browser's request"
    if origin in allowed:
        return ""
    own = f"{'https' if secure else 'http'}://{host}"
    place = place_of(own) if host else None
    if place is not None and not secure and not is_loopback(place[1]):
        return f"host {place[1][:100]!r}; expected localhost or a loopback address, because there is no TLS"
    # parsed, not compared as text: a browser leaves the default port out of both or of one
    if place is not None and place_of(origin) == place:
        return ""
    return f"origin {origin[:100]!r}; expected the page of this server, {own[:100]!r}"


def place_of(url: str) -> tuple[str, str, int] | None:
    """Return scheme, name and port of an address without a path; None when it is none."""
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        return None
    if parts.scheme not in ("http", "https") or not parts.hostname or parts.path or parts.query or parts.username:
        return None
    return parts.scheme, parts.hostname, port or {"http": 80, "https": 443}[parts.scheme]


#: Path of the WebSocket, and of what only who is logged in gets.
SOCKET, PRIVATE = "/mqtt", "/private/"
#: Below `PRIVATE`: who has which right.
RIGHTS = "rights.json"
#: The subprotocol that MQTT has for WebSockets (MQTT 5.0, section 6).
SUBPROTOCOL = "mqtt"
#: No script, style, picture or connection but this server's own; nothing may frame the page.
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "manifest-src 'self'; worker-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)


@dataclass(frozen=True)
class ServerSettings:
    """What the server serves, and to whom.

    Attributes:
        files: The page, for everybody, by path; empty for a console that only pipes.
        private: Folder of files for who is logged in: robot model, scene, building model.
        origins: Further origins whose pages may connect.
        rights: `rights.json` of `make_site`; None: the page does not know who may do what.
        file_stall_s: Who takes nothing of a file for so long is cut off [s].
    """

    files: Mapping[str, StaticFile]
    private: Path | None
    broker: BrokerAddress
    origins: frozenset[str] = frozenset()
    tls: ssl.SSLContext | None = None
    limits: PipeLimits = field(default_factory=PipeLimits)
    connections: ConnectionLimits = field(default_factory=ConnectionLimits)
    file_stall_s: float = 20.0
    rights: Path | None = None


class ConsoleServer:
    """Answers requests; knows who is connected, and who is logged in."""

    def __init__(self, settings: ServerSettings):
        self._settings = settings
        self._connections = OpenConnections(settings.connections)
        self._logins = Logins(self._connections, _tickets(0), time.monotonic_ns)
        self._delivering: set[HttpConnection] = set()
        self._cache = FileCache()
        self._lines = Lines(1, 20, time.monotonic_ns)

    async def run(self, host: str, port: int, ready: asyncio.Event | None = None) -> None:
        """Serve until cancelled.

        Args:
            ready: Set when the port is open.
        """
        self._logins.tickets = _tickets(port)
        async with contextlib.AsyncExitStack() as serving:
            for listener in await listeners(host, port, self._connections, self._on_full):
                await serving.enter_async_context(self._serve(listener))
            if ready is not None:
                ready.set()
            try:
                await asyncio.Event().wait()
            finally:
                # the library waits for whoever still answers a request
                for client in tuple(self._delivering):
                    client.transport.abort()

    def _serve(self, listener: Listener) -> AbstractAsyncContextManager[object]:
        settings = self._settings
        return serve(
            self._on_socket,
            sock=listener,
            subprotocols=[SUBPROTOCOL],  # type: ignore[list-item]  # a NewType of str
            process_request=self._on_request,
            process_response=self._on_response,
            compression=None,  # what is sent is small, and latency counts
            max_size=settings.limits.largest + 16,
            max_queue=16,
            open_timeout=None,  # a client has little time to ask, a file more to go out
            close_timeout=CLOSE_S,
            ping_interval=settings.limits.ping_s,
            ping_timeout=settings.limits.ping_s,
            server_header=None,
            create_connection=connection_type(settings.limits.login_s),
            ssl=settings.tls,
            ssl_handshake_timeout=settings.limits.login_s if settings.tls else None,
            # the library's would be close_timeout, and what a reader has not taken by then would be dropped
            ssl_shutdown_timeout=settings.file_stall_s if settings.tls else None,
        )

    def _on_full(self, peer: str) -> None:
        self._lines.write(logging.WARNING, f"{peer}: too many connections; its oldest one without a login had to go")

    # -- files

    async def _on_request(self, connection: ServerConnection, request: Request) -> Response | None:
        path = _path(request)
        if path == SOCKET:
            return self._refuse_socket(connection, request)
        assert isinstance(connection, HttpConnection)
        answer = await self._answer_to(path, request)
        peer = _peer(connection)
        self._delivering.add(connection)
        try:
            if not await deliver(connection, request, answer, self._settings.file_stall_s):
                self._lines.write(logging.WARNING, f"{peer} did not take all of {path[:100]!r}")
        finally:
            self._delivering.discard(connection)
        # the connection has ended: the library sends nothing more
        return answer

    async def _answer_to(self, path: str, request: Request) -> Response:
        if request.method not in ("GET", "HEAD"):
            return _answer(http.HTTPStatus.METHOD_NOT_ALLOWED, b"only GET and HEAD\n")
        if path.startswith(PRIVATE):
            if not self._logins.tickets.is_known(_joined(request.headers, "Cookie", "; ")):
                return _answer(http.HTTPStatus.FORBIDDEN, b"log in first\n")
            # in a thread: reading and compressing must not keep the other connections waiting
            return await asyncio.to_thread(self._private, path.removeprefix(PRIVATE), request)
        file = self._settings.files.get("/index.html" if path == "/" else path)
        if file is None:
            return _answer(http.HTTPStatus.NOT_FOUND, b"no such page\n")
        return _file_answer(file, request)

    def _private(self, name: str, request: Request) -> Response:
        settings = self._settings
        path = None
        if name == RIGHTS:
            path = settings.rights
        elif settings.private is not None:
            path = names(settings.private).get(name)
        try:
            file = None if path is None else self._cache.read(path)
        except ConfigurationError as error:
            log.warning("%s", error)
            return _answer(
                http.HTTPStatus.INTERNAL_SERVER_ERROR, b"the file is too large; the console's log names it\n"
            )
        if file is None:
            return _answer(http.HTTPStatus.NOT_FOUND, b"no such file\n")
        return _file_answer(file, request, private=True)

    # -- the pipe

    def _refuse_socket(self, connection: ServerConnection, request: Request) -> Response | None:
        settings, headers = self._settings, request.headers
        peer = _peer(connection)
        origin, host = _joined(headers, "Origin", ", "), _joined(headers, "Host", ", ")
        why = origin_refusal(origin, host, settings.tls is not None, settings.origins)
        spoken = _joined(headers, "Sec-WebSocket-Protocol", ",") or ""
        if not why and SUBPROTOCOL not in [word.strip() for word in spoken.split(",")]:
            why = f"no subprotocol {SUBPROTOCOL}"
        if why:
            self._lines.write(logging.WARNING, f"{peer} refused: {why}")
            return _answer(http.HTTPStatus.FORBIDDEN, f"{why}\n".encode())
        return None

    def _on_response(self, connection: ServerConnection, request: Request, response: Response) -> Response | None:
        if response.status_code == http.HTTPStatus.SWITCHING_PROTOCOLS:
            assert isinstance(connection, HttpConnection)
            connection.ticket = self._logins.tickets.give(_joined(request.headers, "Cookie", "; "))
            response.headers["Set-Cookie"] = self._logins.tickets.cookie(
                connection.ticket, self._settings.tls is not None
            )
        return response

    async def _on_socket(self, connection: ServerConnection) -> None:
        assert isinstance(connection, HttpConnection)
        number, peer = connection.transport.get_extra_info("socket").fileno(), _peer(connection)
        login = ConnectionLogin(self._logins, number, peer, connection.ticket)
        try:
            how = await pipe(connection, self._settings.broker, self._settings.limits, login)
            # a wrong password has had its line
            if not login.is_wrong:
                self._lines.write(logging.INFO, f"{peer}: {how}")
        finally:
            login.end()


def _joined(headers: Headers, name: str, between: str) -> str | None:
    """Return a header, and all of them where a request has several of that name; None when it has none."""
    return between.join(headers.get_all(name)) or None


def _path(request: Request) -> str:
    return request.path.partition("?")[0]


def _tickets(port: int) -> Tickets:
    return Tickets(lambda: secrets.token_urlsafe(24), port)


def _peer(connection: ServerConnection) -> str:
    return str(connection.remote_address[0])


def _answer(status: http.HTTPStatus, body: bytes) -> Response:
    headers = {
        "Content-Type": "text/plain; charset=utf-8",
        "Content-Length": str(len(body)),
        "Cache-Control": "no-store",
        "Connection": "close",
    }
    return Response(status.value, status.phrase, Headers(headers | _COMMON | {"Content-Security-Policy": POLICY}), body)


_LASTING = "max-age=31536000, immutable"
_COMMON = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


def _file_answer(file: StaticFile, request: Request, private: bool = False) -> Response:
    headers = _COMMON | {
        "Content-Security-Policy": POLICY,
        "Content-Type": file.kind,
        "ETag": file.tag,
        "Vary": "Accept-Encoding",
        "Cache-Control": ("private, " if private else "") + (_LASTING if file.lasting else "no-cache"),
        "Connection": "close",
    }
    if request.headers.get("If-None-Match") == file.tag:
        return Response(304, "Not Modified", Headers(headers), b"")
    body = file.body
    if file.compressed is not None and "gzip" in request.headers.get("Accept-Encoding", ""):
        headers["Content-Encoding"] = "gzip"
        body = file.compressed
    headers["Content-Length"] = str(len(body))
    return Response(200, "OK", Headers(headers), body)

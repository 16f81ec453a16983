"""The console's server: files over HTTP, and WebSockets that are piped to the broker."""

from __future__ import annotations

import asyncio
import contextlib
import http
import logging
import secrets
import ssl
import time
from collections.abc import Mapping
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from pathlib import Path

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from construction_twin.console.connection_limits import ConnectionLimits, OpenConnections
from construction_twin.console.delivery import deliver
from construction_twin.console.http_connection import HttpConnection, connection_type
from construction_twin.console.listener import Listener, listeners
from construction_twin.console.logins import ConnectionLogin, Lines, Logins
from construction_twin.console.origin import refusal
from construction_twin.console.pipe import CLOSE_S, BrokerAddress, PipeLimits, pipe
from construction_twin.console.static_files import FileCache, StaticFile, names
from construction_twin.console.tickets import Tickets
from construction_twin.core.errors import ConfigurationError

log = logging.getLogger("console")
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
        why = refusal(origin, host, settings.tls is not None, settings.origins)
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

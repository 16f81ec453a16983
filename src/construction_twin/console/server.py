"""The console's server: files over HTTP, and WebSockets that are piped to the broker."""

from __future__ import annotations

import asyncio
import contextlib
import http
import json
import logging
import secrets
import ssl
import time
from collections.abc import Mapping, Sequence
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from construction_twin.console.connection_limits import ConnectionLimits, OpenConnections
from construction_twin.console.delivery import deliver
from construction_twin.console.http_connection import HttpConnection, connection_type
from construction_twin.console.listener import Listener, listeners
from construction_twin.console.login_pace import LoginPace, PaceLimits
from construction_twin.console.logins import ConnectionLogin, Lines, Logins
from construction_twin.console.origin import refusal
from construction_twin.console.paired import DeviceCookie
from construction_twin.console.pipe import CLOSE_S, BrokerAddress, PipeLimits, pipe
from construction_twin.console.plain_http import HSTS_S
from construction_twin.console.plain_http import answer as plain_answer
from construction_twin.console.static_files import FileCache, StaticFile, names
from construction_twin.console.tickets import Tickets
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError

if TYPE_CHECKING:
    from construction_twin.console.pairings import Pairings

log = logging.getLogger("console")
#: Path of the WebSocket, and of what only who is logged in gets.
SOCKET, PRIVATE = "/mqtt", "/private/"
#: Below `PRIVATE`: who has which right.
RIGHTS = "rights.json"
#: The subprotocol that MQTT has for WebSockets (MQTT 5.0, section 6).
SUBPROTOCOL = "mqtt"
#: A browser is paired on a WebSocket of its own, and asks whether it is; see `pair_socket.py`, which needs more packages.
PAIR, PAIR_SUBPROTOCOL, PAIRED = "/pair", "twin-pair", "/paired.json"
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
        names: With TLS, names and addresses of this server: who comes to one of them without TLS is sent to https.
        hsts_s: With TLS, for so long a browser asks by https alone for anything of the host's name [s]; 0: what it was told before
            ends.
        file_stall_s: Who takes nothing of a file for so long is cut off [s].
        pairings: Devices that log in with a PIN; None: there are none.
    """

    files: Mapping[str, StaticFile]
    private: Path | None
    broker: BrokerAddress
    origins: frozenset[str] = frozenset()
    tls: ssl.SSLContext | None = None
    names: Sequence[str] = ()
    hsts_s: int = HSTS_S
    limits: PipeLimits = field(default_factory=PipeLimits)
    pace: PaceLimits = field(default_factory=PaceLimits)
    connections: ConnectionLimits = field(default_factory=ConnectionLimits)
    file_stall_s: float = 20.0
    pairings: Pairings | None = None
    rights: Path | None = None


class ConsoleServer:
    """Answers requests; knows who is connected, and who is logged in."""

    def __init__(self, settings: ServerSettings):
        self._settings = settings
        self._connections = OpenConnections(settings.connections)
        self._logins = Logins(
            self._connections,
            _tickets(0),
            LoginPace(settings.pace),
            LoginPace(settings.pace),
            time.monotonic_ns,
            settings.pairings,
        )
        self._port = 0
        self._delivering: set[HttpConnection] = set()
        self._cache = FileCache()
        self._lines = Lines(1, 20, time.monotonic_ns)

    @property
    def wrong_passwords(self) -> int:
        """How many there were."""
        return self._logins.pace.count

    async def run(self, host: str, port: int, ready: asyncio.Event | None = None) -> None:
        """Serve until cancelled.

        Args:
            ready: Set when the port is open.
        """
        self._logins.tickets, self._port = _tickets(port), port
        async with contextlib.AsyncExitStack() as serving:
            plain = None if self._settings.tls is None else partial(self._on_plain, port)
            for listener in await listeners(host, port, self._connections, self._on_full, plain):
                await serving.enter_async_context(self._serve(listener))
            if ready is not None:
                ready.set()
            try:
                await self._logins.watch()
            finally:
                # the library waits for whoever still answers a request
                for client in tuple(self._delivering):
                    client.transport.abort()

    def _serve(self, listener: Listener) -> AbstractAsyncContextManager[object]:
        settings = self._settings
        return serve(
            self._on_socket,
            sock=listener,
            subprotocols=[SUBPROTOCOL, PAIR_SUBPROTOCOL],  # type: ignore[list-item]  # a NewType of str
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

    def _on_plain(self, port: int, peer: str, head: bytes) -> bytes:
        self._lines.write(logging.INFO, f"{peer} asked by http; told to use https")
        return plain_answer(head, self._settings.names, port)

    # -- files

    async def _on_request(self, connection: ServerConnection, request: Request) -> Response | None:
        path = _path(request)
        if path == SOCKET:
            return self._refuse_socket(connection, request, SUBPROTOCOL)
        if path == PAIR and self._settings.pairings is not None:
            return self._refuse_socket(connection, request, PAIR_SUBPROTOCOL)
        assert isinstance(connection, HttpConnection)
        answer = self._strict(await self._answer_to(path, request))
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
        if path == PAIRED:
            return await asyncio.to_thread(self._paired, request)
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

    # -- paired devices

    def _cookie(self, request: Request) -> DeviceCookie | None:
        """Return which paired device a browser says that it is."""
        shown = _joined(request.headers, "Cookie", "; ")
        return DeviceCookie.shown(shown, self._port, self._settings.tls is not None)

    def _paired(self, request: Request) -> Response:
        """Return whether the browser that asks is paired, which its page cannot know: the cookie is none for scripts."""
        try:
            found = self._settings.pairings and self._settings.pairings.device_of(self._cookie(request))
        except (ConstructionTwinError, OSError) as error:
            self._lines.write(logging.ERROR, str(error))
            found = None
        state = {"account": "", "device_account": "", "number": 0, "tries": 0}
        if found:
            state = {key: getattr(found, key) for key in ("account", "device_account", "number")} | {
                "tries": found.left
            }
        answer = _answer(http.HTTPStatus.OK, json.dumps(state).encode())
        answer.headers["Vary"] = "Cookie"
        del answer.headers["Content-Type"]
        answer.headers["Content-Type"] = "application/json; charset=utf-8"
        return answer

    def _invite(self, request: Request) -> DeviceCookie | None:
        """Return the cookie of a device to be; None when there is no invitation that its browser names."""
        from construction_twin.console.pair_socket import proposed

        pairings = self._settings.pairings
        hashed = proposed(_joined(request.headers, "Sec-WebSocket-Protocol", ",") or "")
        try:
            invited = pairings is not None and pairings.is_invited(hashed)
        except (ConstructionTwinError, OSError) as error:
            self._lines.write(logging.ERROR, str(error))
            return None
        return DeviceCookie(secrets.token_hex(16), secrets.token_urlsafe(32)) if invited else None

    async def _on_pairing(self, connection: HttpConnection, peer: str) -> None:
        from construction_twin.console.pair_socket import pair

        pairings, request = self._settings.pairings, connection.request
        assert pairings is not None and request is not None
        said = await pair(connection, pairings, connection.invited, self._cookie(request), peer)
        self._lines.write(logging.INFO, f"{peer} {said}")

    # -- the pipe

    def _refuse_socket(self, connection: ServerConnection, request: Request, subprotocol: str) -> Response | None:
        settings, headers = self._settings, request.headers
        peer = _peer(connection)
        origin, host = _joined(headers, "Origin", ", "), _joined(headers, "Host", ", ")
        why = refusal(origin, host, settings.tls is not None, settings.origins)
        spoken = _joined(headers, "Sec-WebSocket-Protocol", ",") or ""
        if not why and subprotocol not in [word.strip() for word in spoken.split(",")]:
            why = f"no subprotocol {subprotocol}"
        if why:
            self._lines.write(logging.WARNING, f"{peer} refused: {why}")
            return _answer(http.HTTPStatus.FORBIDDEN, f"{why}\n".encode())
        return None

    def _strict(self, response: Response) -> Response:
        """Return an answer that keeps browsers to https; without TLS a browser would not believe it (RFC 6797, section 7.2)."""
        if self._settings.tls is not None and "Strict-Transport-Security" not in response.headers:
            # neither includeSubDomains nor preload: they would bind what is not this machine
            response.headers["Strict-Transport-Security"] = f"max-age={self._settings.hsts_s}"
        return response

    def _on_response(self, connection: ServerConnection, request: Request, response: Response) -> Response | None:
        if response.status_code == http.HTTPStatus.SWITCHING_PROTOCOLS:
            assert isinstance(connection, HttpConnection)
            if _path(request) == PAIR:
                connection.invited = self._invite(request)
                if connection.invited is not None:
                    cookie = connection.invited.header(self._port, self._settings.tls is not None)
                    response.headers["Set-Cookie"] = cookie
                return self._strict(response)
            connection.ticket = self._logins.tickets.give(_joined(request.headers, "Cookie", "; "))
            response.headers["Set-Cookie"] = self._logins.tickets.cookie(
                connection.ticket, self._settings.tls is not None
            )
        return self._strict(response)

    async def _on_socket(self, connection: ServerConnection) -> None:
        assert isinstance(connection, HttpConnection)
        number, peer, request = (
            connection.transport.get_extra_info("socket").fileno(),
            _peer(connection),
            connection.request,
        )
        assert request is not None
        if _path(request) == PAIR:
            await self._on_pairing(connection, peer)
            return
        login = ConnectionLogin(self._logins, number, peer, connection.ticket, self._cookie(request))
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

"""The console's server: the page, private files for who is logged in, and the WebSocket that is piped to the broker.

One aiohttp application in one event loop; files are read in other threads, or sent by the kernel.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import re
import secrets
import socket
import ssl
import time
from collections import Counter
from collections.abc import Callable, Container
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError

from construction_twin.core.network import is_loopback
from construction_twin.core.rate_limit import LineLimiter
from construction_twin.extensions.console.pipe import BrokerAddress, Pipe, PipeLimits, drop_silent_peer

log = logging.getLogger("console")
#: Path of the WebSocket, and of what only who is logged in gets.
SOCKET, PRIVATE = "/mqtt", "/private/"
#: Below `PRIVATE`: who has which right.
RIGHTS = "rights.json"
#: The subprotocol that MQTT has for WebSockets (MQTT 5.0, section 6).
SUBPROTOCOL = "mqtt"
#: A browser's session: all of its tabs have the same one.
COOKIE = "console_session"
#: No script, style, picture or connection but this server's own; nothing may frame the page.
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; connect-src 'self'; "
    "manifest-src 'self'; worker-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}
#: A name with a hash of its content, as esbuild writes it (8 of base 32) or in hexadecimal: it never changes, so that a browser
#: need not ask again. A word or a date is none.
_HASHED = re.compile(r"(?:^|[.-])(?:(?=\d*[A-Z])[0-9A-Z]{8}|[0-9a-f]{12,64})\.\w+$")


@dataclass(frozen=True)
class ServerSettings:
    """What the server serves, and to whom.

    Attributes:
        page: Folder of the page; None: it only pipes.
        private: Folder of files for who is logged in.
        rights: `rights.json` of `make_site`.
        origins: Further origins whose pages may connect: ``https://console.cell``.
        connections, connections_per_peer: Most that are open, TLS handshakes included.
        ask_s: Longest wait for a request, and for a TLS handshake [s].
        stall_s, file_stall_s: Longest time in which a peer takes nothing of the view, or of a file [s].
    """

    page: Path | None
    private: Path | None
    broker: BrokerAddress
    rights: Path | None = None
    origins: frozenset[str] = frozenset()
    tls: ssl.SSLContext | None = None
    limits: PipeLimits = field(default_factory=PipeLimits)
    connections: int = 256
    connections_per_peer: int = 64
    ask_s: float = 5.0
    stall_s: float = 5.0
    file_stall_s: float = 20.0


class Listener(socket.socket):
    """A listening socket that counts what it accepts, also what never ends its TLS handshake.

    Above a limit the oldest connection that is not logged in ends, of the new one's peer, or of the peer with the most of them: one
    peer takes nothing from another one with fewer.
    """

    def __init__(self, family: int, settings: ServerSettings, logged_in: Container[object]):
        super().__init__(family, socket.SOCK_STREAM)
        self._settings = settings
        self._logged_in = logged_in
        self._open: dict[tuple[str, int], socket.socket] = {}

    def accept(self) -> tuple[socket.socket, tuple[str, int]]:
        """Return the next connection and its address (called by asyncio)."""
        connection, address = super().accept()
        self._open = {at: each for at, each in self._open.items() if each.fileno() >= 0}
        self._open[address] = connection
        peer, settings = address[0], self._settings
        strangers = [at for at in self._open if at not in self._logged_in]
        if sum(at[0] == peer for at in self._open) <= settings.connections_per_peer:
            if len(self._open) <= settings.connections:
                return connection, address
            peer = Counter(at[0] for at in strangers).most_common(1)[0][0]
        oldest = self._open.pop(next(at for at in strangers if at[0] == peer))
        # one that has just gone has no end
        with contextlib.suppress(OSError):
            # its transport, or its TLS handshake, sees it and closes
            oldest.shutdown(socket.SHUT_RDWR)
        return connection, address


def origin_refusal(origin: str | None, host: str | None, secure: bool, allowed: frozenset[str]) -> str:
    """Return why a page may not open a WebSocket; "" when it may (RFC 6455, section 10.2).

    The name that the browser connected to counts as well: after DNS rebinding a foreign page has the same origin as this server.
    """
    if origin is None:
        return "no Origin: expected a browser's request"
    if origin in allowed:
        return ""
    own = f"{'https' if secure else 'http'}://{host}"
    place = _place(own)
    if place is not None and not secure and not is_loopback(place[1]):
        return f"host {place[1][:100]!r}; expected localhost or a loopback address, because there is no TLS"
    # parsed, not compared as text: a browser leaves the default port out of both or of one
    if place is not None and _place(origin) == place:
        return ""
    return f"origin {origin[:100]!r}; expected the page of this server, {own[:100]!r}"


def _place(url: str) -> tuple[str, str, int] | None:
    """Return scheme, name and port of an address without a path; None when it is none."""
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError:
        return None
    if parts.scheme not in ("http", "https") or not parts.hostname or parts.path or parts.query or parts.username:
        return None
    return parts.scheme, parts.hostname, port or {"http": 80, "https": 443}[parts.scheme]


class ConsoleServer:
    """Answers requests, and knows whose session is logged in."""

    def __init__(self, settings: ServerSettings):
        self._settings = settings
        #: Sessions, by the address of each connection on which the broker has accepted a login.
        self._logged_in: dict[object, str] = {}
        self._lines = LineLimiter()

    async def run(self, host: str, port: int, on_ready: Callable[[], None]) -> None:
        """Serve until cancelled; `on_ready` is called when the port is open. OSError: no such address, or another one has it."""
        settings, loop = self._settings, asyncio.get_running_loop()
        app = web.Application()
        app.router.add_get(SOCKET, self._on_socket)
        app.router.add_get(PRIVATE + "{name:.*}", self._on_private)
        app.router.add_get("/{name:.*}", self._on_page)
        app.on_response_prepare.append(_add_headers)
        # what strangers send is not in the log
        logging.getLogger("aiohttp.server").addFilter(_is_own_error)
        logging.getLogger("aiohttp.websocket").setLevel(logging.ERROR)
        runner = web.AppRunner(
            app, access_log=None, keepalive_timeout=settings.ask_s, lingering_time=0.0, shutdown_timeout=0.1
        )
        await runner.setup()
        assert runner.server is not None
        handshake_s = settings.ask_s if settings.tls else None
        servers = []
        try:
            found = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
            for family, _, _, _, address in found:
                # localhost has an address of IPv6 where the kernel has none
                if family == socket.AF_INET6 and not socket.has_dualstack_ipv6():
                    continue
                listener = Listener(family, settings, self._logged_in)
                listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                if family == socket.AF_INET6:
                    listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                # what it accepts inherits this
                drop_silent_peer(listener, settings.file_stall_s)
                listener.bind(address)
                servers.append(
                    await loop.create_server(
                        runner.server, sock=listener, ssl=settings.tls, ssl_handshake_timeout=handshake_s
                    )
                )
            on_ready()
            await asyncio.Event().wait()
        finally:
            for server in servers:
                server.close()
            await runner.cleanup()

    def _log_limited(self, kind: str, level: int, sentence: str) -> None:
        """Write a line that others can cause: one of its kind per second."""
        if (more := self._lines.admit(kind, time.monotonic_ns())) is not None:
            log.log(level, "%s%s", sentence, more)

    # -- files

    async def _on_page(self, request: web.Request) -> web.StreamResponse:
        name = request.match_info["name"] or "index.html"
        answer = _file(self._settings.page, name)
        # with the page, so that tabs which connect at once have one session
        if name == "index.html":
            self._session(request, answer)
        return answer

    async def _on_private(self, request: web.Request) -> web.StreamResponse:
        if request.cookies.get(COOKIE) not in self._logged_in.values():
            raise web.HTTPForbidden(text="log in first\n")
        name, folder = request.match_info["name"], self._settings.private
        if name == RIGHTS and self._settings.rights is not None:
            folder, name = self._settings.rights.parent, self._settings.rights.name
        return _file(folder, name, "private, ")

    def _session(self, request: web.Request, answer: web.StreamResponse) -> str:
        """Return a browser's session, a new one where it has none.

        Without a path a browser keeps it for the folder of the page's address, also behind a proxy that serves several consoles.
        """
        if session := request.cookies.get(COOKIE):
            return session
        session = secrets.token_urlsafe(24)
        secure = self._settings.tls is not None
        answer.set_cookie(COOKIE, session, path="", httponly=True, samesite="Strict", secure=secure)
        return session

    # -- the pipe

    async def _on_socket(self, request: web.Request) -> web.StreamResponse:
        settings, headers, peer = self._settings, request.headers, request.remote
        browser = web.WebSocketResponse(
            protocols=(SUBPROTOCOL,),
            compress=False,  # what is sent is small, and latency counts
            heartbeat=settings.limits.ping_s,
            max_msg_size=settings.limits.largest,
            timeout=1.0,
            decode_text=False,
        )
        why = origin_refusal(headers.get("Origin"), headers.get("Host"), settings.tls is not None, settings.origins)
        if not why and browser.can_prepare(request).protocol != SUBPROTOCOL:
            why = f"expected a WebSocket with the subprotocol {SUBPROTOCOL}"
        if why:
            self._log_limited("refused", logging.WARNING, f"{peer} refused: {why}")
            raise web.HTTPForbidden(text=f"{why}\n")
        session = self._session(request, browser)
        await browser.prepare(request)
        browser.get_extra_info("socket").setsockopt(
            socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, round(settings.stall_s * 1000)
        )
        address = browser.get_extra_info("peername")

        def on_accepted() -> None:
            self._logged_in[address] = session
            self._log_limited("login", logging.INFO, f"{peer} logged in")

        def on_wrong() -> None:
            self._log_limited("wrong", logging.WARNING, f"{peer}: wrong account or password")

        try:
            how = await Pipe(browser, settings.limits, on_accepted, on_wrong).run(settings.broker)
            self._log_limited("end", logging.INFO, f"{peer}: {how}")
        finally:
            self._logged_in.pop(address, None)
            # who takes nothing would keep its place
            if request.transport is not None:
                request.transport.abort()
        return browser


async def _add_headers(_: web.Request, answer: web.StreamResponse) -> None:
    answer.headers.update(_HEADERS)
    answer.headers.setdefault("Cache-Control", "no-store")


def _file(folder: Path | None, name: str, who: str = "") -> web.FileResponse:
    """Return the answer with a file of a folder, compressed as ``.gz`` beside it; HTTPNotFound for a hidden one, or a link out."""
    if folder is None or "/." in f"/{name}":
        raise web.HTTPNotFound(text="no such file\n")
    try:
        path = (folder / name).resolve()
        found = path.is_relative_to(folder.resolve()) and path.is_file()
    except (OSError, ValueError):
        # too long a name, or one with a zero byte
        found = False
    if not found:
        raise web.HTTPNotFound(text="no such file\n")
    caching = "max-age=31536000, immutable" if _HASHED.search(path.name) else "no-cache"
    return web.FileResponse(path, headers={"Cache-Control": who + caching})


def _is_own_error(record: logging.LogRecord) -> bool:
    """Return whether a record of aiohttp is an error of this program: no malformed request or broken connection."""
    error = record.exc_info[1] if record.exc_info else None
    # asyncio's sendfile with TLS stumbles over a connection that has broken
    return not any(
        isinstance(each, (HttpProcessingError, OSError)) for each in (error, getattr(error, "__context__", None))
    )

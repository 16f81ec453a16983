"""From which pages a WebSocket may be opened. Pure.

A browser names the page's origin with every WebSocket (RFC 6455, section 10.2), and a page cannot change it. So a page of another
site cannot use the connection of a tablet on the site's network. A program can name any origin: it needs an account all the same.

The name that the browser connected to counts as well. A page of evil.example whose name leads to 127.0.0.1 the second time (DNS
rebinding) has the same origin as what it reaches there. With TLS the certificate refuses that; without TLS only names that nobody
else can own are this server's.
"""

from __future__ import annotations

from urllib.parse import urlsplit

from construction_twin.core.network import is_loopback


def refusal(origin: str | None, host: str | None, secure: bool, allowed: frozenset[str]) -> str:
    """Return in one sentence why a WebSocket may not be opened; "" when it may.

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

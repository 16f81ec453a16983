"""What somebody gets who typed http:// for an address that speaks TLS: the way to https://, and never a page. Pure.

A browser is sent to the same name and path with https, if the name is one of this server's: nobody is sent elsewhere by a name that
he did not mean. The answer is not kept by the browser, because the same address may have no TLS tomorrow. Whatever else speaks
without TLS is told in a sentence.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from html import escape

from construction_twin.console.origin import place_of
from construction_twin.core.sentences import fill, in_every_language

#: For so long browsers remember that this host has https [s]: a week is enough for a tablet that is used at times, and not too much
#: for a host whose other ports have none.
HSTS_S = 7 * 24 * 3600
#: A year: the longest that can be set [s].
LONGEST_HSTS_S = 365 * 24 * 3600
#: Longest request that is read [bytes]; one that is longer gets the sentence.
LONGEST = 8192
_END = b"\r\n\r\n"
_LINE = re.compile(rb"(GET|HEAD) (/[!-~]{0,2000}) HTTP/1\.[01]\r\n")
_HOST = re.compile(rb"\r\nhost:[ \t]*([!-~]+)[ \t]*(?=\r\n)", re.IGNORECASE)
_SAID = in_every_language("view.console.https")


def is_plain(first: int) -> bool:
    """Return whether a client's first byte begins a request of HTTP: a capital letter, where TLS has 22."""
    return ord("A") <= first <= ord("Z")


def is_whole(head: bytes) -> bool:
    """Return whether no more of a request is read."""
    return _END in head or len(head) >= LONGEST


def answer(head: bytes, names: Collection[str], port: int) -> bytes:
    """Return the answer to a request that came without TLS.

    Args:
        head: As much as `is_whole` asks for.
        names: Names and addresses of this server, the one to show first.
        port: Its own; a browser's may be another one, which leads here.
    """
    asked, path = _asked(head)
    own = asked is not None and asked[0] in names
    host, seen = asked if own and asked is not None else (next(iter(names), ""), 0)
    address = f"https://{f'[{host}]' if ':' in host else host}:{seen or port}" if host else "https://"
    lines = "\n".join(
        f'<p lang="{language}">{escape(fill(words, {"address": address + "/" if host else address}))}</p>'
        for language, words in _SAID.items()
    )
    body = f"<!doctype html><title>https</title>\n{lines}\n".encode()
    moved = own and path
    return (
        "\r\n".join(
            (
                f"HTTP/1.1 {'307 Temporary Redirect' if moved else '400 Bad Request'}",
                *((f"Location: {address}{path}",) if moved else ()),
                "Content-Type: text/html; charset=utf-8",
                f"Content-Length: {len(body)}",
                "Cache-Control: no-store",
                "Content-Security-Policy: default-src 'none'; frame-ancestors 'none'",
                "X-Content-Type-Options: nosniff",
                "Connection: close",
            )
        ).encode()
        + _END
        + (b"" if head.startswith(b"HEAD ") else body)
    )


def _asked(head: bytes) -> tuple[tuple[str, int] | None, str]:
    """Return name and port (0: not given) that a request names, and the path that can be asked for with https; "" for none."""
    head = head.partition(_END)[0] + b"\r\n"
    line, hosts = _LINE.match(head), _HOST.findall(head)
    if len(hosts) != 1 or (found := place_of(f"http://{hosts[0].decode('ascii')}")) is None:
        return None, ""
    _, name, port = found
    return (name, port if port != 80 else 0), line[2].decode("ascii") if line is not None else ""

"""What is answered to who speaks HTTP where TLS is spoken."""

from __future__ import annotations

import re

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from construction_twin.console.plain_http import LONGEST, answer, is_plain, is_whole

NAMES = ("twin.cell", "192.168.1.5", "2001:db8::1")


def ask(line: str = "GET /", host: str | None = "twin.cell:8480") -> bytes:
    return (
        f"{line} HTTP/1.1\r\nAccept: */*\r\n{'' if host is None else f'Host: {host}' + chr(13) + chr(10)}\r\n".encode()
    )


def told(request: bytes, names=NAMES) -> tuple[int, str | None, str]:
    """Return status, header `Location` and body."""
    head, _, body = answer(request, names, 8480).decode().partition("\r\n\r\n")
    status, *headers = head.split("\r\n")
    values = dict(header.split(": ", 1) for header in headers)
    assert int(values["Content-Length"]) == len(body.encode()) or request.startswith(b"HEAD ")
    assert values["Cache-Control"] == "no-store"
    # a browser would not believe it, and must not
    assert "Strict-Transport-Security" not in values
    return int(status.split(" ")[1]), values.get("Location"), body


@pytest.mark.parametrize(
    ("request_", "location"),
    (
        (ask(), "https://twin.cell:8480/"),
        (ask("HEAD /"), "https://twin.cell:8480/"),
        (ask("GET /?language=de"), "https://twin.cell:8480/?language=de"),
        # another port leads here
        (ask(host="TWIN.cell:443"), "https://twin.cell:443/"),
        (ask(host="192.168.1.5"), "https://192.168.1.5:8480/"),
        (ask(host="[2001:db8::1]:8480"), "https://[2001:db8::1]:8480/"),
        (ask("GET //evil.example/"), "https://twin.cell:8480//evil.example/"),
    ),
)
def test_who_asks_for_a_page_by_http_is_sent_to_the_same_one_by_https(request_, location):
    assert told(request_)[:2] == (307, location)


@pytest.mark.parametrize(
    "request_",
    (
        ask(host="evil.example:8480"),
        ask(host="twin.cell.evil.example"),
        ask(host="twin.cell@evil.example"),
        ask(host="twin.cell:8480/evil"),
        ask(host="twin.cell:99999"),
        ask(host="<script>"),
        ask(host=None),
        ask(host="twin.cell\r\nHost: evil.example"),
        ask("POST /"),
        ask("GET http://evil.example/"),
        ask("GET /" + "x" * 3000),
        b"X" * LONGEST,
        b"GET",
    ),
)
def test_who_cannot_be_sent_there_is_told_the_address_in_both_languages(request_):
    status, location, body = told(request_)
    assert (status, location) == (400, None)
    assert body.count("https://twin.cell:8480/") == 2 and 'lang="en"' in body and 'lang="de"' in body
    assert "evil" not in body and "script" not in body


def test_a_server_without_names_says_https_alone():
    status, location, body = told(ask(), ())
    assert (status, location) == (400, None) and "https://" in body and "twin.cell" not in body


@given(st.binary(max_size=400))
@example(b"GET / HTTP/1.1\r\nHost: twin.cell\r\nX: \r\n\r\n")
@example(b"GET /%0d%0aX:1 HTTP/1.1\r\nHost: twin.cell\r\n\r\n")
def test_whatever_comes_nobody_is_sent_elsewhere(data):
    for request in (
        data,
        b"GET / HTTP/1.1\r\nHost: " + data + b"\r\n\r\n",
        b"GET " + data + b" HTTP/1.1\r\nHost: twin.cell\r\n\r\n",
    ):
        status, location, _ = told(request)
        assert (status == 307) == (location is not None)
        assert location is None or re.match(
            r"https://(twin\.cell|192\.168\.1\.5|\[2001:db8::1\]):\d{1,5}/[!-~]*$", location
        )


def test_a_client_of_tls_is_told_from_one_of_http():
    assert all(is_plain(ord(word[0])) for word in ("GET", "HEAD", "POST", "OPTIONS", "PRI"))
    assert not any(is_plain(first) for first in (0x16, 0x80, 0, 0x10, ord("g"), 255))


def test_a_request_is_read_to_its_end_or_as_far_as_is_read_at_most():
    assert is_whole(ask()) and is_whole(b"x" * LONGEST)
    assert not is_whole(ask()[:-1]) and not is_whole(b"x" * (LONGEST - 1))

"""MQTT packets as the pipe reads them."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mqtt_packets import connect, packet, text

from construction_twin.console.packets import (
    ClientStream,
)
from construction_twin.console.server import origin_refusal
from construction_twin.console.static_files import StaticFile
from construction_twin.core.errors import PayloadError


@pytest.mark.parametrize("version", (4, 5))
@pytest.mark.parametrize("will", (False, True))
def test_the_account_of_a_login_is_read(version, will):
    stream = ClientStream(1000)
    stream.feed(connect("kr120-reviewer-ada", version, will))
    assert stream.account == "kr120-reviewer-ada"


@given(st.lists(st.binary(max_size=300), max_size=5), st.integers(1, 40))
def test_packets_come_out_as_they_went_in_wherever_the_stream_is_cut(bodies, step):
    packets = [connect("ada"), *(packet(3, body) for body in bodies)]
    data = b"".join(packets)
    stream, found = ClientStream(1000), []
    for at in range(0, len(data), step):
        found += stream.feed(data[at : at + step])
    assert [item.data for item in found] == packets


@pytest.mark.parametrize(
    ("data", "reason"),
    (
        (packet(3, b"publish before connect"), "mqtt"),
        (connect() + connect(), "mqtt"),
        (connect() + packet(2, b"\0\0"), "mqtt"),
        (connect() + packet(8, b"no flag"), "mqtt"),
        (connect() + packet(9, b"suback"), "mqtt"),
        (b"\x10\xff\xff\xff\xff\x01", "mqtt"),
        (b"\x10\xff\xff\xff\x7f", "size"),
        (b"GET / HTTP/1.1\r\n\r\n", "mqtt"),
        (connect() + b"\xc0\0" * 3000, "size"),
        (packet(1, text("MQIsdp") + b"\x03\0\0\0"), "mqtt"),
        (packet(1, text("MQTT") + b"\x05\x80\0\0\0" + text("client") + b"\0\x09short"), "mqtt"),
    ),
)
def test_what_no_client_sends_is_refused(data, reason):
    with pytest.raises(PayloadError) as caught:
        ClientStream(1000).feed(data)
    assert caught.value.reason == reason


@pytest.mark.parametrize("version", (4, 5))
@pytest.mark.parametrize(("flags", "anonymous"), ((0x02, True), (0x82, False), (0x42, False), (0xC2, False)))
def test_a_login_without_user_name_and_password_is_anonymous(version, flags, anonymous):
    fields = (text("") if flags & 0x80 else b"") + (text("secret") if flags & 0x40 else b"")
    start = text("MQTT") + bytes([version, flags]) + b"\0\x0a" + (b"\0" if version == 5 else b"")
    stream = ClientStream(1000)
    assert stream.anonymous
    stream.feed(packet(1, start + text("client") + fields))
    assert (stream.account, stream.anonymous) == ("", anonymous)


@pytest.mark.parametrize(
    ("origin", "host", "secure", "fits"),
    (
        ("http://127.0.0.1:8480", "127.0.0.1:8480", False, True),
        ("https://console.cell", "console.cell", True, True),
        ("https://console.cell:443", "console.cell", True, True),
        ("https://console.cell", "console.cell:443", True, True),
        ("http://console.cell", "console.cell", True, False),
        ("https://evil.example", "console.cell", True, False),
        ("https://console.cell.evil.example", "console.cell", True, False),
        ("https://console.cell@evil.example", "console.cell", True, False),
        ("null", "console.cell", True, False),
        ("https://[", "console.cell", True, False),
        (None, "console.cell", True, False),
        ("https://console.cell", None, True, False),
        ("https://other.cell", "console.cell", True, True),
        ("http://localhost:8480", "localhost:8480", False, True),
        ("http://[::1]:8480", "[::1]:8480", False, True),
        # the name of somebody else, who lets it lead to 127.0.0.1 once his page is loaded
        ("http://evil.example:8480", "evil.example:8480", False, False),
        ("http://localhost.evil.example", "localhost.evil.example", False, False),
        ("http://127.0.0.1:8480, http://127.0.0.1:8480", "127.0.0.1:8480", False, False),
    ),
)
def test_only_the_server_s_own_page_and_named_origins_may_connect(origin, host, secure, fits):
    assert bool(origin_refusal(origin, host, secure, frozenset({"https://other.cell"}))) is not fits


@pytest.mark.parametrize(
    ("name", "lasting"),
    (
        ("app-5UIZRSMC.js", True),
        ("app-0123456789ab.js", True),
        (f"{'0af9' * 16}.stl", True),
        ("index.html", False),
        ("robot-description.json", False),
        ("kr120.building.glb", False),
        ("run-20261123.json", False),
    ),
)
def test_only_a_name_with_a_hash_is_kept_without_asking(name, lasting):
    assert StaticFile.of(name, b"").lasting is lasting

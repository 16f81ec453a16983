"""The addresses that the console prints: those that a browser on another machine can open."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from construction_twin.broker.certificates import Authority
from construction_twin.console import program
from construction_twin.console.addresses import addresses
from construction_twin.console.command_line import main

HOSTS = ("twin.example", "192.168.7.20", "fd00::7")


@pytest.fixture(scope="module")
def pair(tmp_path_factory) -> tuple[Path, Path]:
    """Return certificate and key."""
    folder = tmp_path_factory.mktemp("site")
    key, certificate = folder / "console.key", folder / "console.crt"
    Authority(folder / "ca", "site", HOSTS).issue("console", key, certificate, 10, HOSTS)
    return certificate, key


@pytest.mark.parametrize("listen", ("0.0.0.0", "::"))
def test_on_all_addresses_the_names_of_the_certificate_are_told(pair, listen):
    assert addresses(listen, 8480, *pair, "https", "/") == [
        "https://twin.example:8480/", "https://192.168.7.20:8480/", "https://[fd00::7]:8480/"
    ]  # fmt: skip


def test_without_names_it_is_this_machine_s(pair, tmp_path):
    key, certificate = tmp_path / "key", tmp_path / "crt"
    Authority(tmp_path / "ca", "site", HOSTS).issue("console", key, certificate, 10)
    expected = [f"https://{socket.gethostname()}:8480/"]
    assert addresses("0.0.0.0", 8480, certificate, key, "https", "/") == expected
    assert addresses("0.0.0.0", 8480, None, None, "https", "/") == expected


def test_one_address_is_told_as_it_is(pair):
    assert addresses("192.168.7.21", 1, *pair, "wss", "/mqtt") == ["wss://192.168.7.21:1/mqtt"]
    assert addresses("::1", 1, None, None, "ws", "/mqtt") == ["ws://[::1]:1/mqtt"]


def test_the_program_prints_them_once_it_listens(pair, monkeypatch, capsys):
    class Server:
        """Listens nowhere: a test is reachable from this machine only."""

        def __init__(self, settings):
            pass

        async def run(self, host, port, ready):
            assert "wss://" not in capsys.readouterr().out
            ready.set()

    monkeypatch.setattr(program, "ConsoleServer", Server)
    certificate, key = map(str, pair)
    assert main(["--listen", "0.0.0.0", "--port", "7", "--certificate", certificate, "--key", key]) == 0
    assert capsys.readouterr().out.splitlines() == [
        f"console: wss://{host}:7/mqtt" for host in ("twin.example", "192.168.7.20", "[fd00::7]")
    ]

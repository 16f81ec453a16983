"""A broker on trial: it ends whatever the broker does, and sees that it listens though its files are hidden."""

from __future__ import annotations

import os
import socket
import sys
from pathlib import Path

import pytest

from construction_twin.broker import start
from construction_twin.core import network

#: Listens as its configuration says, and does not end when it is asked to.
DEAF = """#!{python}
import re, signal, socket, sys
signal.signal(signal.SIGTERM, signal.SIG_IGN)
text = open(sys.argv[2]).read()
server = socket.create_server(("127.0.0.1", int(re.search(r"listener ([0-9]+)", text).group(1))))
signal.pause()
"""


def free_port() -> int:
    """Return a TCP port that nobody uses."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        return server.getsockname()[1]


@pytest.fixture
def configuration(tmp_path):
    """An empty configuration."""
    file = tmp_path / "mosquitto.conf"
    file.write_text("allow_anonymous true\n")
    return str(file)


def hide(monkeypatch):
    """Let this user not see the files of other processes, as of a program with capabilities of its own."""
    scan = os.scandir

    def scandir(path):
        if Path(path).name == "fd" and Path(path).exists() and str(path) != f"/proc/{os.getpid()}/fd":
            raise PermissionError(13, "Permission denied", path)
        return scan(path)

    monkeypatch.setattr(network.os, "scandir", scandir)


def test_a_broker_that_does_not_end_when_asked_is_killed(tmp_path, configuration, monkeypatch):
    deaf = tmp_path / "mosquitto"
    deaf.write_text(DEAF.format(python=sys.executable))
    deaf.chmod(0o755)
    monkeypatch.setattr(start.shutil, "which", lambda *_, **__: str(deaf))
    monkeypatch.setattr(start, "END_TIME", 0.2)
    port = free_port()
    assert start.check(configuration, port)[0] == str(deaf)
    assert network.port_is_free(socket.SOCK_STREAM, port)


def test_a_broker_whose_files_are_hidden_is_seen_to_listen(configuration, monkeypatch):
    hide(monkeypatch)
    monkeypatch.setattr(start, "TRIAL_TIME", 10.0)
    assert start.check(configuration, free_port())[1].startswith("allow_anonymous")

"""A broker on trial is seen to listen though its files are hidden."""

from __future__ import annotations

import os
import socket
from pathlib import Path

import pytest

from construction_twin.broker import start
from construction_twin.core import network


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


def test_a_broker_whose_files_are_hidden_is_seen_to_listen(configuration, monkeypatch):
    hide(monkeypatch)
    monkeypatch.setattr(start, "TRIAL_TIME", 10.0)
    assert start.check(configuration, free_port())[1].startswith("allow_anonymous")

"""The command line's way to its master: whoever does not answer is one sentence, in bounded time."""

from __future__ import annotations

import os
import socket
from types import SimpleNamespace

import pytest

from construction_twin.core.errors import ConfigurationError, SilenceError
from construction_twin.ros.commands import twin as twin_cli

OPTIONS = SimpleNamespace(timeout=0.3, robot="kr120")


def connect(monkeypatch, uri: str) -> None:
    monkeypatch.setenv("ROS_MASTER_URI", uri)
    monkeypatch.setattr(twin_cli.rospy, "init_node", lambda *_, **__: pytest.fail("became a node without a master"))
    twin_cli.connect(OPTIONS)


@pytest.mark.parametrize("uri", ["localhost:11311", "https://localhost:11311", "http://"])
def test_an_address_that_is_none_is_named(monkeypatch, uri):
    with pytest.raises(ConfigurationError, match="ROS_MASTER_URI"):
        connect(monkeypatch, uri)


def test_a_port_without_anybody_is_no_master(monkeypatch):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with pytest.raises(SilenceError, match="no ROS master answers"):
        connect(monkeypatch, f"http://127.0.0.1:{port}")


def test_somebody_who_takes_the_call_and_says_nothing_is_no_master(monkeypatch):
    with socket.socket() as mute:
        mute.bind(("127.0.0.1", 0))
        mute.listen()
        with pytest.raises(SilenceError, match="no ROS master answers"):
            connect(monkeypatch, f"http://127.0.0.1:{mute.getsockname()[1]}")
    assert socket.getdefaulttimeout() is None


@pytest.mark.parametrize("error", [KeyError, OSError])
def test_an_account_without_a_name_has_a_number(monkeypatch, error):
    def nameless() -> str:
        raise error("uid not found")

    monkeypatch.setattr(twin_cli.getpass, "getuser", nameless)
    assert twin_cli.account_name() == f"uid {os.getuid()}"

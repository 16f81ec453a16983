"""The scripts behind `make`: counting of test results, and the sentence about a port that is taken."""

from __future__ import annotations

import importlib.util
import socket
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "scripts"


def load(name: str):
    spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


run_tests = load("run_tests")
check_ports = load("check_ports")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('<testsuite tests="3" failures="0" errors="0"/>', (3, 0)),
        ('<testsuites><testsuite tests="5" failures="1" errors="1" skipped="1"/></testsuites>', (2, 2)),
        ('<testsuite tests="0" failures="0" errors="0"/>', (0, 1)),
        ("not xml", (0, 1)),
    ],
)
def test_counts_a_result_file_and_takes_an_empty_or_broken_one_for_a_failure(tmp_path, text, expected):
    file = tmp_path / "result.xml"
    file.write_text(text)
    assert run_tests.count(file) == expected


def test_takes_a_missing_result_file_for_a_failure(tmp_path):
    assert run_tests.count(tmp_path / "none.xml") == (0, 1)


@pytest.mark.parametrize(
    ("kind", "argument", "word"),
    [(socket.SOCK_STREAM, "broker_port", "MQTT broker"), (socket.SOCK_DGRAM, "rsi_port", "RSI gateway")],
)
def test_names_the_port_that_is_taken(kind, argument, word, capsys, monkeypatch):
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as free:
        free.bind(("127.0.0.1", 0))
        monkeypatch.setenv("ROS_MASTER_PORT", str(free.getsockname()[1]))
    with socket.socket(socket.AF_INET, kind) as holder:
        holder.bind(("127.0.0.1", 0))
        if kind is socket.SOCK_STREAM:
            holder.listen()
        port = holder.getsockname()[1]
        other = "gateway:=false" if argument == "broker_port" else "broker:=false"
        assert check_ports.main([f"{argument}:={port}", other]) == 1
    sentence = capsys.readouterr().err
    assert word in sentence and str(port) in sentence


def test_ports_that_are_not_needed_are_not_looked_at(capsys, monkeypatch):
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as free:
        free.bind(("127.0.0.1", 0))
        monkeypatch.setenv("ROS_MASTER_PORT", str(free.getsockname()[1]))
    assert check_ports.main(["broker:=false", "gateway:=false"]) == 0
    assert capsys.readouterr().err == ""

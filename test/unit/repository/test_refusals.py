"""A start that cannot work, live: its sentences stand once on the terminal, and roslaunch ends with 1, without a traceback."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
XML = f"{ROOT}/krl/ethernet/ctwin_e1_ethernet.xml"
PREFLIGHT = [sys.executable, f"{ROOT}/nodes/preflight"]


def free_port() -> int:
    with socket.socket() as tcp:
        tcp.bind(("127.0.0.1", 0))
        return tcp.getsockname()[1]


@pytest.mark.parametrize(
    "words, sentences",
    [
        (
            [f"ethernet_xml:={XML}", "executor:=1", "console:=/no/console.yaml"],
            ["Ethernet XML", "executor: found '1', expected an argument", "/no/console.yaml"],
        ),
        (
            ["arm:=real", "auto_approve:=true"],
            ["auto_approve: found True", "accounts: found ''", "mosquitto.conf: found"],
        ),
    ],
)  # fmt: skip
def test_a_start_that_cannot_work_ends_with_its_sentences_by_hand_and_in_the_launch(tmp_path, words, sentences):
    uri = f"http://127.0.0.1:{(port := free_port())}"
    environment = os.environ | {"ROS_HOME": str(tmp_path), "ROS_LOG_DIR": f"{tmp_path}/log", "ROS_IP": "127.0.0.1"}
    environment["ROS_MASTER_URI"] = uri
    words = [*words, f"broker_port:={free_port()}", f"rsi_port:={free_port()}"]
    options = {"capture_output": True, "text": True, "timeout": 120.0, "env": environment}
    launch = subprocess.run(["roslaunch", "-p", str(port), f"{ROOT}/launch/bringup.launch", *words], **options)
    by_hand = subprocess.run([*PREFLIGHT, *(word for word in words if "executor" not in word)], **options)
    assert launch.returncode == by_hand.returncode == 1, launch.stderr + by_hand.stderr
    said = [line for line in launch.stderr.splitlines() if line.startswith("cannot start: ")]
    for sentence in sentences:
        assert sum(sentence in line for line in said) == 1, launch.stderr
    assert "Traceback" not in launch.stdout + launch.stderr + by_hand.stderr
    alone = {line for line in said if "/startup)" not in line}
    assert set(by_hand.stderr.splitlines()) == alone

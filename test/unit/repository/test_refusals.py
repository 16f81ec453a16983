"""A start that cannot work, live: its sentences stand once on the terminal, and roslaunch ends with 1, without a traceback."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
from processes import ROOT, free_port

XML = f"{ROOT}/krl/ethernet/ctwin_e1_ethernet.xml"
STARTS = {
    "mock": (
        [f"ethernet_xml:={XML}", "console:=/no/console.yaml", "executor:=1"],
        ["Ethernet XML", "executor: found '1', expected an argument", "/no/console.yaml"],
    ),
    # law 4 and accounts: each program that would let a real arm move refuses by itself
    "real": (
        ["arm:=real", "auto_approve:=true", "accounts:=/no/accounts"],
        ["auto_approve: found True", "/no/accounts"],
    ),
}


@pytest.mark.parametrize("words, sentences", STARTS.values(), ids=STARTS)
def test_a_start_that_cannot_work_ends_with_its_sentences_by_hand_and_in_the_launch(tmp_path, words, sentences):
    uri = f"http://127.0.0.1:{(port := free_port())}"
    environment = os.environ | {"ROS_HOME": str(tmp_path), "ROS_LOG_DIR": f"{tmp_path}/log", "ROS_IP": "127.0.0.1"}
    environment["ROS_MASTER_URI"] = uri
    words = [*words, f"broker_port:={free_port()}", f"rsi_port:={free_port()}"]
    options = {"capture_output": True, "text": True, "timeout": 120.0, "env": environment}
    launch = subprocess.run(["roslaunch", "-p", str(port), f"{ROOT}/launch/bringup.launch", *words], **options)
    by_hand = [word for word in words if "executor" not in word]
    by_hand = subprocess.run([sys.executable, f"{ROOT}/nodes/preflight", *by_hand], **options)
    assert launch.returncode == by_hand.returncode == 1, launch.stderr + by_hand.stderr
    said = [line for line in launch.stderr.splitlines() if line.startswith("cannot start: ")]
    for sentence in sentences:
        assert any(sentence in line for line in said), launch.stderr
    assert len(said) == len(set(said)), launch.stderr
    assert "Traceback" not in launch.stdout + launch.stderr + by_hand.stderr
    alone = {line for line in said if "/startup)" not in line}
    assert set(by_hand.stderr.splitlines()) == alone

"""A start that cannot work, live: its sentences stand once on the terminal, and roslaunch ends with 1, without a traceback."""

from __future__ import annotations

import os
import subprocess
import sys

from processes import ROOT, free_port

XML = f"{ROOT}/krl/ethernet/ctwin_e1_ethernet.xml"
#: With accounts and a real arm each program that would let it move refuses by itself, law 4.
WORDS = [
    "arm:=real",
    "auto_approve:=true",
    "accounts:=/no/accounts",
    f"ethernet_xml:={XML}",
    "console:=/no/console.yaml",
]
SENTENCES = [
    "auto_approve: found True",
    "/no/accounts",
    "Ethernet XML",
    "executor: found '1', expected an argument",
    "/no/console.yaml",
]


def test_a_start_that_cannot_work_ends_with_its_sentences_by_hand_and_in_the_launch(tmp_path):
    uri = f"http://127.0.0.1:{(port := free_port())}"
    environment = os.environ | {"ROS_HOME": str(tmp_path), "ROS_LOG_DIR": f"{tmp_path}/log", "ROS_IP": "127.0.0.1"}
    environment["ROS_MASTER_URI"] = uri
    words = [*WORDS, f"broker_port:={free_port()}", f"rsi_port:={free_port()}"]
    options = {"capture_output": True, "text": True, "timeout": 120.0, "env": environment}
    launch = subprocess.run(
        ["roslaunch", "-p", str(port), f"{ROOT}/launch/bringup.launch", *words, "executor:=1"], **options
    )
    by_hand = subprocess.run([sys.executable, f"{ROOT}/nodes/preflight", *words], **options)
    assert launch.returncode == by_hand.returncode == 1, launch.stderr + by_hand.stderr
    said = [line for line in launch.stderr.splitlines() if line.startswith("cannot start: ")]
    for sentence in SENTENCES:
        assert any(sentence in line for line in said), launch.stderr
    assert len(said) == len(set(said)), launch.stderr
    assert "Traceback" not in launch.stdout + launch.stderr + by_hand.stderr
    alone = {line for line in said if "/startup)" not in line}
    assert set(by_hand.stderr.splitlines()) == alone

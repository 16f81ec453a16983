"""ros.shared.start_claim: of two starts of a robot one goes on, with a master and without, until its process has ended."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import rosgraph
from ros_master import ros_master

from construction_twin.ros.commands import preflight
from construction_twin.ros.shared.start_claim import PARAMETERS, claim

NO_MASTER = "http://127.0.0.1:1/"


@pytest.fixture
def master(monkeypatch):
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    with ros_master() as uri:
        yield uri


@pytest.fixture
def starts():
    """Two processes that could be roslaunches."""
    sleepers = [subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) for _ in range(2)]
    yield sleepers
    for sleeper in sleepers:
        sleeper.kill()
        sleeper.wait(10.0)
        sleeper.stdin.close()


def test_without_a_master_the_second_start_on_a_machine_is_refused_until_the_first_has_ended(tmp_path, starts):
    first, second = starts
    assert claim("kr120", NO_MASTER, first.pid, tmp_path) == ""
    said = claim("kr120", NO_MASTER, second.pid, tmp_path)
    assert said == f"process {first.pid} on {os.uname().nodename} has begun to start it on {NO_MASTER}"
    # the first one may ask again, e.g. for a file that names the robot twice; others are not in its way
    assert claim("kr120", NO_MASTER, first.pid, tmp_path) == ""
    assert claim("kr120_2", NO_MASTER, second.pid, tmp_path) == ""
    assert claim("kr120", "http://127.0.0.1:2/", second.pid, tmp_path) == ""
    first.kill()
    first.wait(10.0)
    assert claim("kr120", NO_MASTER, second.pid, tmp_path) == ""


def test_the_master_tells_those_who_share_no_folder(tmp_path, starts, master):
    first, second = starts
    assert claim("kr120", master, first.pid, tmp_path / "a") == ""
    assert claim("kr120", master, second.pid, tmp_path / "b").startswith(f"process {first.pid} on ")
    # what was refused leaves nothing behind, and what has ended is taken away
    server = rosgraph.Master("/test", master)
    assert len(server.getParam(f"{PARAMETERS}/kr120")) == 1
    first.kill()
    first.wait(10.0)
    assert claim("kr120", master, second.pid, tmp_path / "b") == ""
    (text,) = server.getParam(f"{PARAMETERS}/kr120").values()
    assert json.loads(text)["pid"] == second.pid


def test_preflight_refuses_it_in_one_sentence(tmp_path, monkeypatch, starts):
    monkeypatch.setattr(preflight, "claim", lambda robot, uri, pid: claim(robot, uri, pid, Path(tmp_path)))
    first, second = starts
    assert preflight.claim_problem({"robot": "kr120"}, NO_MASTER, first.pid) == ""
    said = preflight.claim_problem({"robot": "kr120"}, NO_MASTER, second.pid)
    assert said.startswith(f"robot:=kr120: process {first.pid} on ") and said.endswith("e.g. robot:=kr120_2")
    assert preflight.claim_problem({}, NO_MASTER, second.pid) == ""

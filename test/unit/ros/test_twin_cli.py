"""The command line's way to its master: whoever does not answer is one sentence, in bounded time."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
import rosgraph
import rospy
from construction_twin.msg import PlanOutcome, Rehearsal
from launch_files import parameters
from processes import free_port
from ros_master import ros_master
from sensor_msgs.msg import JointState

from construction_twin.core.errors import ConfigurationError, SilenceError
from construction_twin.core.reports import HoldReport, SyncReport
from construction_twin.gateway.config import load_config
from construction_twin.replay import replay
from construction_twin.review.rehearsal_report import FAILED, RehearsalReport, with_hash
from construction_twin.ros.commands import save_failure
from construction_twin.ros.commands import twin as twin_cli
from construction_twin.ros.commands.preflight import LaunchParameters
from construction_twin.ros.messages.records import to_msg
from construction_twin.ros.messages.services import Outcome
from construction_twin.views.arguments import Exit, parser
from construction_twin.views.texts import Snapshot

ROOT = Path(__file__).resolve().parents[3]

OPTIONS = SimpleNamespace(timeout=0.3, robot="kr120")


def connect(monkeypatch, uri: str) -> None:
    monkeypatch.setenv("ROS_MASTER_URI", uri)
    monkeypatch.setattr(twin_cli.rospy, "init_node", lambda *_, **__: pytest.fail("became a node without a master"))
    twin_cli.connect(OPTIONS)


def twin(uri: str, *words: str) -> subprocess.CompletedProcess:
    command, env = [sys.executable, str(ROOT / "nodes" / "twin"), *words], {**os.environ, "ROS_MASTER_URI": uri}
    return subprocess.run(command, capture_output=True, text=True, timeout=60.0, env=env)


def test_a_refused_model_that_is_not_there_is_one_sentence(tmp_path, capsys):
    absent = tmp_path / "absent.ifc"
    assert twin_cli.run(parser("kr120").parse_args(["save-failure", "--model", str(absent), "-"])) == Exit.USAGE
    assert capsys.readouterr().err.startswith(f"twin: {absent} is not there; ")
    absent.with_suffix(".urdf").write_text("<robot")
    words = ["save-failure", "--model", str(absent.with_suffix(".urdf")), str(tmp_path / "failure.json")]
    said = f"{words[-1]}: python3 -m construction_twin.replay says what happens now\n"
    assert (twin_cli.run(parser("kr120").parse_args(words)), capsys.readouterr().out) == (Exit.DONE, said)


def test_who_stops_reading_is_told_nothing(monkeypatch, capsys):
    monkeypatch.setattr(twin_cli, "connect", Mock(side_effect=BrokenPipeError))
    assert (twin_cli.run(parser("kr120").parse_args(["stop"])), capsys.readouterr().err) == (Exit.INTERRUPTED, "")


def test_a_hold_is_saved_with_the_thresholds_that_the_gate_has_now(monkeypatch):
    monkeypatch.setattr(rospy, "get_param", LaunchParameters(parameters("bringup"), "/kr120/twin").get_param)
    joints = tuple(rospy.get_param("/kr120/robot")["joints"])
    poses = (("twin/joint_states", -0.2), ("physical/joint_states", -0.4))
    latched = {name: JointState(name=joints, position=[q] * 6) for name, q in poses}
    client = SimpleNamespace(latched=lambda name, *_: latched.get(name, PlanOutcome(success=True)))
    sync = SyncReport("REPLANNING", "", name=joints, threshold=(0.1,) * 6)
    hold = HoldReport("A1 differs by 11.459 deg, 5.730 deg allowed", since=1)
    now = Snapshot("kr120", joints, (False,) * 6, sync=sync, hold=hold)
    saved = json.loads(save_failure.running_failure("/kr120", now, client))
    assert saved["sentence"] == replay(saved) == saved["state"]["hold"]["cause"]


@pytest.mark.parametrize("uri", ["localhost:11311", "https://localhost:11311", "http://"])
def test_an_address_that_is_none_is_named(monkeypatch, uri):
    with pytest.raises(ConfigurationError, match="ROS_MASTER_URI"):
        connect(monkeypatch, uri)


def test_a_port_without_anybody_is_no_master(monkeypatch):
    with pytest.raises(SilenceError, match="no ROS master answers"):
        connect(monkeypatch, f"http://127.0.0.1:{free_port()}")


@pytest.mark.parametrize("command, executor", [(["show"], "never started"), (["approve", "--yes"], "hangs")])
def test_an_executor_that_is_down_is_told_without_waiting_for_it(monkeypatch, command, executor):
    """The time that is given for the system is an hour: it is not used."""
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    with ros_master() as uri, socket.socket() as mute:
        master, launched = rosgraph.Master("/bringup", uri), LaunchParameters(parameters("bringup"), "/kr120/twin")
        for name in ("/kr120/robot", "/kr120/robot_description"):
            master.setParam(name, launched.get_param(name))
        said = "no node publishes it"
        if executor == "hangs":
            mute.bind(("127.0.0.1", 0))
            mute.listen()
            address = f"http://127.0.0.1:{mute.getsockname()[1]}"
            rosgraph.Master("/kr120/executor", uri).registerPublisher("/kr120/execution", "std_msgs/String", address)
        if executor != "never started":
            said = "/kr120/executor has ended, or does not answer"
        run = twin(uri, "--timeout", "3600", *command)
    assert run.returncode == Exit.SILENT and run.stdout == ""
    assert run.stderr == f"twin: /kr120/execution: {said}; start bringup, or see why the node is down\n"


def test_a_command_gives_up_on_a_master_that_keeps_silent():
    with socket.socket() as mute:
        mute.bind(("127.0.0.1", 0))
        mute.listen()
        uri = f"http://127.0.0.1:{mute.getsockname()[1]}"
        run = twin(uri, "status")
    assert run.returncode != 0 and run.stdout == ""
    assert run.stderr == (f"twin: {uri}: no ROS master answers (timed out); start bringup, or set ROS_MASTER_URI\n")


@pytest.mark.parametrize(
    "latched, seen", [({}, True), ({"plan_hash": "another"}, False), ({"plan_id": "another"}, False), (None, False)]
)
def test_an_override_is_of_the_result_that_was_printed_before_it_was_asked(monkeypatch, capsys, latched, seen):
    plan = SimpleNamespace(id="p", hash="h")
    report = RehearsalReport("p", "h", state=FAILED, reasons=("link_5 touches wall",))
    asked = []

    def wait_for_message(topic, _kind, _timeout):
        assert topic == "/kr120/rehearsal"
        if latched is None:
            raise rospy.ROSException("nothing there")
        return to_msg(with_hash(replace(report, **latched), 0.1), Rehearsal)

    def review(verdict):
        asked.append((verdict, capsys.readouterr().out))
        return Outcome(True, "approved")

    monkeypatch.setattr(twin_cli.rospy, "wait_for_message", wait_for_message)
    for name, answer in {"_listener": None, "_under_review": plan, "_print_plan": None}.items():
        monkeypatch.setattr(twin_cli.Command, name, lambda *_, answer=answer: answer)
    words = ["approve", "--yes", "--override-rehearsal", "--reason", "the wall is gone"]
    command = twin_cli.Command(parser("kr120").parse_args(words))
    command._client = SimpleNamespace(review=review)
    assert command.run() is Exit.DONE
    ((verdict, printed),) = asked
    assert (verdict.override_rehearsal, verdict.plan_hash) == (True, "h")
    assert verdict.rehearsal_hash == (with_hash(report, 0.1).hash if seen else "")
    assert ("link_5 touches wall" in printed) == bool(seen) and ("was not rehearsed yet" in printed) != bool(seen)


def test_the_gateway_s_configuration_is_written_for_the_cell_pc(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(twin_cli.rospy, "get_param", LaunchParameters(parameters("bringup"), "/kr120/twin").get_param)
    monkeypatch.setattr(twin_cli, "OperatorClient", lambda *_: None)
    file = tmp_path / "kr120_gateway.json"
    assert twin_cli.Command(parser("kr120").parse_args(["gateway", str(file)])).run() is Exit.DONE
    config = load_config(str(file))
    said = capsys.readouterr().out
    assert said.startswith(f"{file}: configuration {config.hash[:12]} of kr120, 3 decimals; RSI on UDP port 49152, ")

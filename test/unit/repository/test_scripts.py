"""The scripts behind `make`: sentences about ports, and what the demo shows and returns."""

from __future__ import annotations

import importlib.util
import socket
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
SCRIPTS = ROOT / "scripts"


def load(name: str):
    spec = importlib.util.spec_from_file_location(name, SCRIPTS / f"{name}.py")
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


check_ports = load("check_ports")
demo = load("demo")  # imports check_ports


@pytest.fixture
def free_master(monkeypatch):
    """A free port for the ROS master."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as free:
        free.bind(("127.0.0.1", 0))
        monkeypatch.setenv("ROS_MASTER_PORT", str(free.getsockname()[1]))


@pytest.mark.parametrize(
    ("kind", "argument", "word"),
    [(socket.SOCK_STREAM, "broker_port", "MQTT broker"), (socket.SOCK_DGRAM, "rsi_port", "RSI gateway")],
)
def test_names_the_port_that_is_taken(kind, argument, word, capsys, free_master):
    with socket.socket(socket.AF_INET, kind) as holder:
        holder.bind(("127.0.0.1", 0))
        if kind is socket.SOCK_STREAM:
            holder.listen()
        port = holder.getsockname()[1]
        other = "gateway:=false" if argument == "broker_port" else "broker:=false"
        assert check_ports.main([f"{argument}:={port}", other]) == 1
    sentence = capsys.readouterr().err
    assert word in sentence and str(port) in sentence


@pytest.mark.parametrize("finishes", [True, False])
def test_success_is_judged_in_the_folder_that_was_given(finishes, tmp_path, capsys, monkeypatch, free_master):
    def launch(arguments):
        assert arguments == given
        (tmp_path / "run").mkdir()
        (tmp_path / "latest").symlink_to("run")
        if finishes:
            (tmp_path / "run/summary.json").write_text("{}")

    given = [f"results_dir:={tmp_path}", "broker:=false", "gateway:=false"]
    monkeypatch.setattr(demo, "launch", launch)
    assert demo.main(given) == (0 if finishes else 1)
    assert ("did not finish" in capsys.readouterr().err) is not finishes


def test_a_second_set_up_builds_nothing(tmp_path):
    """With a package of one message, and catkin_make itself: what it writes into the workspace is no input of a build."""
    script = (ROOT / "setup/setup.sh").read_text().partition("\ncheck_path\n")[0]
    for name, text in {
        "setup/setup.sh": f"{script}\nlink_repository && build_workspace\n",
        "setup/control_msgs/msg/One.msg": "",
        "setup/control_msgs/package.xml": "",
        "setup.py": "",
        "package.xml": "<package><name>one</name><version>0.0.0</version><description>one</description><license>none</license>"
        '<maintainer email="a@b.invalid">a</maintainer><buildtool_depend>catkin</buildtool_depend></package>',
        "CMakeLists.txt": "cmake_minimum_required(VERSION 3.5)\nproject(one)\nfind_package(catkin REQUIRED)\ncatkin_package()\n",
        "msg/One.msg": "",
        "srv/One.srv": "---\n",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    (tmp_path / ".ws/catkin").mkdir(parents=True)
    (tmp_path / ".ws/venv").symlink_to(sys.prefix)

    def set_up() -> str:
        run = subprocess.run(["bash", str(tmp_path / "setup/setup.sh")], capture_output=True, text=True, timeout=120)
        assert run.returncode == 0, run.stderr
        return run.stdout

    assert "building the catkin workspace" in set_up()
    assert (tmp_path / ".ws/catkin/src/CMakeLists.txt").exists(), "catkin_make wrote it"
    assert set_up() == ""

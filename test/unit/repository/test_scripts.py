"""The scripts behind `make`: sentences about ports, and what the demo shows and returns."""

from __future__ import annotations

import importlib.util
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from construction_twin.broker.start import DEFAULT_PORT

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


def test_ports_that_are_not_needed_are_not_looked_at(capsys, free_master):
    assert check_ports.main(["broker:=false", "gateway:=false"]) == 0
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("argument", ["broker_port:=abc", "broker_port:=0", "rsi_port:=65536", "rsi_port:=-1"])
def test_what_is_no_port_is_one_sentence(argument, capsys, free_master):
    others = ["gateway:=false"] if "broker" in argument else ["broker:=false"]
    assert check_ports.main([argument, *others]) == 1
    sentence = capsys.readouterr().err
    assert sentence.count("\n") == 1
    assert argument.split(":=")[0] in sentence and "65535" in sentence


@pytest.mark.parametrize("file", ["bringup", "experiment"])
def test_default_broker_port_is_the_same_everywhere_and_not_that_of_debians_service(file):
    root = ElementTree.parse(ROOT / "launch" / f"{file}.launch").getroot()
    default = root.find("arg[@name='broker_port']").get("default")
    assert int(default) == DEFAULT_PORT != 1883


def shown(*pieces: bytes) -> bytes:
    output = demo.Filter()
    return b"".join(output.feed(piece) for piece in pieces) + output.close()


def test_filter_drops_what_roslaunch_says_about_itself_and_what_follows_the_end():
    text = (
        b"... logging to /x\n\nprocess[a-1]: started\nwaiting\n\n\n table\n"
        b"REQUIRED process [/kr120/experiment-9] has died!\nbye\n"
    )
    assert shown(text) == b"waiting\n\n table\n"


def test_filter_does_not_depend_on_how_the_stream_is_cut():
    text = b"one\n\x1b[1mlogging to\x1b[0m\n\ntwo\n\nthree"
    assert shown(*(bytes([byte]) for byte in text)) == shown(text) == b"one\ntwo\n\nthree\n"


def test_filter_passes_a_progress_bar_as_it_comes():
    output = demo.Filter()
    output.feed(b"before\n")
    assert output.feed(b"\x1b[?25l10 %") == b"\x1b[?25l10 %"
    assert output.feed(b"\r\x1b[2K20 %") == b"\r\x1b[2K20 %"
    assert output.feed(b"\n\x1b[?25hafter\n") == b"\n\x1b[?25hafter\n"


def test_filter_leaves_the_cursor_visible():
    assert shown(b"\x1b[?25lbar\n\x1b[?25hREQUIRED process [/kr120/experiment-9] has died!\n").endswith(b"\x1b[?25h")


def test_experiment_learns_that_its_output_ends_on_a_terminal():
    assert demo.environment({"ROS_MASTER_PORT": "11366"}, True)["TTY_COMPATIBLE"] == "1"
    assert demo.environment({"ROS_MASTER_PORT": "11366"}, False)["ROS_MASTER_URI"] == "http://localhost:11366"
    assert "TTY_COMPATIBLE" not in demo.environment({}, False)


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


def test_a_repository_in_a_path_with_a_space_is_one_sentence(tmp_path):
    folder = tmp_path / "my work" / "setup"
    folder.mkdir(parents=True)
    shutil.copy(ROOT / "setup" / "setup.sh", folder)
    run = subprocess.run(["bash", str(folder / "setup.sh")], capture_output=True, text=True, timeout=60)
    assert run.returncode == 1 and run.stdout == "" and run.stderr.count("\n") == 1
    assert run.stderr.startswith(
        f"[setup] cannot go on: the path {folder.parent} holds a space, and catkin, which builds ROS"
    )


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

"""What a start is refused for before anything starts: each node with the parameters that a launch file would give it."""

from __future__ import annotations

import os
import shutil
import socket
import sys
from pathlib import Path

import pytest
from launch_files import refusals
from roslaunch.core import RLException

from construction_twin.broker import make_site
from construction_twin.core.errors import ConfigurationError
from construction_twin.ros.nodes import startup
from construction_twin.ros.nodes.startup import expect_known, expect_reachable
from construction_twin.ros.shared.params import ros_home

ROOT = Path(__file__).resolve().parents[3]
#: Without programs that look at ports, so that tests may run beside each other.
QUIET = ("broker:=false", "gateway:=false")
SCENARIO = (ROOT / "config" / "scenarios" / "nominal.yaml").read_text()


def refused(*words: str, file: str = "bringup", **changes: object) -> list[str]:
    """Return why a start is refused, each sentence once."""
    given = {word.partition(":=")[0] for word in words}
    quiet = [word for word in QUIET if word.partition(":=")[0] not in given]
    return list(refusals(file, *(quiet if file == "bringup" else ()), *words, **changes))


def make_folders(folder: Path) -> Path:
    """Return an empty site's folder."""
    for name in ("broker", "accounts/kr120-bridge"):
        (folder / name).mkdir(parents=True)
    return folder


def console(folder: Path, listen: str = "127.0.0.1", port: int = 0, page: str = "") -> str:
    """Return the argument that starts a console with a file of its own."""
    (file := folder / "console.yaml").write_text(f"listen: {listen}\nport: {port or free_port()}\npage: '{page}'\n")
    return f"console:={file}"


def free_port() -> int:
    with socket.socket() as tcp:
        tcp.bind(("127.0.0.1", 0))
        return tcp.getsockname()[1]


@pytest.mark.parametrize(
    "words",
    [
        (),
        ("track:=true",),
        ("arm:=none", "ethernet_xml:=/none"),
        ("gateway_kind:=plc",),
        ("rsi_cycle:=12",),
        ("separation:=true", "gui:=true"),
        ("arm:=real", "auto_approve:=true", "auto_approve_is_meant:=true", "anonymous_broker_is_meant:=true"),
        ("arm:=mock", "auto_approve:=true", "auto_approve_sources:=/move_group"),
    ],
)
def test_what_the_package_ships_is_fine(words):
    assert refused(*words) == []


@pytest.mark.parametrize(
    "words, sentence",
    [
        ("arm:=foo", "arm: found 'foo', expected mock, real or none"),
        ("twin:=bullet", "twin: found 'bullet', expected kinematic, mujoco or gazebo"),
        ("servo:=perfect", "servo: found 'perfect', expected ideal, realistic or physics"),
        ("gateway_kind:=bare", "gateway_kind: found 'bare', expected rsi or plc"),
        ("rehearsal:=maybe", "mode: found 'maybe', expected auto, advise or require"),
        ("decimals:=7", "decimals: found 7, expected less than or equal to 6"),
        ("realtime:=100", "realtime_priority: found 100"),
        ("robot:=Kuka", "name: found 'Kuka', expected a name of small letters, digits and _"),
        ("rsi_cycle:=8", "cycle: found 8, expected "),
        ("scene:=/no/such.yaml", "/no/such.yaml"),
        ("ethernet_xml:=/no/such.xml", "/no/such.xml"),
        ("ethernet_xml:=none", "expected "),
        ("tool:=/no/such.yaml arm:=none", "/no/such.yaml"),
        ("payload:=-3", "payload: found (-3.0,), expected a mass above 0"),
        ("twin:=gazebo payload:=3", "payload: found [3.0], expected none with twin:=gazebo"),
        ("servo_model:=/no/such.json", "/no/such.json"),
        ("accounts:=/no", "/no/kr120-bridge/account.json"),
        ("broker:=true accounts:=/no", "mosquitto.conf: found '/no/../broker/mosquitto.conf', expected a file that can be read"),
        ("gateway_kind:=plc track:=true", "gateway_kind: found 'plc', expected rsi with track:=true"),
        ("console:=true arm:=none", "console: found True, expected false with arm:=none"),
        ("console:=/no/console.yaml", "/no/console.yaml"),
        ("gui:=maker", "gui: found 'maker', expected true or false or marker"),
        ("gateway:=true rsi_listen:=0.0.0.0", "--controller: found '', expected the controller's address"),
        ("gateway:=true gateway_trace:=/no/a.trace", "--trace: found '/no/a.trace', expected "),
        ("work_model:=/no/such.ifc", "work_model: found '/no/such.ifc', expected the absolute path of a file"),
        ("arm:=real", "accounts: found '', expected accounts, with arm:=real"),
        ("arm:=real auto_approve_is_meant:=true", "accounts: found '', expected accounts, with arm:=real"),
        ("arm:=real gateway:=true rsi_port:=0", "accounts: found '', expected accounts, with arm:=real"),
        ("arm:=real auto_approve:=true anonymous_broker_is_meant:=true", "auto_approve: found True, expected false with arm:=real"),
        ("arm:=real auto_approve:=1", "auto_approve: found True, expected false with arm:=real"),
        ("arm:=real auto_approve_sources:=/move_group auto_approve_is_meant:=true", "auto_approve_sources: found "),
    ],
)  # fmt: skip
def test_arguments_that_cannot_work_or_must_be_meant_are_refused(words, sentence):
    said = refused(*words.split())
    assert any(sentence in each for each in said), said
    assert all("\n" not in each and "Traceback" not in each for each in said)


def test_a_broker_that_lets_in_everybody_is_refused_though_there_are_accounts(tmp_path):
    site = make_folders(tmp_path)
    config, account = site / "broker" / "mosquitto.conf", site / "accounts" / "kr120-bridge" / "account.json"
    account.write_text("{}")
    given = ("arm:=real", f"accounts:={site}/accounts", "broker:=true", f"broker_port:={free_port()}")
    for text, is_open in (("allow_anonymous true\n", True), ("# allow_anonymous true\nallow_anonymous false\n", False)):
        config.write_text(text)
        said = [each for each in refused(*given) if "expected accounts" in each]
        assert [each.startswith("mosquitto.conf: found ") for each in said] == [True] * is_open


@pytest.mark.parametrize(
    "name, text, sentence",
    [
        ("ethernet_xml", "<ROOT><CONFIG>\n", "expected well-formed XML"),
        ("scene", "objects: {wall: {shape: ", "expected "),
        ("scene", "padding: -1\nobjects: {}", "padding"),
        ("scene", "{padding: 0.0, objects: {tool: {shape: box, size: [1, 1, 1], link: tool_0}}}", "tool_0"),
        ("cell", "kr120: {xyz: [0, 0]}", "xyz"),
        ("cell", "another: {xyz: [0.0, 0.0, 0.0], rpy_deg: [0.0, 0.0, 0.0]}", "kr120"),
        ("tool", "name: 1", "expected "),
        ("servo_model", "{}", "expected "),
    ],
)  # fmt: skip
def test_broken_contents_are_one_sentence_with_what_was_expected(tmp_path, name, text, sentence):
    (file := tmp_path / "broken").write_text(text)
    said = refused(f"{name}:={file}")
    assert said and all(sentence in each and "\n" not in each for each in said), said


@pytest.mark.parametrize(
    "name, text, sentence",
    [
        ("self_collision", "ignored: [", "expected a YAML file"),
        ("self_collision", "ignored: []", "expected "),
        ("self_collision", None, "self_collision.yaml"),
        ("self_collision", (ROOT / "config/kr120_track_self_collision.yaml").read_text(), "expected "),
        ("drives", "axes: 3", "expected "),
        ("drives", None, ""),
    ],
)
def test_what_lies_beside_the_robot_yaml_is_checked(tmp_path, name, text, sentence):
    for each in ("kr120", "kr120_self_collision", "kr120_drives"):
        shutil.copy(ROOT / f"config/{each}.yaml", tmp_path)
    file = tmp_path / f"kr120_{name}.yaml"
    file.unlink() if text is None else file.write_text(text)
    said = refused("servo:=physics", f"robot_config:={tmp_path}/kr120.yaml")
    assert bool(said) is bool(sentence) and all(sentence in each and "\n" not in each for each in said), said


@pytest.mark.parametrize("text", ["{", '{"user": "a"}'])
def test_a_broken_account_is_refused(tmp_path, text):
    site = make_folders(tmp_path)
    (site / "accounts" / "kr120-bridge" / "account.json").write_text(text)
    said = refused(f"accounts:={site}/accounts")
    assert said and all("expected " in each and "\n" not in each for each in said), said


@pytest.mark.parametrize("name, text", [("robot_xacro", "<robot"), ("robot_config", "joints: [")])
def test_a_robot_s_file_that_roslaunch_cannot_load_is_its_own_refusal(tmp_path, name, text):
    (file := tmp_path / "broken").write_text(text)
    with pytest.raises(RLException):
        refused(f"{name}:={file}")


@pytest.mark.parametrize("name", ["ethernet_xml", "robot_config"])
def test_a_file_of_another_arm_is_refused(name):
    ending = {"ethernet_xml": "krl/ethernet/ctwin_e1_ethernet.xml", "robot_config": "config/kr120_track.yaml"}
    said = refused(f"{name}:={ROOT}/{ending[name]}")
    assert said and all("expected " in each for each in said)


@pytest.mark.parametrize("words", [["accelerations"], ["accelerations", "axes"]])
def test_a_real_arm_does_not_move_by_estimates(words):
    assert refused(robot__estimates=words) == []
    said = refused("arm:=real", "anonymous_broker_is_meant:=true", robot__estimates=words)
    assert len(said) == 1 and said[0].startswith(
        f"estimates: found {words}, expected none with arm:=real: put in the right values of"
    )


def test_a_range_that_the_wire_cannot_carry_is_refused():
    said = refused("track:=true", robot__joints__track__offset_mm=99_000.0)
    assert any("the wire can carry" in each for each in said), said


def test_an_action_without_its_messages_is_refused_with_what_to_do(monkeypatch):
    monkeypatch.setitem(sys.modules, "control_msgs.msg", None)
    (said,) = refused()
    assert said.startswith("the Python package control_msgs: found 'missing") and "ros-noetic-control-msgs" in said


@pytest.mark.parametrize(
    "name, values, sentence",
    [
        ("executor", {"speed_limit_deadlin": 0.5}, "speed_limit_deadlin: found 0.5, expected no such key; did you mean"),
        ("executor", {"review_file": "/dev/null/{robot}.jsonl"}, "expected a folder that files can be written into"),
        ("pca_monitor", {"transition_file": "/dev/null/{robot}.jsonl"}, "expected a folder that files can be written into"),
        ("pca_monitor", {"threshold": -1.0}, "threshold: found -1.0, expected greater than 0"),
        ("pca_monitor", {"threshold": None}, "threshold: found nothing, expected this key"),
        ("pca_monitor", {"treshold": 0.01, "threshold": None}, "treshold: found 0.01, expected no such key; did you mean"),
        ("pca_monitor", {"thresholds": {"joint_a7": 0.1}}, "thresholds: found 'joint_a7', expected names of joints"),
        ("planner", {"planner": "RTRConnect"}, "planner: found 'RTRConnect', expected one of "),
        ("gateway", {"silence": -1.0}, "silence"),
        ("gateway", {"silense": 0.1}, "silense"),
        ("mqtt_bridge", {"reset_timeout": "soon"}, "reset_timeout: found 'soon', expected a number"),
        ("mock_rsi", {"start_pose_deg": [0.0, -90.0, 999.0, 0.0, 0.0, 0.0]}, "A3 is 999 deg, outside its range"),
        ("separation", {"table": [[1.0, 0.5], [0.5, 1.0]]}, "table"),
        ("separation", {"rate": 0}, "rate: found 0, expected greater than or equal to 1"),
    ],
)  # fmt: skip
def test_a_setting_of_a_node_s_file_with_which_it_would_not_start_is_refused(name, values, sentence):
    only = "mqtt_bridge" if name == "gateway" else name
    said = refused("separation:=true", only=only, **{f"{name}__{key}": value for key, value in values.items()})
    assert said and all(sentence in each for each in said), said


@pytest.mark.parametrize(
    "file, name, text, sentence",
    [
        ("experiment", "task", "goals_deg: [[0.0, -90.0]]", "a goal in ~goals_deg has 2 values; kr120 has 6 joints"),
        ("experiment", "task", "goals_deg: [[0.0, -90.0, 990.0, 0.0, 90.0, 0.0]]", "joint_a3"),
        ("experiment", "task", "durations: 3.0", "durations: found 3.0, expected no such key; did you mean duration?"),
        ("experiment", "results_dir", "", "expected a folder that files can be written into"),
        ("scenario", "results_dir", "", "expected a folder that files can be written into"),
        ("scenario", "scenario", "scenario: {title: t}", "steps: found nothing, expected this key"),
        ("scenario", "scenario", f"{SCENARIO}\npca_monitor: {{policy: replann}}", "policy: found 'replann', expected "),
        ("scenario", "scenario", f"{SCENARIO}\nexecutor: {{auto_aprove: true}}", "auto_aprove: found True, expected no such key"),
        ("scenario", "scenario", f"{SCENARIO}\npca_monitr: {{policy: replan}}", "did you mean pca_monitor?"),
    ],
)  # fmt: skip
def test_what_an_experiment_would_end_with_is_found_before_it_starts(tmp_path, file, name, text, sentence):
    """A folder that is a file takes no results."""
    (given := tmp_path / "given.yaml").write_text(text)
    said = refused(f"{name}:={given}", f"broker_port:={free_port()}", f"rsi_port:={free_port()}", file=file)
    assert len(said) == 1 and sentence in said[0], said


def test_every_shipped_scenario_is_fine():
    for file in sorted((ROOT / "config" / "scenarios").glob("*.yaml")):
        ports = (f"broker_port:={free_port()}", f"rsi_port:={free_port()}")
        assert refused(f"scenario:={file}", *ports, file="scenario") == []


# -- ports, and programs that speak no ROS


def test_a_taken_port_is_refused(tmp_path):
    with socket.socket() as tcp, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        tcp.bind(("127.0.0.1", 0))
        tcp.listen()
        udp.bind(("127.0.0.1", 0))
        taken, rsi = tcp.getsockname()[1], udp.getsockname()[1]
        (said,) = refused("broker:=true", f"broker_port:={taken}")
        assert said.startswith(f"broker_port: found {taken}, expected a free TCP port")
        (said,) = refused("gateway:=true", f"rsi_port:={rsi}")
        assert str(rsi) in said
        (said,) = refused(console(tmp_path, port=taken))
        assert f"127.0.0.1:{taken}" in said


@pytest.mark.parametrize(
    "name, text, sentence",
    (
        ("", "", ""),
        ("console.key", "no PEM\n", "--certificate and --key: found '[SSL] PEM lib"),
        ("ca.crt", "no PEM\n", "--broker-ca: found "),
        ("rights.json", "no JSON\n", "--rights: found "),
    ),
)
def test_a_site_with_a_file_that_the_console_could_not_use_is_refused(tmp_path, name, text, sentence):
    options = ("--host", "localhost", "--robot", "kr120", "--person", "ada:approve", "--console", "localhost")
    assert make_site.main([str(tmp_path / "site"), *options]) == 0
    if name:
        (tmp_path / "site" / "console" / name).write_text(text)
    said = refused(console(tmp_path), f"accounts:={tmp_path}/site/accounts")
    assert [each.startswith(sentence) for each in said] == [True] * bool(name)


@pytest.mark.parametrize(
    "keys, sentence",
    [
        ({"listen": "0.0.0.0"}, "--listen: found '0.0.0.0', expected loopback, or"),
        ({"page": "/no/page"}, "--page: found '/no/page', expected "),
        ({"page": "x'\nprot: '1"}, "the keys of config/console.yaml"),
    ],
)
def test_a_file_of_a_console_that_could_not_serve_is_refused(tmp_path, keys, sentence):
    (said,) = refused(console(tmp_path, **keys))
    assert sentence in said


def test_a_server_of_gazebo_that_is_not_there_is_refused():
    said = refused("twin:=gazebo", gazebo__gzserver="/no/gzserver")
    assert "gzserver: found '/no/gzserver', expected a program that starts Gazebo" in said[0]


def test_a_make_that_is_not_there_is_refused():
    said = refused(gateway__make="fanuc")
    assert said and all("make: found 'fanuc', expected " in each for each in said)


def test_a_trace_of_the_gateway_lies_where_roslaunch_starts_it(tmp_path, monkeypatch):
    monkeypatch.setenv("ROS_HOME", str(tmp_path))
    monkeypatch.chdir(ros_home())
    assert refused("gateway:=true", f"rsi_port:={free_port()}", "gateway_trace:=a.trace") == []
    (tmp_path / "folder").mkdir()
    (said,) = refused("gateway:=true", f"rsi_port:={free_port()}", "gateway_trace:=folder")
    assert said.startswith("--trace: found 'folder', expected ")


# -- what is no node's


@pytest.mark.parametrize("variable", ["ROS_IP", "ROS_HOSTNAME"])
def test_an_address_that_is_nobody_s_is_refused(monkeypatch, variable):
    monkeypatch.setattr(startup, "ADDRESS_TIME", 0.3)
    monkeypatch.setenv("ROS_MASTER_URI", "http://127.0.0.1:1")
    for address, why in (
        ("192.0.2.77", "it leads to no program here"),
        ("", "it is empty"),
        ("nobody.invalid", "it leads to no program here"),
    ):
        with pytest.raises(ConfigurationError, match=f"{variable}: found .*{why}"):
            expect_reachable({variable: address})
    expect_reachable({variable: "127.0.0.1"})
    expect_reachable(dict(os.environ))


def test_a_misspelt_argument_of_this_package_s_launch_files_is_refused():
    expect_known(["roslaunch", "construction_twin", "bringup.launch", "arm:=none", "__name:=me"])
    expect_known(["roslaunch", "mine.launch", "speed:=3"])
    with pytest.raises(
        ConfigurationError, match="brocker: found 'false', expected an argument .* did you mean broker:=?"
    ):
        expect_known(["roslaunch", str(ROOT / "launch" / "bringup.launch"), "brocker:=false"])
    with pytest.raises(ConfigurationError, match="self_collision: found '/a.yaml', expected an argument"):
        expect_known(["roslaunch", "construction_twin", "bringup.launch", "self_collision:=/a.yaml"])

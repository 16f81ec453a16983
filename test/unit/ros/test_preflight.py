"""What a start is refused for before anything starts: contents of files, a robot that runs already, ports; and how it is said."""

from __future__ import annotations

import os
import shutil
import socket
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest
import rosgraph
import yaml
from ros_master import Node, ros_master

from construction_twin.broker import make_site
from construction_twin.core.sentences import Sentence
from construction_twin.robot.description import read_robot_files
from construction_twin.ros.commands import preflight
from construction_twin.ros.commands.node_files import NODE_FILES, node_files_problem
from construction_twin.views.roslaunch_call import RoslaunchCall


def wrong(name: str, value: str, expected: str) -> Sentence:
    return Sentence("preflight.wrong", name=name, value=value, expected=expected)


def in_use(what: str, port: str, number: int) -> Sentence:
    more = {"host": "127.0.0.1"} if what != "broker" else {}
    more |= {"number": number} if what == "rsi" else {}
    return Sentence(f"preflight.port.{what}", port=port, other=number + 10, **more)


ROOT = Path(__file__).resolve().parents[3]
KR120 = {
    "robot": "kr120",
    "arm": "mock",
    "decimals": "3",
    "robot_xacro": f"{ROOT}/urdf/kr120r2500.urdf.xacro",
    "robot_config": f"{ROOT}/config/kr120.yaml",
    "self_collision": f"{ROOT}/config/kr120_self_collision.yaml",
    "ethernet_xml": f"{ROOT}/krl/ethernet/ctwin_ethernet.xml",
    "scene": f"{ROOT}/config/scene.yaml",
    "cell": "",
    "neighbour": "",
    "bridge_account": "",
    "gateway_account": "",
}
TRACK = KR120 | {
    "robot_xacro": f"{ROOT}/urdf/kr120_track.urdf.xacro",
    "robot_config": f"{ROOT}/config/kr120_track.yaml",
    "self_collision": f"{ROOT}/config/kr120_track_self_collision.yaml",
    "ethernet_xml": f"{ROOT}/krl/ethernet/ctwin_e1_ethernet.xml",
}

SCENARIO = (ROOT / "config" / "scenarios" / "nominal.yaml").read_text()


# -- contents


@pytest.mark.parametrize(
    "given", [KR120, TRACK, KR120 | {"arm": "none", "ethernet_xml": TRACK["ethernet_xml"]}, {"arm": "mock"}]
)
def test_files_that_fit_pass(given):
    assert preflight.contents_problem(given) == ""


def test_an_action_without_its_messages_is_refused_with_what_to_do(monkeypatch):
    given = KR120 | {"follow_joint_trajectory": "true"}
    assert preflight.contents_problem(given) == ""
    monkeypatch.setitem(sys.modules, "control_msgs.msg", None)
    said = preflight.contents_problem(given)
    assert said.startswith("follow_joint_trajectory:=true: the Python package control_msgs: found 'missing")
    assert "ros-noetic-control-msgs" in said and said.endswith("or follow_joint_trajectory:=false")
    assert preflight.contents_problem(given | {"follow_joint_trajectory": "false"}) == ""


@pytest.mark.parametrize("name", ["self_collision", "ethernet_xml", "robot_config"])
def test_a_file_of_another_arm_is_refused_by_the_argument_that_names_it(name):
    said = preflight.contents_problem(KR120 | {name: TRACK[name]})
    assert said.startswith(f"{name}:={TRACK[name]}") and "expected " in said
    # the command that makes a file anew must not name this one, which is another arm's
    assert said.count(TRACK[name]) == 1


@pytest.mark.parametrize(
    "name, text",
    [
        ("robot_xacro", "<robot"),
        ("robot_xacro", "<robot/>"),
        ("robot_config", "joints: ["),
        ("robot_config", "- 1"),
        ("self_collision", "ignored: ["),
        ("self_collision", "ignored: []"),
        ("ethernet_xml", "<ROOT><CONFIG>"),
        ("scene", "objects: {wall: {shape: "),
        ("scene", "padding: -1"),
        (
            "scene",
            "{padding: 0.0, objects: {wall: {shape: box, size: [1, 1, 1], position: [9, 0, 0], touch: [link_7]}}}",
        ),
        ("scene", "{padding: 0.0, objects: {tool: {shape: box, size: [1, 1, 1], link: tool_0}}}"),
        ("scene", "{padding: 0.0, objects: {link_1: {shape: box, size: [1, 1, 1], position: [9, 0, 0]}}}"),
        ("cell", "kr120: {"),
        ("cell", "kr120: {xyz: [0, 0]}"),
        ("cell", "another: {xyz: [0.0, 0.0, 0.0], rpy_deg: [0.0, 0.0, 0.0]}"),
        ("bridge_account", "{"),
        ("gateway_account", '{"user": "a"}'),
    ],
)
def test_broken_contents_are_one_sentence_with_the_file_and_what_was_expected(tmp_path, name, text):
    file = tmp_path / "broken"
    file.write_text(text)
    said = preflight.contents_problem(KR120 | {name: str(file)})
    assert f"{name}:={file}" in said and "expected" in said
    assert "\n" not in said and "Traceback" not in said


@pytest.mark.parametrize("words", [["accelerations"], ["accelerations", "axes"]])
def test_a_real_arm_does_not_move_by_estimates(tmp_path, words):
    described = yaml.safe_load(Path(KR120["robot_config"]).read_text()) | {"estimates": words}
    file = tmp_path / "estimated.yaml"
    file.write_text(yaml.safe_dump(described))
    given = KR120 | {"robot_config": str(file)}
    assert preflight.contents_problem(given | {"arm": "mock"}) == ""
    assert preflight.contents_problem(given | {"arm": "none"}) == ""
    said = preflight.contents_problem(given | {"arm": "real"})
    assert said.startswith(
        f"robot_config:={file}: estimates: found {words}, expected none with arm:=real: put in the right"
    )
    assert "acceleration_deg_s2" in said and ("rsi, sign" in said) == ("axes" in words)


def test_a_range_that_the_wire_cannot_carry_is_refused(tmp_path):
    described = yaml.safe_load(Path(TRACK["robot_config"]).read_text())
    described["joints"]["track"]["offset_mm"] = 99_000.0
    file = tmp_path / "far.yaml"
    file.write_text(yaml.safe_dump(described))
    assert "the wire can carry" in preflight.contents_problem(TRACK | {"robot_config": str(file)})


@pytest.mark.parametrize(
    "name, text, sentence",
    [
        ("task", "goals_deg: [[0.0, -90.0]]", "a goal in ~goals_deg has 2 values; kr120 has 6 joints"),
        ("task", "goals_deg: [[0.0, -90.0, 990.0, 0.0, 90.0, 0.0]]", "joint_a3"),
        ("task", "durations: 3.0", "durations: found 3.0, expected no such key; did you mean duration?"),
        ("task", "duration: [", "expected a YAML file"),
        ("scenario", "scenario: {title: t}", "steps: found nothing, expected a list with 1 or more entries"),
        ("scenario", "steps: []", "expected the key `scenario`"),
        (
            "scenario",
            f"{SCENARIO}\npca_monitor: {{policy: replann}}",
            "pca_monitor: policy: found 'replann', expected ",
        ),
        (
            "scenario",
            f"{SCENARIO}\nexecutor: {{auto_aprove: true}}",
            "executor: auto_aprove: found True, expected no such key",
        ),
        ("results_dir", "", "expected a folder that files can be written into"),
    ],
)
def test_what_an_experiment_would_end_with_is_found_before_it_starts(tmp_path, name, text, sentence):
    """A folder that is a file takes no results."""
    file = tmp_path / "given.yaml"
    file.write_text(text)
    given = str(file)
    said = preflight.contents_problem(KR120 | {name: given})
    assert said.startswith(f"{name}:={given}: ") and sentence in said


def test_a_trace_that_the_gateway_could_not_write_is_refused(tmp_path):
    """The gateway makes no folders, and would say so again each time that it is started."""
    (file := tmp_path / "file").write_text("")
    given = KR120 | {"gateway": "true"}
    for trace, found in [
        (f"{file}/a.trace", "Not a directory"),
        (f"{tmp_path}/no/a.trace", "no such folder"),
        (str(tmp_path), "a folder"),
    ]:
        said = preflight.contents_problem(given | {"gateway_trace": trace})
        assert said.startswith(f"gateway_trace:={trace}: ") and found in said and "expected " in said
        assert preflight.contents_problem(given | {"gateway_trace": trace, "arm": "none"}) == ""
        assert preflight.contents_problem(given | {"gateway_trace": trace, "gateway": "false"}) == ""
    for trace in ("", str(file), f"{tmp_path}/a.trace"):
        assert preflight.contents_problem(given | {"gateway_trace": trace}) == ""
    check = ElementTree.parse(ROOT / "launch" / "bringup.launch").getroot().find("arg[@name='check']")
    assert check is not None and "gateway_trace:=$(arg gateway_trace)" in check.attrib["value"]


def test_what_the_package_ships_is_fine(tmp_path):
    for file in sorted((ROOT / "config" / "scenarios").glob("*.yaml")):
        assert preflight.contents_problem(KR120 | {"scenario": str(file)}) == ""
    assert (
        preflight.contents_problem(
            KR120 | {"task": f"{ROOT}/config/experiment.yaml", "results_dir": f"{tmp_path}/new/folder"}
        )
        == ""
    )
    assert preflight.contents_problem(TRACK | {"task": f"{ROOT}/config/experiment_track.yaml"}) == ""
    assert not (tmp_path / "new").exists()


# -- what runs already


@pytest.fixture
def master(monkeypatch):
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    with ros_master() as uri:
        yield uri


def test_a_robot_that_runs_already_is_refused_with_who_runs_it(master):
    nodes = [Node(master, "/kr120/executor"), Node(master, "/kr120/pca_monitor")]
    said = preflight.running_problem({"robot": "kr120"}, master)
    for node in nodes:
        node.end()
    both = Sentence("preflight.nodes", node="/kr120/executor on 127.0.0.1, process 4711", count=1)
    assert said == Sentence("preflight.running", robot="kr120", uri=master, nodes=both)


def test_another_robot_on_the_same_master_may_start(master):
    node = Node(master, "/kr120_1/executor")
    assert preflight.running_problem({"robot": "kr120_2"}, master) == ""
    node.end()


def test_a_node_that_was_killed_and_is_still_registered_is_no_running_one(master):
    Node(master, "/kr120/executor").end()
    assert preflight.running_problem({"robot": "kr120"}, master) == ""


def test_a_node_that_does_not_answer_may_live(master):
    with socket.socket() as mute:
        mute.bind(("127.0.0.1", 0))
        mute.listen()
        uri = f"http://127.0.0.1:{mute.getsockname()[1]}"
        rosgraph.Master("/kr120/executor", master).registerPublisher("/t", "std_msgs/String", uri)
        said = preflight.running_problem({"robot": "kr120"}, master)
    assert "/kr120/executor on 127.0.0.1 (does not answer; if it has ended, `rosnode cleanup` removes it)" in said


@pytest.mark.parametrize("simulated", [True, False])
def test_a_master_with_simulated_time_is_refused_before_anything_starts(master, monkeypatch, simulated):
    monkeypatch.setattr(preflight, "address_problem", lambda environ: "")
    rosgraph.Master("/gazebo", master).setParam("/use_sim_time", simulated)
    said = preflight.refusal(KR120, None, master)
    assert (said == "") is not simulated
    assert said == "" or said.startswith("/use_sim_time: found True, expected false: ")


# -- ports


def test_a_taken_port_is_refused_before_anything_starts():
    with socket.socket() as tcp, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        tcp.bind(("127.0.0.1", 0))
        tcp.listen()
        udp.bind(("127.0.0.1", 0))
        broker, rsi = tcp.getsockname()[1], udp.getsockname()[1]
        here = KR120 | {"broker": "true", "broker_port": str(broker), "gateway": "true", "rsi_port": str(rsi)}
        assert preflight.port_problem(here) == in_use("broker", str(broker), broker)
        elsewhere = here | {"broker": "false"}
        assert preflight.port_problem(elsewhere) == in_use("rsi", str(rsi), rsi)
        assert preflight.port_problem(elsewhere | {"gateway": "false"}) == ""
        assert preflight.port_problem(elsewhere | {"arm": "none"}) == ""
    assert preflight.port_problem(here) == ""


@pytest.fixture(scope="module")
def console_site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    options = ("--host", "localhost", "--robot", "kr120", "--person", "ada:approve", "--console", "localhost")
    assert make_site.main([str(folder), *options]) == 0
    return folder / "console"


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    (
        ("", "", ""),
        ("console.key", "no PEM\n", "console:=true: --certificate and --key: found '[SSL] PEM lib"),
        ("ca.crt", "no PEM\n", "console:=true: --broker-ca: found "),
        ("rights.json", "no JSON\n", "console:=true: --rights: found "),
        ("rights.json", "[]", "console:=true: --rights: found "),
        ("rights.json", "{}", "console:=true: --rights: found "),
        ("rights.json", '{"robots": []}', "console:=true: --rights: found "),
    ),
)
def test_a_site_with_a_file_that_the_console_could_not_use_is_refused_by_the_name_of_its_option(
    console_site, tmp_path, name, text, sentence
):
    folder = tmp_path / "console"
    shutil.copytree(console_site, folder)
    if name:
        (folder / name).write_text(text)
    given = KR120 | {"console": "true", "console_page": "none", "console_files": "false", "console_site": str(folder)}
    said = preflight.contents_problem(given)
    assert said.startswith(sentence) and bool(said) == bool(name) == ("expected " in said)
    assert preflight.contents_problem(given | {"console": "false"}) == ""
    assert "console_site: found 'console'" in preflight.contents_problem(given | {"console_site": "console"})


def test_a_taken_port_of_the_console_is_refused():
    with socket.socket() as tcp:
        tcp.bind(("127.0.0.1", 0))
        tcp.listen()
        port = tcp.getsockname()[1]
        given = {"console": "true", "console_port": str(port), "console_listen": "127.0.0.1", "arm": "none"}
        assert preflight.port_problem(given) == in_use("console", str(port), port)
        assert preflight.port_problem(given | {"console": "false"}) == ""
    # another test may take one of them meanwhile, not all
    assert "" in [preflight.port_problem(given | {"console_port": str(free_port())}) for _ in range(5)]


def free_port():
    with socket.socket() as tcp:
        tcp.bind(("127.0.0.1", 0))
        return tcp.getsockname()[1]


def test_a_taken_port_of_a_site_s_broker_is_refused_too(tmp_path):
    file = tmp_path / "site.conf"
    with socket.socket() as tcp:
        tcp.bind(("127.0.0.1", 0))
        tcp.listen()
        port = tcp.getsockname()[1]
        file.write_text(
            f"# listener 1\nlistener 0 {tmp_path}/socket\n  listener {port} 127.0.0.1\nallow_anonymous false\n"
        )
        given = {"broker": "true", "broker_port": "18830", "broker_config": str(file), "arm": "none"}
        assert preflight.port_problem(given) == Sentence("preflight.port.listener", path=str(file), port=port)
        assert preflight.port_problem(given | {"broker": "false"}) == ""
        # the file's own listeners take the place of broker_port
        file.write_text(f"listener 0 {tmp_path}/socket\n")
        assert preflight.port_problem(given | {"broker_port": str(port)}) == ""


@pytest.mark.parametrize(
    "lines, words",
    [
        ("alow_anonymous true\n", "Unknown configuration variable"),
        ("listener {port} 127.0.0.1\ncertfile /nowhere/server.crt\nkeyfile /nowhere/server.key\n", "certificate"),
        ("listener {port} 192.0.2.7\n", "Cannot assign requested address"),
    ],
)
def test_a_broker_that_can_never_start_is_refused_before_anything_starts(tmp_path, lines, words):
    """roslaunch starts the broker again whenever it ends, so nothing else would end such a launch."""
    file, port = tmp_path / "mosquitto.conf", free_port()
    file.write_text(lines.format(port=port))
    given = {"broker": "true", "broker_port": str(port), "broker_config": str(file), "arm": "none"}
    said = preflight.port_problem(given)
    assert said.startswith(f"broker_config:={file}: mosquitto ends with exit code ") and words in said
    assert preflight.port_problem(given | {"broker": "false"}) == ""


# -- the address that nodes give to each other


@pytest.mark.parametrize("variable", ["ROS_IP", "ROS_HOSTNAME"])
def test_an_address_that_is_nobody_s_is_refused_before_anything_starts(monkeypatch, variable):
    monkeypatch.setenv(variable, "192.0.2.77")  # of a network for documents
    monkeypatch.setattr(preflight, "ADDRESS_TIME", 0.3)
    said = preflight.refusal(KR120, None, "http://127.0.0.1:1")
    assert said.key == "preflight.variable" and said.values["variable"] == variable
    assert said.values["why"].startswith("nothing of this machine answers at 192.0.2.77 (")
    monkeypatch.setenv(variable, "127.0.0.1")
    assert preflight.address_problem(os.environ) == ""
    monkeypatch.setenv(variable, "")
    assert preflight.address_problem(os.environ) == Sentence("preflight.variable_empty", variable=variable)


def test_a_name_without_an_address_is_refused(monkeypatch):
    monkeypatch.setenv("ROS_HOSTNAME", "nobody.invalid")
    said = preflight.address_problem(os.environ)
    assert said.startswith("ROS_HOSTNAME=nobody.invalid: it has no IPv4 address (")


# -- arguments that nothing reads


def test_a_misspelt_argument_of_the_call_is_refused_before_anything_else():
    call = RoslaunchCall(("construction_twin", "bringup.launch"), {"robott": "kr120_2"}, {})
    said = preflight.refusal(KR120 | {"arm": "foo"}, call, "")
    near = {"name": "robott", "value": "kr120_2", "file": "bringup.launch", "near": "robot"}
    assert said == Sentence("preflight.argument.near", **near)
    path = RoslaunchCall((str(ROOT / "launch" / "experiment.launch"),), {"quick": "true"}, {})
    assert preflight.call_problem(path) == ""


# -- the program


@pytest.mark.parametrize(
    "text, said",
    [
        ("allow_anonymous true\n", True),
        ("# allow_anonymous true\nallow_anonymous false\n", False),
        ("listener 8883\n", False),
        (None, True),
    ],
)
def test_whether_a_broker_lets_in_everybody_is_read_from_its_configuration(tmp_path, capsys, text, said):
    file, account = tmp_path / "mosquitto.conf", tmp_path / "account.json"
    account.write_text("{}")
    if text is not None:
        file.write_text(text)
    arguments = ["arm:=real", f"bridge_account:={account}", "gateway:=false", "broker:=true", f"broker_config:={file}"]
    assert preflight.check(arguments) == said
    assert ("broker_config" in capsys.readouterr().err) is said


def test_for_roslaunch_the_result_is_on_standard_output(capsys):
    assert preflight.check(["--for-roslaunch", "arm:=foo"]) == 0
    said = capsys.readouterr()
    assert said.out == "refused\n" and said.err == "preflight: arm:=foo: expected mock, real or none\n"
    assert preflight.check(["--for-roslaunch", "arm:=mock"]) == 0
    assert capsys.readouterr().out == "true\n"


# -- the nodes' own files

PAIR = KR120 | {"neighbour": "other", "tool_marker": "true", "separation": "true", "work_model": "/models/panel.ifc"}


@pytest.fixture
def config_folder(tmp_path):
    for file in NODE_FILES:
        (tmp_path / f"{file.name}.yaml").write_text((ROOT / "config" / f"{file.name}.yaml").read_text())
    return tmp_path


@pytest.fixture(scope="module")
def kr120():
    return read_robot_files(KR120["robot_xacro"], KR120["robot_config"])


def changed(folder, name, **values):
    """Write another file of a node; return its path."""
    file = folder / f"{name}.yaml"
    content = yaml.safe_load(file.read_text()) | values
    file.write_text(yaml.safe_dump({key: value for key, value in content.items() if value is not None}))
    return file


def test_the_shipped_files_are_fine(config_folder, kr120):
    for given in (PAIR, PAIR | {"gateway_kind": "plc"}, PAIR | {"arm": "none"}, PAIR | {"rsi_cycle": "12"}):
        assert node_files_problem(given, kr120, config_folder) == ""


@pytest.mark.parametrize(
    "name, values, sentence",
    [
        ("executor", {"speed_limit_deadlin": 0.5}, "speed_limit_deadlin: found 0.5, expected no such key; did you mean"),
        ("executor", {"speed_limit_deadline": 0}, "speed_limit_deadline: found 0, expected a number above 0"),
        ("executor", {"review_file": "/dev/null/{robot}.jsonl"}, "expected a folder that files can be written into"),
        ("pca_monitor", {"transition_file": "/dev/null/{robot}.jsonl"}, "expected a folder that files can be written into"),
        ("pca_monitor", {"threshold": None}, "threshold: found nothing, expected a number"),
        ("pca_monitor", {"thresholds": {"joint_a7": 0.1}}, "thresholds: found 'joint_a7', expected names of joints"),
        ("planner", {"planner": "RTRConnect"}, "planner: found 'RTRConnect', expected one of "),
        ("planner", {"edge_step": 0.0}, "edge_step: found 0.0, expected a number at least 0.001 and at most 0.5"),
        ("neighbour", {"padding": 0.0}, "watch_padding + 0.05 m within padding"),
        ("gateway", {"silence": -1.0}, "silence"),
        ("gateway", {"silense": 0.1}, "silense"),
        ("mqtt_bridge", {"reset_timeout": "soon"}, "reset_timeout: found 'soon', expected a number above 0"),
        ("console_node", {"view_rate": 0}, "view_rate: found 0, expected a number at least 1 and at most 50"),
        ("mock_rsi", {"start_pose_deg": [0.0]}, "start_pose_deg: found [0.0], expected 6 numbers"),
        (
            "mock_rsi", {"start_pose_deg": [0.0, -90.0, 999.0, 0.0, 0.0, 0.0]},
            "A3 is 999 deg, outside its range -120 deg to 155 deg",
        ),
        ("console_node", {"view_rate": 0.5}, "view_rate: found 0.5, expected a number at least 1 and at most 50"),
        ("follow_joint_trajectory", {"goal_tolerance": -1.0}, "goal_tolerance: found -1.0, expected a number at least 0"),
        ("tool_marker", {"scale": 0.0}, "scale: found 0.0, expected a number above 0"),
        ("separation", {"table": [[1.0, 0.5], [0.5, 1.0]]}, "table"),
        ("separation", {"rate": 0}, "rate: found 0, expected a number at least 1"),
    ],
)  # fmt: skip
def test_a_file_with_which_a_node_would_not_start_is_refused_before_it(config_folder, kr120, name, values, sentence):
    file = changed(config_folder, name, **values)
    said = node_files_problem(PAIR, kr120, config_folder)
    assert said.startswith(f"{file}: ") and sentence in said
    assert "expected" in said or "outside its range" in said
    assert "\n" not in said and said.count(str(file)) == 1

"""What a start is refused for before anything starts: contents of files, a robot that runs already, ports; and how it is said."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest
import rosgraph
import yaml
from processes import listens, wait_until
from ros_master import Node, ros_master

from construction_twin.broker import make_site
from construction_twin.controller import makes
from construction_twin.core.sentences import Sentence
from construction_twin.robot.description import read_robot_files
from construction_twin.ros.commands import preflight
from construction_twin.ros.commands.node_files import NODE_FILES, ROBOT_NODES, node_files_problem
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


def test_another_make_is_asked_for_its_cycle_its_file_and_its_port(monkeypatch):
    """Instead of `rsi`; the second make has no file, and its own port."""
    monkeypatch.setitem(makes.MODULES, "frames", "frames_make")
    given = KR120 | {"controller_make": "frames", "rsi_cycle": "8", "ethernet_xml": "none", "servo": "ideal"}
    assert preflight.refusal(given, None, "") == ""
    assert preflight.make_problem(given | {"rsi_cycle": "4"}) == wrong("rsi_cycle", "4", "8")
    assert preflight.make_problem(given | {"controller_make": "fanuc"}) == wrong(
        "controller_make", "fanuc", "rsi or frames"
    )
    said = preflight.contents_problem(given | {"ethernet_xml": KR120["ethernet_xml"]})
    assert said.startswith("ethernet_xml:=") and said.endswith("expected none: frames has no file for its telegrams")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 50_000))
        assert preflight.port_problem(given) == in_use("rsi", "0", 50000)


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


SERVOS = ROOT / "test/data/realistic_servos.yaml"


@pytest.mark.parametrize(
    "more", [{"servo_model": ""}, {"servo_model": str(SERVOS)}, {"servo_model": str(SERVOS), "arm": "none"}]
)
def test_servos_of_this_arm_and_its_cycle_may_be_given(more):
    assert preflight.contents_problem(KR120 | more) == ""


@pytest.mark.parametrize(
    "given, change, said",
    [
        (KR120, ("joint_a1", "joint_a1"), ""),
        (
            KR120,
            ("  joint_a6: {omega: 60.0, zeta: 0.8}\n", ""),
            "found 'joint_a1, joint_a2, joint_a3, joint_a4, joint_a5', "
            "expected those of this arm: joint_a1, joint_a2, joint_a3, joint_a4, joint_a5, joint_a6",
        ),
        (
            TRACK,
            ("joint_a1", "joint_a1"),
            "found 'joint_a1, joint_a2, joint_a3, joint_a4, joint_a5, joint_a6', "
            "expected those of this arm: track, joint_a1",
        ),
        (KR120, ("cycle_ms: 4", "cycle_ms: 12"), "cycle_ms: found 12, expected 4 as the controller has: identify"),
        (KR120 | {"rsi_cycle": "12"}, ("joint_a1", "joint_a1"), "cycle_ms: found 4, expected 12 as the controller has"),
        (KR120, ("omega: 60.0", "omega: .nan"), "joints/joint_a1/omega: found nan"),
        (KR120, ("cycle_ms: 4", "cycle_ms: [4"), "expected "),
    ],
)
def test_servos_that_the_gate_could_not_judge_by_are_refused(tmp_path, given, change, said):
    file = tmp_path / "servos.yaml"
    file.write_text(SERVOS.read_text().replace(*change, 1))
    found = preflight.contents_problem(given | {"servo_model": str(file)})
    assert (found == "") == (said == "") and said in found and "\n" not in found
    assert not found or found.startswith(f"servo_model:={file}: ")


def test_a_file_of_servos_that_is_not_there_is_refused(tmp_path):
    file = tmp_path / "servos.yaml"
    assert preflight.refusal(KR120 | {"servo_model": str(file)}, None, "") == wrong(
        "servo_model", str(file), Sentence("preflight.expected.file")
    )
    assert preflight.refusal(KR120 | {"servo_model": "servos.yaml"}, None, "").startswith("servo_model:=servos.yaml")


def test_a_mesh_of_the_scene_that_cannot_be_used_is_refused(tmp_path):
    scene, mesh = tmp_path / "scene.yaml", tmp_path / "pipe.stl"
    scene.write_text("{padding: 0.0, objects: {pipe: {shape: mesh, size: [1, 1, 1], mesh: pipe.stl}}}")
    mesh.write_text("solid pipe\nendsolid pipe\n")
    said = preflight.contents_problem(KR120 | {"scene": str(scene)})
    assert said.startswith(f"scene:={scene}: object 'pipe' mesh: found '{mesh} with 0 triangles', expected 1 to")


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


def test_a_trace_without_room_on_its_disk_is_refused(tmp_path, monkeypatch):
    """Otherwise all but the gateway would run, and that would be started again and again."""
    given = KR120 | {"gateway": "true", "gateway_trace": f"{tmp_path}/a.trace"}
    monkeypatch.setattr(shutil, "disk_usage", lambda folder: SimpleNamespace(free=64_000_000))
    said = preflight.contents_problem(given)
    assert said.startswith(f"gateway_trace:={tmp_path}/a.trace: ") and "64.0 MB of room" in said and "64.8 MB" in said
    # what the file holds already it may hold again
    (tmp_path / "a.trace").write_bytes(bytes(2_000_000))
    assert preflight.contents_problem(given) == ""


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


def test_a_second_rviz_would_end_the_first(master):
    node = Node(master, "/view")
    assert preflight.running_problem({"robot": "kr120", "gui": "true"}, master).key == "preflight.rviz_runs"
    assert preflight.running_problem({"robot": "kr120", "gui": "false"}, master) == ""
    node.end()


def test_no_master_is_nothing_that_runs():
    assert preflight.running_problem({"robot": "kr120"}, "http://127.0.0.1:1/") == ""


@pytest.mark.parametrize("simulated", [True, False])
def test_a_master_with_simulated_time_is_refused_before_anything_starts(master, monkeypatch, simulated):
    monkeypatch.setattr(preflight, "address_problem", lambda environ: "")
    rosgraph.Master("/gazebo", master).setParam("/use_sim_time", simulated)
    said = preflight.refusal(KR120, None, master)
    assert (said == "") is not simulated
    assert said == "" or said.startswith("/use_sim_time: found True, expected false: ")


def test_every_node_of_a_robot_is_looked_for():
    """Those of bringup.launch in its group, and of the files it includes there."""
    trees = [
        ElementTree.parse(ROOT / "launch" / f"{name}.launch").getroot()
        for name in ("bringup", "twin", "link", "gate", "work")
    ]
    names = {node.get("name") for tree in trees for node in tree.iter("node")} - {"broker", "view", "console"}
    assert set(ROBOT_NODES) == names


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


def test_a_console_without_its_package_or_its_page_is_refused_with_what_to_do(monkeypatch, tmp_path):
    given = KR120 | {"console": "true", "console_page": "none", "console_files": "false"}
    assert preflight.contents_problem(given) == ""
    page = str(tmp_path)
    assert preflight.contents_problem(given | {"console_page": page}).startswith("console:=true: console_page: found ")
    (tmp_path / "index.html").write_text("<!doctype html>")
    assert preflight.contents_problem(given | {"console_page": page}) == ""
    monkeypatch.setattr(preflight.importlib.util, "find_spec", lambda name: None)
    said = preflight.contents_problem(given)
    assert said == (
        "console:=true: the Python package websockets: found 'missing', expected installed; run setup/setup.sh console"
    )
    assert preflight.contents_problem(given | {"console": "false"}) == ""


@pytest.fixture(scope="module")
def console_site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    options = ("--host", "localhost", "--robot", "kr120", "--reviewer", "ada", "--console", "localhost")
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


def test_the_broker_on_trial_leaves_nothing_behind():
    port = free_port()
    given = {
        "broker": "true",
        "broker_port": str(port),
        "broker_config": f"{ROOT}/config/mosquitto.conf",
        "arm": "none",
    }
    assert preflight.port_problem(given) == "" and not listens(port)
    assert preflight.port_problem(given) == ""


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


def resolving(monkeypatch, *, without: str):
    """Resolve names as a machine does whose /etc/hosts lacks IPv4 for a name."""
    ask = socket.getaddrinfo

    def answer(host, *arguments):
        if host == without:
            raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
        return ask(host, *arguments)

    monkeypatch.setattr(socket, "getaddrinfo", answer)


def test_a_localhost_without_ipv4_is_refused(monkeypatch):
    monkeypatch.setenv("ROS_MASTER_URI", "http://localhost:11311")
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    assert preflight.address_problem(os.environ) == ""
    resolving(monkeypatch, without="localhost")
    no_address = "it has no IPv4 address (Name or service not known)"
    assert preflight.address_problem(os.environ) == Sentence("preflight.localhost", why=no_address)
    monkeypatch.setenv("ROS_IPV6", "on")
    assert preflight.address_problem(os.environ) == ""


def only_ipv6(monkeypatch, name: str):
    """Resolve a name as glibc does where /etc/hosts has `::1` for it, and nothing else."""
    ask = socket.getaddrinfo

    def answer(host, port, family=0, *arguments, **named):
        if host == name and family == socket.AF_UNSPEC:
            return ask("::1", port, family, *arguments, **named)
        # whoever asks for IPv4 gets the loopback of IPv4 for the one of IPv6
        return ask("127.0.0.1" if host == name else host, port, family, *arguments, **named)

    monkeypatch.setattr(socket, "getaddrinfo", answer)


def test_a_localhost_that_is_the_loopback_of_ipv6_alone_is_refused(monkeypatch):
    monkeypatch.setenv("ROS_MASTER_URI", "http://localhost:11311")
    monkeypatch.setenv("ROS_IP", "127.0.0.1")
    only_ipv6(monkeypatch, "localhost")
    said = preflight.address_problem(os.environ)
    assert said.key == "preflight.localhost"
    assert said.values["why"].startswith("it has an address of IPv6 alone, at which no program of ROS listens (")


def test_and_so_is_a_name_of_this_machine_that_is(monkeypatch):
    for variable in ("ROS_IP", "ROS_HOSTNAME"):
        monkeypatch.delenv(variable, raising=False)
    own = rosgraph.network.get_host_name()
    only_ipv6(monkeypatch, own)
    said = preflight.address_problem(os.environ)
    assert (said.key, said.values["own"]) == ("preflight.machine", repr(own))
    assert said.values["why"].startswith("it has an address of IPv6 alone")


def test_a_machine_that_does_not_know_its_own_name_is_refused(monkeypatch):
    for variable in ("ROS_IP", "ROS_HOSTNAME"):
        monkeypatch.delenv(variable, raising=False)
    own = rosgraph.network.get_host_name()
    assert preflight.address_problem(os.environ) == ""
    resolving(monkeypatch, without=own)
    said = preflight.address_problem(os.environ)
    assert said.key == "preflight.machine" and said.values["why"].startswith("it has no IPv4 address (")


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


def test_preflight_by_hand(capsys, tmp_path):
    assert preflight.check([f"{name}:={value}" for name, value in KR120.items() if name != "robot"]) == 0
    few = ("robot", "robot_xacro", "robot_config", "ethernet_xml")
    assert preflight.check([f"{name}:={KR120[name]}" for name in few]) == 0
    assert capsys.readouterr().out == "ok\nok\n"
    assert preflight.check([f"robot_config:={tmp_path}"]) == 1
    assert preflight.check(["robot_config:=test_startup.py"]) == 1
    assert capsys.readouterr().err.count("preflight: robot_config:=") == 2


def test_for_roslaunch_the_result_is_on_standard_output(capsys):
    assert preflight.check(["--for-roslaunch", "arm:=foo"]) == 0
    said = capsys.readouterr()
    assert said.out == "refused\n" and said.err == "preflight: arm:=foo: expected mock, real or none\n"
    assert preflight.check(["--for-roslaunch", "arm:=mock"]) == 0
    assert capsys.readouterr().out == "true\n"


def test_the_sentence_stands_below_the_last_line_of_the_process_that_is_waited_for():
    """As with roslaunch: it starts the one that refuses, reads its output, and then prints lines of its own."""
    child = (
        "import os; from construction_twin.ros.shared.roslaunch_parent import print_after; "
        "print_after('the sentence', os.getppid()); print('refused')"
    )
    parent = (
        f"import subprocess, sys; run = subprocess.run([sys.executable, '-c', {child!r}], stdout=subprocess.PIPE); "
        "print(run.stdout.decode(), 'and much more', file=sys.stderr)"
    )
    run = subprocess.run([sys.executable, "-c", parent], capture_output=True, text=True, timeout=60, env=os.environ)
    lines = run.stderr.splitlines()
    assert lines == ["refused", " and much more", "the sentence"]


def test_what_waits_to_say_a_sentence_holds_no_socket_of_the_process_that_ended(tmp_path):
    """A node's peers would connect to it, and wait for an answer."""
    code = (
        "import socket, sys; from construction_twin.ros.shared.roslaunch_parent import print_after; "
        "server = socket.create_server(('127.0.0.1', 0)); print(server.getsockname()[1]); "
        "print_after('the sentence', int(sys.argv[1]))"
    )
    said = tmp_path / "said"
    awaited = subprocess.Popen(["cat"], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL)
    try:
        with said.open("w") as file:
            command = [sys.executable, "-c", code, str(awaited.pid)]
            run = subprocess.run(command, stdout=subprocess.PIPE, stderr=file, text=True, timeout=60, check=True)
        wait_until(lambda: not listens(int(run.stdout)), what="the port to be closed")
        assert said.read_text() == ""
    finally:
        awaited.communicate()
    wait_until(lambda: said.read_text() == "the sentence\n", what="the sentence")


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


def test_every_file_that_the_launch_files_load_for_a_node_is_checked():
    trees = [
        ElementTree.parse(ROOT / "launch" / f"{name}.launch").getroot()
        for name in ("bringup", "twin", "link", "gate", "work")
    ]
    loaded = {Path(tag.get("file", "")).stem for tree in trees for tag in tree.iter("rosparam") if tag.get("file")}
    # the cell is an argument, and checked as one; the publisher is Debian's
    expected = {name for name in loaded if "$(" not in name} - {"joint_state_publisher"}
    assert {file.name for file in NODE_FILES} == expected


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
        ("mqtt_planner", {"view_rate": 0}, "view_rate: found 0, expected a number at least 1 and at most 50"),
        ("mock_rsi", {"start_pose_deg": [0.0]}, "start_pose_deg: found [0.0], expected 6 numbers"),
        (
            "mock_rsi", {"start_pose_deg": [0.0, -90.0, 999.0, 0.0, 0.0, 0.0]},
            "A3 is 999 deg, outside its range -120 deg to 155 deg",
        ),
        ("mqtt_planner", {"view_rate": 0.5}, "view_rate: found 0.5, expected a number at least 1 and at most 50"),
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


@pytest.mark.parametrize("name", [file.name for file in NODE_FILES])
def test_a_file_that_is_no_mapping_is_refused_only_where_it_is_loaded(config_folder, kr120, name):
    file = config_folder / f"{name}.yaml"
    file.write_text("[1, 2")
    assert node_files_problem(PAIR, kr120, config_folder).startswith(f"{file}: found ")
    file.write_text("- 1")
    assert (
        node_files_problem(PAIR, kr120, config_folder)
        == f"{file}: found [1], expected a mapping: the settings of {name}"
    )
    bare = {"robot": "kr120", "arm": "none"}
    # what bringup starts without an arm, too
    always = (
        "planner",
        "follow_joint_trajectory",
        "joint_velocities",
        "executor",
        "rehearsal",
        "speed_limits",
        "pca_monitor",
    )
    assert bool(node_files_problem(bare, kr120, config_folder)) is (name in always)


def test_the_start_is_refused_for_them_too(monkeypatch, config_folder):
    changed(config_folder, "executor", speed_limit_silent=2.0)
    monkeypatch.setattr(
        preflight, "node_files_problem", lambda given, robot, _: node_files_problem(given, robot, config_folder)
    )
    assert "speed_limit_silent: found 2.0" in preflight.contents_problem(KR120)

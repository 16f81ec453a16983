"""Every launch file is one that roslaunch accepts, and `--ros-args` explains every argument of it.

Most is read in this process (`launch_files`), and what a start would be refused for is asked of `preflight`'s functions. roslaunch
itself is started where its own part is tested: one start that is accepted, refusals, and what it prints around them.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml
from launch_files import Reader, asked, node_arguments, node_names, parameters, poses_in_tf, read_launch, refusal
from roslaunch import arg_dump, rlutil

from construction_twin.core import extras
from construction_twin.ros.commands.node_files import node_shells
from construction_twin.ros.shared.frame_listener import FRAMES, PUBLISHERS, SHOWN
from construction_twin.views.preflight import notes

ROOT = Path(__file__).resolve().parents[3]
ARCHITECTURE = (ROOT / "docs/architecture.md").read_text()
LAUNCHES = sorted((ROOT / "launch").glob("*.launch"))


def name_of(path: Path) -> str:
    return path.stem


def is_whole(path: Path) -> bool:
    """Return whether a launch file can be started as it is: every argument has a default."""
    arguments = ElementTree.parse(path).getroot().findall("arg")
    return all({"default", "value"} & set(arg.attrib) for arg in arguments)


#: What a launch file needs that is not on every machine, and words with which it is not asked for.
ELSEWHERE = {"gazebo": ("gzserver:=true",)}
WHOLE = [path for path in LAUNCHES if is_whole(path)]


def test_roslaunch_accepts_a_start_with_what_its_commands_print():
    assert rlutil.check_roslaunch(str(ROOT / "launch/bringup.launch")) is None


@pytest.mark.parametrize("path", WHOLE, ids=name_of)
def test_roslaunch_accepts_it(path, monkeypatch):
    monkeypatch.setattr(rlutil.roslaunch.xmlloader, "XmlLoader", Reader)
    assert rlutil.check_roslaunch(str(path)) is None


@pytest.mark.parametrize("path", WHOLE, ids=name_of)
def test_preflight_has_nothing_against_it_as_it_is(path):
    assert refusal(path.stem, *ELSEWHERE.get(path.stem, ())) == ""


def test_every_part_belongs_to_a_whole():
    """A part gets its arguments from the file that includes it, and is checked with it."""
    includes = "".join(path.read_text() for path in WHOLE)
    parts = sorted(set(LAUNCHES) - set(WHOLE))
    assert {"bringup", "experiment"} <= set(map(name_of, WHOLE))
    assert [part.name for part in parts if f"launch/{part.name}" not in includes] == []


@pytest.mark.parametrize("path", LAUNCHES, ids=name_of)
def test_ros_args_explains_every_argument(path, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    arg_dump.dump_args([str(path)])
    said = capsys.readouterr().out
    undocumented = said.count("undocumented")
    given = [arg.get("name") for arg in ElementTree.parse(path).getroot().findall("arg") if "value" not in arg.attrib]
    assert given and all(name in said for name in given)
    assert undocumented == 0


@pytest.mark.parametrize("file", ["bringup", "experiment"])
@pytest.mark.parametrize("given", ["", "192.168.1.20"])
def test_the_controller_s_address_reaches_the_gateway(file, given):
    arguments = node_arguments("/kr120/rsi_gateway", file, f"rsi_controller:={given}")
    assert re.search(rf" --controller ['\"]?{given}['\"]? --broker ", arguments)


def test_the_make_of_the_controller_reaches_gateway_bridge_and_mock():
    names = ("gateway/make", "mock_rsi/make", "gateway/ethernet_xml", "mock_rsi/ethernet_xml")
    known = parameters("bringup")
    assert [str(known[f"/kr120/{name}"])[:5] for name in names] == ["rsi", "rsi", "<ROOT", "<ROOT"]
    known = parameters("experiment", "controller_make:=frames")
    assert [known.get(f"/kr120/{name}") for name in names] == ["frames", "frames", None, None]


def test_all_but_the_named_nodes_are_started_again():
    """An unexpected exception ends a node: what leads to motion must come back by itself."""
    nodes = [
        node
        for path in LAUNCHES
        for node in ElementTree.parse(path).getroot().iter("node")
        if node.get("pkg") == "construction_twin"
    ]
    delays = {node.get("respawn_delay") for node in nodes if node.get("respawn") == "true"}
    assert delays == {"1"}
    sentence = re.search(r"starts each\s+node with `respawn` again\s+\(all but (.*?)\)", ARCHITECTURE, re.DOTALL)[1]
    assert {node.get("name") for node in nodes if node.get("respawn") != "true"} == set(
        re.findall(r"`(\w+)`", sentence)
    )


def test_no_node_makes_threads_for_matrices():
    config = read_launch("bringup", "tool_marker:=true", "separation:=true", "console:=true")
    assert {("OPENBLAS_NUM_THREADS", "1") in node.env_args for node in config.nodes} == {True}


@pytest.mark.parametrize("given, path, reply", [((), "40", "50"), (("realtime:=0",), "0", "0")])
def test_gateway_and_mock_come_before_everything_else_on_the_path(given, path, reply):
    """What answers the controller waits for no other node."""
    known = parameters("bringup", *given)
    nodes = ("virtual_robot", "executor", "pca_monitor", "mqtt_bridge", "mock_rsi")
    found = [str(known[f"/kr120/{node}/realtime_priority"]) for node in nodes]
    assert found == [path, path, path, path, reply]
    assert f" --realtime {reply} " in node_arguments("/kr120/rsi_gateway", "bringup", *given)


@pytest.mark.parametrize(
    "arguments, nodes",
    [
        ("", {"rsi_gateway", "mock_rsi"}),
        ("gateway_kind:=plc", {"plc"}),
        ("gateway_kind:=plc arm:=real anonymous_broker_is_meant:=true", set()),
    ],
)
def test_what_takes_the_commands_is_started_and_nothing_else_of_it(arguments, nodes):
    words = arguments.split()
    started = {name.rsplit("/", 1)[-1] for name in node_names("bringup", *words)}
    assert "mqtt_bridge" in started and started & {"rsi_gateway", "mock_rsi", "plc"} == nodes
    assert refusal("bringup", *words) == ""
    told = " ".join(notes(asked("bringup", *words)))
    assert ("gateway_kind:=plc with arm:=real: a bare PLC is commanded by joint strings alone" in told) == (
        "real" in arguments
    )


#: Those that compare the simulated pose, or only wait for it.
SIMULATED = {"pca_monitor", "startup"}


@pytest.mark.parametrize("twin", ["mujoco", "gazebo"])
def test_who_decides_what_is_commanded_never_reads_a_simulated_pose(twin):
    words = (f"twin:={twin}", "tool_marker:=true", "work_model:=/house.ifc", "work_cell:=/cell.yaml")
    readers = {
        shell.name
        for shell in node_shells()
        if "twin/joint_states" in {each.topic for each in (*shell.interface.reads, *shell.interface.hears)}
    }
    assert {"executor", "planner", "work", "mqtt_planner", "scene"} <= readers
    remapped = {
        node.name: ["twin/joint_states", "twin/commanded"] in node.remap_args
        for node in read_launch("bringup", *words).nodes
    }
    assert {name for name in readers if not remapped[name]} == SIMULATED
    # and the twin itself publishes both
    assert not remapped["virtual_robot"]


@pytest.mark.parametrize("twin", ["mujoco", "gazebo"])
def test_frames_that_goals_are_looked_up_in_are_no_simulated_pose_s(twin):
    """tf and joint_states are ways to a goal, too."""
    readers = {shell.name for shell in node_shells() if set(FRAMES) & set(shell.interface.listeners)}
    assert readers == {"planner", "scene", "work"}
    found = poses_in_tf(f"twin:={twin}")
    assert found == {
        ("robot_state_publisher", "twin"): "twin/commanded",
        ("simulated_state_publisher", "simulated"): "twin/effort",
        ("physical_state_publisher", "physical"): "physical/joint_states",
        ("preview_state_publisher", "preview"): "preview/joint_states",
    }
    # what is believed of tf is all but what is only shown
    believed = {(nodes[0], tree) for tree, nodes in PUBLISHERS.items()}
    assert believed == {key for key in found if key[1] not in SHOWN}


def test_the_kinematic_twin_s_frames_are_its_one_pose_and_there_is_no_simulated_tree():
    found = poses_in_tf()
    assert found["robot_state_publisher", "twin"] == "twin/joint_states"
    assert not {tree for _, tree in found} & set(SHOWN)


def test_where_the_servos_should_have_the_arm_is_shown_and_not_believed():
    model = "servo_model:=/servos.yaml"
    assert poses_in_tf(model)["expected_state_publisher", "expected"] == "expected/joint_states"
    assert "expected" in SHOWN and "expected" not in PUBLISHERS
    assert "/kr120/expected_state_publisher" not in node_names("bringup", model, "arm:=none")
    assert parameters("bringup", model)["/kr120/mqtt_planner/servo_model"] == "/servos.yaml"


@pytest.mark.parametrize(
    "words, more",
    [
        ((), []),
        (("twin:=mujoco",), ["simulated"]),
        (("servo_model:=/servos.yaml",), ["expected"]),
        (("twin:=gazebo", "servo_model:=/servos.yaml"), ["simulated", "expected"]),
        (("servo_model:=/servos.yaml", "arm:=none"), []),
    ],
)
def test_each_tree_stands_in_the_world(words, more):
    static, node = parameters("bringup", *words), "/kr120/static_frames"
    assert static[f"{node}/prefixes"] == ["kr120/twin", "kr120/physical", "kr120/preview"]
    assert static[f"{node}/chain_only"] == ["kr120/physical", "kr120/preview"]
    found = {name.rpartition("/")[2]: value for name, value in static.items() if name.startswith(f"{node}/more/")}
    assert found == {tree: f"kr120/{tree}" for tree in more}


def test_gazebo_is_started_for_a_twin_in_it_alone_with_its_words_and_the_arm_s_drives():
    words = ("twin:=gazebo", "gzserver:=/chroot.sh run gzserver", "realtime:=20")
    assert "/kr120/gazebo" in node_names("bringup", *words)
    assert "/kr120/gazebo" not in node_names("bringup", "twin:=mujoco")
    assert "/kr120/gazebo" in node_names("gazebo") and "/kr120/gazebo" in node_names("experiment", *words)
    known = parameters("bringup", *words)
    found = {name: known[f"/kr120/gazebo/{name}"] for name in ("gzserver", "drives", "realtime")}
    assert found["gzserver"] == "/chroot.sh run gzserver" and found["realtime"] == 20
    assert str(found["drives"]).endswith("config/kr120_drives.yaml")
    assert parameters("gazebo")["/kr120/virtual_robot/twin"] == "gazebo"
    assert refusal("bringup", "twin:=gazebo", "gzserver:=true -v") == ""
    assert "payload" in refusal("bringup", "twin:=gazebo", "gzserver:=true -v", "payload:=60")


def test_a_kinematic_twin_has_one_pose_and_nobody_reads_another():
    assert not any("twin/commanded" in str(node.remap_args) for node in read_launch("bringup").nodes)


@pytest.mark.parametrize(
    "words, drives",
    [
        ((), "config/kr120_drives.yaml"),
        (("track:=true",), "config/kr120_track_drives.yaml"),
        (("track:=true", "robot_xacro:=/an/arm.xacro"), ""),
        (("robot:=another",), "config/kr120_drives.yaml"),
        (("robot_xacro:=/an/arm.xacro",), ""),
    ],
)
def test_only_the_kr_120_has_drives_by_default(words, drives):
    known = parameters("bringup", "twin:=mujoco", *words)
    (value,) = (value for name, value in known.items() if name.endswith("/virtual_robot/drives"))
    assert str(value).endswith(drives) and bool(value) == bool(drives)


def test_a_twin_with_mass_is_refused_where_its_packages_are_missing(monkeypatch):
    assert refusal("bringup", "twin:=mujoco") == ""
    monkeypatch.setitem(extras.PACKAGES, "physics", ("no_such_engine",))
    missing = refusal("bringup", "twin:=mujoco")
    assert missing.startswith("twin:=mujoco: no_such_engine: ") and "setup/setup.sh physics" in missing
    assert refusal("bringup") == ""


REFUSED = {
    "twin:=bullet": "twin:=bullet: expected kinematic, mujoco or gazebo",
    "twin:=gazebo gzserver:=/no/gzserver": "twin:=gazebo: gzserver: found '/no/gzserver', expected a program that starts Gazebo",
    "drives:=/none.yaml": "drives:=/none.yaml: expected ",
    "arm:=foo": "arm:=foo: expected mock, real or none",
    "controller_make:=fanuc": "controller_make:=fanuc: expected rsi",
    "rsi_cycle:=8": "rsi_cycle:=8: expected 4 or 12",
    "ethernet_xml:=none": "ethernet_xml:=none: path: found 'none', expected that of the controller's Ethernet XML",
    "robot_config:=/no/such.yaml": "robot_config:=/no/such.yaml: expected the absolute path",
    "scene:=/no/such.yaml": "scene:=/no/such.yaml: expected the absolute path",
    "arm:=real": "bridge_account:='' with arm:=real: ",
    "arm:=real auto_approve:=true": "auto_approve:=true with arm:=real: ",
    "scene:=": "scene:='': roslaunch drops an empty value",
    "brocker:=false": "brocker:=false: bringup.launch has no such argument; did you mean broker:=false?",
}


@pytest.mark.parametrize("arguments, sentence", REFUSED.items())
def test_an_argument_that_cannot_work_is_refused(arguments, sentence):
    assert refusal("bringup", *arguments.split()).startswith(sentence)


@pytest.mark.parametrize("argument", ["arm:=foo", "scene:=", "brocker:=false"])
def test_an_argument_that_cannot_work_ends_the_launch_before_it_begins(argument):
    """A value, one that roslaunch does not pass on, and a name that no launch file reads."""
    run = subprocess.run(
        ["roslaunch", "--nodes", "construction_twin", "bringup.launch", argument],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.returncode != 0 or "Invalid" in run.stderr
    assert f"preflight: {REFUSED[argument]}" in run.stderr and "Traceback" not in run.stderr


def test_a_misspelt_argument_of_the_view_is_refused_too():
    """It would show the default robot."""
    command = ["roslaunch", "--nodes", "construction_twin", "view.launch", "robott:=kr120_2"]
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    sentence = "preflight: robott:=kr120_2: view.launch has no such argument; did you mean robot:=kr120_2? "
    assert sentence in run.stderr and "/view" not in run.stdout and "Traceback" not in run.stderr, run.stderr


def test_the_right_argument_of_the_view_starts_it():
    assert refusal("view", "robot:=kr120_2") == ""
    assert any(name.endswith("/view") for name in node_names("view", "robot:=kr120_2"))


def test_the_arm_alone_is_a_scene_that_roslaunch_passes_on():
    assert refusal("bringup", "scene:=none") == ""
    assert parameters("bringup", "scene:=none")["/kr120/scene/scene"] == "none"


@pytest.mark.parametrize("file", ["bringup", "two_robots", "experiment", "scenario"])
def test_a_file_that_is_not_there_is_refused_by_every_launch_file_that_takes_it(file):
    said = refusal(file, "self_collision:=/no/such.yaml")
    assert said.startswith("self_collision:=/no/such.yaml: expected the absolute path of a file")


@pytest.mark.parametrize("file", ["bringup", "two_robots"])
def test_the_sentence_of_a_refusal_is_the_last_line_below_a_few_of_roslaunch(file):
    run = subprocess.run(
        ["roslaunch", "construction_twin", f"{file}.launch", "self_collision:=/no/such.yaml"],
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "ROS_MASTER_URI": "http://127.0.0.1:1"},
    )
    assert run.returncode == 1
    first, *between, last = run.stderr.splitlines()
    assert first == last and last.startswith(
        "preflight: self_collision:=/no/such.yaml: expected the absolute path of a file"
    )
    # how long the name of the checkout's folder is, is no merit of ours
    package = subprocess.run(["rospack", "find", "construction_twin"], capture_output=True, text=True).stdout.strip()
    assert len("".join(between).replace(package, "")) < 300, between


def test_files_in_a_folder_with_a_space_are_found(tmp_path):
    """URDF, robot YAML, scene, Ethernet XML, records: all but the package itself, which catkin cannot build there."""
    folder = tmp_path / "my arm"
    shutil.copytree(ROOT / "urdf", folder)  # the xacro reads files beside it
    given = {
        "robot_xacro": "urdf/kr120r2500.urdf.xacro",
        "robot_config": "config/kr120.yaml",
        "self_collision": "config/kr120_self_collision.yaml",
        "scene": "config/scene.yaml",
        "ethernet_xml": "krl/ethernet/ctwin_ethernet.xml",
        "task": "config/experiment.yaml",
        "broker_config": "config/mosquitto.conf",
    }
    words = []
    for name, file in given.items():
        copy = folder / Path(file).name
        copy.write_text((ROOT / file).read_text())
        words.append(f"{name}:={copy}")
    words.append(f"results_dir:={folder}/results_dir")
    run = subprocess.run(
        ["roslaunch", "--dump-params", "construction_twin", "experiment.launch", *words],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.stdout, run.stderr
    parameters = yaml.safe_load(run.stdout)
    assert parameters["/preflight"] is True
    assert parameters["/kr120/experiment/results_dir"] == f"{folder}/results_dir"
    assert "<robot" in parameters["/kr120/robot_description"]
    assert f"{folder}/mosquitto.conf" in node_arguments("/broker", "experiment", *words)


def test_the_monitor_ends_before_what_it_watches():
    """roslaunch ends nodes in the reverse order of their start: what ends must not be reported as a fault. The broker is last."""
    nodes = node_names("bringup")
    watched = ["mock_rsi", "mqtt_bridge", "rsi_gateway", "virtual_robot", "executor", "pca_monitor", "startup"]
    assert sorted(nodes, key=nodes.index)[0] == "/broker"
    places = {name: nodes.index(f"/kr120/{name}") for name in watched}
    assert places["pca_monitor"] > max(places[name] for name in watched[:-2])
    assert places["executor"] > max(places[name] for name in watched[:-3])
    assert places["startup"] > places["pca_monitor"]


def test_two_robots_take_every_argument_of_their_one_console():
    """What a launch file only passes on stands in none of its lists."""
    names = {
        file: {
            each.get("name") for each in ElementTree.parse(ROOT / "launch" / f"{file}.launch").getroot().findall("arg")
        }
        for file in ("bringup", "two_robots")
    }
    own = {name for name in names["bringup"] if name.startswith("console")} - {"console_files", "console_words"}
    assert len(own) == 5 and own | {"prefix", "broker_host", "broker_port"} <= names["two_robots"]

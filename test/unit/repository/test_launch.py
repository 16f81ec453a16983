"""Every launch file is one that roslaunch accepts, and `--ros-args` explains every argument of it.

Most is read in this process (`launch_files`); what a start is refused for is tested in `test_preflight`, and live in test_refusals.
"""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from xml.etree import ElementTree

import pytest
from launch_files import Reader, parameters, read_launch, twin_in_tf
from roslaunch import rlutil

from construction_twin.core.extensions import node_modules
from construction_twin.ros.shared.frames import FRAMES
from construction_twin.ros.shared.node_shell import NodeShell

ROOT = Path(__file__).resolve().parents[3]
ARCHITECTURE = (ROOT / "docs/architecture.md").read_text()
LAUNCHES = sorted((ROOT / "launch").glob("*.launch"))


def node_shells() -> list[NodeShell]:
    """Return the shell of every node of a robot, by name."""
    modules = map(import_module, node_modules().values())
    return [module.NODE for module in modules if hasattr(module, "NODE")]


def name_of(path: Path) -> str:
    return path.stem


def is_whole(path: Path) -> bool:
    """Return whether a launch file can be started as it is: every argument has a default."""
    arguments = ElementTree.parse(path).getroot().findall("arg")
    return all({"default", "value"} & set(arg.attrib) for arg in arguments)


def node_names(file: str, *words: str) -> list[str]:
    """Return the nodes in the order in which they are started."""
    return [f"{node.namespace}{node.name}" for node in read_launch(file, *words).nodes]


def node_arguments(name: str, file: str, *words: str) -> str:
    """Return the command line of a node."""
    nodes = {f"{node.namespace}{node.name}": node for node in read_launch(file, *words).nodes}
    return f" {nodes[name].args} "


WHOLE = [path for path in LAUNCHES if is_whole(path)]


def test_roslaunch_accepts_a_start_with_what_its_commands_print():
    assert rlutil.check_roslaunch(str(ROOT / "launch/bringup.launch")) is None


@pytest.mark.parametrize("path", WHOLE, ids=name_of)
def test_roslaunch_accepts_it(path, monkeypatch):
    monkeypatch.setattr(rlutil.roslaunch.xmlloader, "XmlLoader", Reader)
    assert rlutil.check_roslaunch(str(path)) is None


@pytest.mark.parametrize("file", ["bringup", "experiment"])
@pytest.mark.parametrize("given", ["", "192.168.1.20"])
def test_the_controller_s_address_reaches_the_gateway(file, given):
    arguments = node_arguments("/kr120/rsi_gateway", file, f"rsi_controller:={given}")
    assert re.search(rf" --controller ['\"]?{given}['\"]? --broker ", arguments)


def test_the_controller_s_file_reaches_gateway_bridge_and_mock():
    names = ("gateway/ethernet_xml", "mock_rsi/ethernet_xml")
    for given, expected in (("/some.xml", "/some.xml"), ("none", None)):
        known = parameters("bringup", f"ethernet_xml:={given}")
        assert [known.get(f"/kr120/{name}") for name in names] == [expected, expected]


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
    config = read_launch("bringup", "gui:=marker", "separation:=true", "console:=true")
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


#: Those that compare the simulated pose, or only wait for it.
SIMULATED = {"pca_monitor", "startup"}


@pytest.mark.parametrize("twin", ["mujoco", "gazebo"])
def test_who_decides_what_is_commanded_never_reads_a_simulated_pose(twin):
    words = (f"twin:={twin}", "gui:=marker", "work_model:=/house.ifc", "work_cell:=/cell.yaml")
    readers = {
        shell.name
        for shell in node_shells()
        if "twin/joint_states" in {each.topic for each in (*shell.interface.polls, *shell.interface.subscribes)}
    }
    assert {"executor", "planner", "work", "console_node", "scene"} <= readers
    remapped = {
        node.name: ["twin/joint_states", "twin/commanded"] in node.remap_args
        for node in read_launch("bringup", *words).nodes
    }
    assert {name for name in readers if not remapped[name]} == SIMULATED
    # and the twin itself publishes both
    assert not remapped["virtual_robot"]


@pytest.mark.parametrize(
    "twin, stream", [("kinematic", "twin/joint_states"), ("mujoco", "twin/commanded"), ("gazebo", "twin/commanded")]
)
def test_frames_that_goals_are_looked_up_in_are_no_simulated_pose_s(twin, stream):
    """tf and joint_states are ways to a goal, too."""
    readers = {shell.name for shell in node_shells() if set(FRAMES) & set(shell.interface.listeners)}
    assert readers == {"planner", "scene", "work"}
    assert twin_in_tf(f"twin:={twin}") == stream
    # the others are of what this node is given: test_display_node
    given = parameters("bringup", f"twin:={twin}", "servo_model:=/servos.yaml", "arm:=none")
    expected = {"twin": twin, "servo_model": "/servos.yaml", "arm": "none"}
    assert {name: given[f"/kr120/display/{name}"] for name in expected} == expected


def test_the_monitor_ends_before_what_it_watches():
    """roslaunch ends nodes in the reverse order of their start: what ends must not be reported as a fault. The broker is last."""
    nodes = node_names("bringup")
    watched = ["mock_rsi", "mqtt_bridge", "rsi_gateway", "virtual_robot", "executor", "pca_monitor", "startup"]
    assert sorted(nodes, key=nodes.index)[0] == "/broker"
    places = {name: nodes.index(f"/kr120/{name}") for name in watched}
    assert places["pca_monitor"] > max(places[name] for name in watched[:-2])
    assert places["executor"] > max(places[name] for name in watched[:-3])
    assert places["startup"] > places["pca_monitor"]

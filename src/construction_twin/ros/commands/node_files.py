"""The nodes of a robot, and their own YAML files in config/, checked as the nodes will read them, before any of them starts."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pydantic
import rospkg
import yaml

from construction_twin.controller.makes import DEFAULT
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.sentences import Sentence
from construction_twin.robot.description import RobotModel
from construction_twin.robot.urdf import read_text
from construction_twin.ros.nodes import (
    executor,
    follow_joint_trajectory,
    joint_velocities,
    mock_rsi,
    mqtt_bridge,
    mqtt_planner,
    mqtt_review,
    neighbour,
    pca_monitor,
    planner,
    tool_marker,
    work,
)
from construction_twin.ros.shared.gateway_config import gateway_config
from construction_twin.ros.shared.node_shell import NodeShell
from construction_twin.ros.shared.params import settings_of
from construction_twin.views.preflight import NONE, is_bare, is_true

Given = Mapping[str, str]
Values = dict[str, Any]

#: Nodes of one robot, in its namespace: a second one of a name would end the first.
ROBOT_NODES = (
    "executor", "pca_monitor", "virtual_robot", "mqtt_bridge", "mqtt_review", "mqtt_planner", "mock_rsi", "planner", "scene",
    "neighbour", "follow_joint_trajectory", "startup", "preview", "sync_view", "static_frames", "tool_marker", "separation", "work",
    "joint_velocities", "joint_state_publisher",
    "robot_state_publisher", "physical_state_publisher", "preview_state_publisher", "rsi_gateway",
    "plc",
)  # fmt: skip
#: What the launch files give beside the files, where any value will do.
_BROKER = {"host": "127.0.0.1", "port": 18830}
_MARKER = {"self_collision": "", "tf_prefix": "", "reviewer": "operator"}
_PLANNER = {"self_collision": "", "tf_prefix": ""}
_WORK = {"model": "", "cell": "", "self_collision": "", "tf_prefix": "", "review_file": "", "arm": "mock"}


def _arm(given: Given) -> str:
    return given.get("arm", "mock")


def _decimals(given: Given) -> int:
    return int(given.get("decimals", "3"))


def tool_settings(given: Given) -> Values:
    """Return what launch/link.launch loads of a tool file; nothing without one."""
    return {"tool": read_mapping(given["tool"], "a tool")} if given.get("tool") else {}


def controller_settings(given: Given) -> Values:
    """Return what launch/link.launch tells gateway and mock of the controller: make, cycle, and the text of its file."""
    path = given.get("ethernet_xml", NONE)
    text = {} if path == NONE else {"ethernet_xml": read_text(path)}
    return {"make": given.get("controller_make", DEFAULT), "cycle": int(given.get("rsi_cycle", "4"))} | text


def _gateway(values: Values, given: Given, robot: RobotModel) -> None:
    # not a node's own: gateway and bridge read these from the robot's namespace; its file is looked at with that argument
    launched = controller_settings(given)
    launched.pop("ethernet_xml", None)
    gateway_config(robot, values | {"decimals": _decimals(given)} | launched)


def _mock(given: Given) -> Values:
    return {"gateway_host": "127.0.0.1"} | controller_settings(given) | tool_settings(given)


def _monitor(given: Given) -> Values:
    return {"arm": _arm(given), "transition_file": "transitions", "decimals": _decimals(given)}


def _separation(values: Values, _given: Given, robot: RobotModel) -> None:
    folder = str(Path(rospkg.RosPack().get_path("construction_twin"), "examples", "separation"))
    if folder not in sys.path:
        sys.path.append(folder)
    import separation_node

    separation_node.NODE.check_values(values, robot)


def _joint_state_publisher(values: Values, _given: Given, _robot: RobotModel) -> None:
    settings_of(_JointStatePublisher, values)


class _JointStatePublisher(pydantic.BaseModel, extra="forbid"):
    """The parameters that Debian's joint_state_publisher reads; one that it does not know it would ignore."""

    source_list: list[str] = []
    rate: float = 10.0
    delta: float = 0.0
    zeros: dict[str, float] = {}
    dependent_joints: dict[str, Any] = {}
    use_mimic_tags: bool = True
    use_smallest_joint_limits: bool = True
    publish_default_positions: bool = True
    publish_default_velocities: bool = False
    publish_default_efforts: bool = False


def _always(_given: Given) -> bool:
    return True


def _has_link(given: Given) -> bool:
    return _arm(given) != "none"


@dataclass(frozen=True)
class NodeFile:
    """A YAML file of config/.

    Attributes:
        name: Without .yaml.
        check: Takes its content, the launch arguments and the robot; raises a ConstructionTwinError.
        loaded: Returns whether bringup.launch loads it, with these arguments.
    """

    name: str
    check: Callable[[Values, Given, RobotModel], None]
    loaded: Callable[[Given], bool] = _always


def _of(
    node: NodeShell, launched: Callable[[Given], Values] = lambda _given: {}, loaded: Callable[[Given], bool] = _always
) -> NodeFile:
    """Return the file of a node, which checks its parameters itself.

    Args:
        launched: Returns what the launch files give beside the file; where any value will do, one that does.
    """
    return NodeFile(node.name, lambda values, given, robot: node.check_values(values | launched(given), robot), loaded)


#: Every file that bringup.launch loads for a node, in the order of the launch files.
NODE_FILES = (
    _of(neighbour.NODE, lambda _given: {"name": "other"}, lambda given: bool(given.get("neighbour"))),
    _of(planner.NODE, lambda _given: _PLANNER),
    _of(
        follow_joint_trajectory.NODE,
        lambda _given: {"arm": "mock"},
        lambda given: is_true(given, "follow_joint_trajectory", "true"),
    ),
    _of(joint_velocities.NODE),
    NodeFile("joint_state_publisher", _joint_state_publisher),
    NodeFile("gateway", _gateway, _has_link),
    _of(mqtt_bridge.NODE, lambda _given: _BROKER, _has_link),
    _of(mqtt_review.NODE, lambda _given: _BROKER, _has_link),
    _of(mqtt_planner.NODE, lambda _given: _BROKER, _has_link),
    _of(mock_rsi.NODE, _mock, lambda given: _arm(given) == "mock" and not is_bare(given)),
    _of(executor.NODE, lambda given: {"arm": _arm(given), "review_file": "reviews"}),
    _of(pca_monitor.NODE, _monitor),
    _of(tool_marker.NODE, lambda _given: _MARKER, lambda given: is_true(given, "tool_marker")),
    _of(work.NODE, lambda _given: _WORK, lambda given: bool(given.get("work_model"))),
    NodeFile("separation", _separation, lambda given: is_true(given, "separation")),
)


def read_mapping(path: str, what: str) -> Values:
    """Return the content of a YAML file; ConfigurationError when it is not a mapping of `what`."""
    try:
        content = yaml.safe_load(read_text(path))
    except yaml.YAMLError as error:
        raise ConfigurationError(path, " ".join(str(error).split()), "a YAML file") from error
    if not isinstance(content, dict):
        raise ConfigurationError(path, content, f"a mapping: {what}")
    return content


def node_files_problem(given: Given, robot: RobotModel, folder: Path) -> str:
    """Return a sentence about the first file of a node that would not start with it; empty when there is none.

    Args:
        given: Launch arguments.
        folder: The package's config/.
    """
    changes = read_mapping(given["scenario"], "a scenario") if given.get("scenario") else {}
    nodes = [file.name for file in NODE_FILES]
    strange = next((name for name in changes if name not in ("scenario", *nodes)), None)
    if strange is not None:
        near = difflib.get_close_matches(str(strange), nodes, n=1)
        values = {"path": given["scenario"], "name": str(strange)}
        return (
            Sentence("preflight.scenario_near", near=near[0], **values)
            if near
            else Sentence("preflight.scenario", **values)
        )
    for file in NODE_FILES:
        if not file.loaded(given):
            continue
        where = path = str(folder / f"{file.name}.yaml")
        try:
            values = read_mapping(path, f"the settings of {file.name}")
            file.check(values, given, robot)
            changed = changes.get(file.name)
            if isinstance(changed, dict):
                where = f"scenario:={given['scenario']}: {file.name}"
                file.check(values | changed, given, robot)
        except ConstructionTwinError as error:
            return f"{where}: {str(error).removeprefix(path).lstrip(':/ ')}"
    return ""

"""The nodes' own YAML files in config/, checked as the nodes will read them, before any of them starts."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import pydantic
import rospkg
import yaml

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.limits import MotionLimits
from construction_twin.core.validation import configuration_error
from construction_twin.mock.program import MockSettings, build_controller
from construction_twin.monitor.gate import Gate
from construction_twin.mqtt.joint_string import JointStringCodec
from construction_twin.robot.description import RobotModel
from construction_twin.robot.urdf import read_text
from construction_twin.ros.nodes import (
    executor,
    follow_joint_trajectory,
    joint_velocities,
    mqtt_bridge,
    mqtt_planner,
    mqtt_review,
    pca_monitor,
    planner,
    tool_marker,
    work,
)
from construction_twin.ros.shared.arm_listener import NeighbourSettings
from construction_twin.ros.shared.gateway_config import gateway_config
from construction_twin.views.preflight import is_bare, is_true

Given = Mapping[str, str]
Values = dict[str, Any]
Settings = TypeVar("Settings", bound=pydantic.BaseModel)

#: What the launch files give beside the files, where any value will do.
_BROKER = {"host": "127.0.0.1", "port": 18830}
_MARKER = {"self_collision": "", "tf_prefix": "", "reviewer": "operator"}
_PLANNER = {"self_collision": "", "tf_prefix": ""}
_WORK = {"model": "", "cell": "", "self_collision": "", "tf_prefix": "", "review_file": "", "arm": "mock"}


def _model(model: type[Settings], values: Values) -> Settings:
    try:
        return model.model_validate(values)
    except pydantic.ValidationError as error:
        raise configuration_error(error, model) from error


def _arm(given: Given) -> str:
    return given.get("arm", "mock")


def _decimals(given: Given) -> int:
    return int(given.get("decimals", "3"))


def _executor(values: Values, given: Given, _robot: RobotModel) -> None:
    _model(executor.Settings, values | {"arm": _arm(given), "review_file": "reviews"})


def _pca_monitor(values: Values, given: Given, robot: RobotModel) -> None:
    launched = {"arm": _arm(given), "transition_file": "transitions", "decimals": _decimals(given)}
    settings = _model(pca_monitor.Settings, values | launched)
    codec = JointStringCodec.of(robot, settings.decimals)
    Gate(MotionLimits.of(robot), codec, settings.gate_settings(settings.arm != "none"), 0)


def tool_settings(given: Given) -> Values:
    """Return what launch/link.launch loads of a tool file; nothing without one."""
    return {"tool": read_mapping(given["tool"], "a tool")} if given.get("tool") else {}


def _gateway(values: Values, given: Given, robot: RobotModel) -> None:
    gateway_config(robot, values | {"decimals": _decimals(given), "cycle": int(given.get("rsi_cycle", "4"))})


def _mock_rsi(values: Values, given: Given, robot: RobotModel) -> None:
    launched: Values = {"gateway_host": "127.0.0.1", "cycle": int(given.get("rsi_cycle", "4"))} | tool_settings(given)
    if given.get("ethernet_xml"):
        launched["ethernet_xml"] = read_text(given["ethernet_xml"])
    build_controller(_model(MockSettings, values | launched), robot)


def _separation(values: Values, _given: Given, _robot: RobotModel) -> None:
    folder = str(Path(rospkg.RosPack().get_path("construction_twin"), "examples", "separation"))
    if folder not in sys.path:
        sys.path.append(folder)
    import separation_node

    settings = _model(separation_node.Settings, values)
    separation_node.SpeedTable(settings.table)


def _of(model: type[pydantic.BaseModel], launched: Values) -> Callable[[Values, Given, RobotModel], None]:
    def check(values: Values, _given: Given, _robot: RobotModel) -> None:
        _model(model, values | launched)

    return check


def _joint_state_publisher(values: Values, _given: Given, _robot: RobotModel) -> None:
    _model(_JointStatePublisher, values)


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
    loaded: Callable[[Given], bool] = field(default=_always)


#: Every file that bringup.launch loads for a node, in the order of the launch files.
NODE_FILES = (
    NodeFile("neighbour", _of(NeighbourSettings, {"name": "other"}), lambda given: bool(given.get("neighbour"))),
    NodeFile("planner", _of(planner.Settings, _PLANNER)),
    NodeFile(
        "follow_joint_trajectory",
        _of(follow_joint_trajectory.Settings, {"arm": "mock"}),
        lambda given: is_true(given, "follow_joint_trajectory", "true"),
    ),
    NodeFile("joint_velocities", _of(joint_velocities.Settings, {})),
    NodeFile("joint_state_publisher", _joint_state_publisher),
    NodeFile("gateway", _gateway, _has_link),
    NodeFile("mqtt_bridge", _of(mqtt_bridge.Settings, _BROKER), _has_link),
    NodeFile("mqtt_review", _of(mqtt_review.Settings, _BROKER), _has_link),
    NodeFile("mqtt_planner", _of(mqtt_planner.Settings, _BROKER), _has_link),
    NodeFile("mock_rsi", _mock_rsi, lambda given: _arm(given) == "mock" and not is_bare(given)),
    NodeFile("executor", _executor),
    NodeFile("pca_monitor", _pca_monitor),
    NodeFile("tool_marker", _of(tool_marker.Settings, _MARKER), lambda given: is_true(given, "tool_marker")),
    NodeFile("work", _of(work.Settings, _WORK), lambda given: bool(given.get("work_model"))),
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
        meant = f"; did you mean {near[0]}?" if near else ""
        return f"scenario:={given['scenario']}: {strange}: expected `scenario`, or the name of a node that it changes{meant}"
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

"""The nodes of a robot, and their own YAML files in config/, checked as the nodes will read them, before any of them starts."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

import rospkg

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.sentences import Sentence
from construction_twin.robot.description import RobotModel
from construction_twin.ros import nodes
from construction_twin.ros.shared.gateway_config import gateway_config
from construction_twin.ros.shared.launch_arguments import (
    Given,
    Values,
    controller_settings,
    decimals_of,
    has_link,
    read_mapping,
)
from construction_twin.ros.shared.node_shell import ConfigFile, NodeShell
from construction_twin.views.preflight import is_true

#: Nodes of a robot that are none of this package's, or start in another way.
_OTHERS = ("rsi_gateway", "separation", "joint_state_publisher", "robot_state_publisher", "plc")


def node_shells() -> tuple[NodeShell, ...]:
    """Return the shell of every node of a robot, by name: of each module of `ros/nodes` that has one."""
    modules = (import_module(f"{nodes.__name__}.{found.name}") for found in iter_modules(nodes.__path__))
    return tuple(module.NODE for module in modules if hasattr(module, "NODE"))


def _gateway(values: Values, given: Given, robot: RobotModel) -> None:
    # not a node's own: gateway and bridge read these from the robot's namespace; its file is looked at with that argument
    launched = controller_settings(given)
    launched.pop("ethernet_xml", None)
    gateway_config(robot, values | {"decimals": decimals_of(given)} | launched)


def _separation(values: Values, _given: Given, robot: RobotModel) -> None:
    folder = str(Path(rospkg.RosPack().get_path("construction_twin"), "examples", "separation"))
    if folder not in sys.path:
        sys.path.append(folder)
    import separation_node

    separation_node.NODE.check_values(values, robot)


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
    loaded: Callable[[Given], bool] = lambda _given: True


def _of(node: NodeShell, file: ConfigFile) -> NodeFile:
    """Return the file of a node, which checks its parameters itself."""

    def check(values: Values, given: Given, robot: RobotModel) -> None:
        node.check_values(values | file.launched(given), robot)

    return NodeFile(node.name, check, file.loaded)


_SHELLS = node_shells()
#: Nodes of one robot, in its namespace: a second one of a name would end the first.
ROBOT_NODES = (*(node.name for node in _SHELLS), *_OTHERS)
#: Every file that bringup.launch loads for a node.
NODE_FILES = (
    *(_of(node, node.file) for node in _SHELLS if node.file is not None),
    NodeFile("gateway", _gateway, has_link),
    NodeFile("separation", _separation, lambda given: is_true(given, "separation")),
)


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

"""`preflight`: has each node check what a launch file would give it, before anything starts; changes nothing."""

from __future__ import annotations

import importlib
import os
import shlex
import sys
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import rosgraph
from roslaunch import RLException
from roslaunch.config import ROSLaunchConfig, load_config_default
from roslaunch.core import Node
from rosmaster.paramserver import ParamDictionary

from construction_twin.broker import start as broker
from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.extensions import ExtensionAbsent, import_extension, node_modules
from construction_twin.core.share import share_folder
from construction_twin.ros.commands import experiment, scenario
from construction_twin.ros.nodes import rsi_gateway
from construction_twin.ros.nodes.startup import expect_known
from construction_twin.ros.shared.master import expect_wall_clock, running
from construction_twin.ros.shared.params import ros_home

_REQUIRED = object()


class LaunchParameters:
    """The parameters of a launch, as one of its nodes would find them."""

    def __init__(self, values: Mapping[str, Any], node: str):
        self._node, self._parameters = node, ParamDictionary(None)
        for name, value in values.items():
            self._parameters.set_param(name, value)

    def get_name(self) -> str:
        """Return the node's name."""
        return self._node

    def get_param(self, param_name: str, default: Any = _REQUIRED, /) -> Any:
        """Return a parameter's value by a name as the node has it; KeyError where there is none, and no default."""
        try:
            return self._parameters.get_param(rosgraph.names.resolve_name(param_name, self._node))
        except KeyError:
            if default is _REQUIRED:
                raise
            return default


def _broker(words: list[str], _parameters: LaunchParameters) -> None:
    options = broker.read_arguments(words)
    broker.check(options.config, options.port, options.accounts)


def _experiment(words: list[str], parameters: LaunchParameters) -> None:
    job = (
        import_extension("work.commands.build")
        if words == ["build"]
        else scenario
        if words == ["scenario"]
        else experiment
    )
    job.checked_parameters(parameters)


#: What a program is checked by that is no `NodeShell`'s, or that an argument asks an extension for; takes its words and parameters.
PROGRAMS: dict[str, Callable[[list[str], LaunchParameters], object]] = {
    "broker": _broker,
    "console": lambda words, _parameters: import_extension("console.program").check(words),
    "rsi_gateway": rsi_gateway.checked_config,
    "experiment": _experiment,
    "work": lambda _words, parameters: import_extension("work.nodes.work").NODE.checked_parameters(parameters),
}
#: Programs that only show something, and the example of a PLC.
_UNCHECKED = ("view", "plc")


def check_node(node: Node, values: Mapping[str, Any]) -> None:
    """Check a launch's parameters for a node of this package; ConstructionTwinError: it would refuse to start."""
    parameters = LaunchParameters(values, f"{node.namespace}{node.name}")
    if node.type in PROGRAMS:
        PROGRAMS[node.type](shlex.split(node.args), parameters)
        return
    if node.type == "separation":
        sys.path.append(str(share_folder() / "examples" / "separation"))
        importlib.import_module("separation_node").NODE.checked_parameters(parameters)
        return
    module = node_modules().get(node.type, f"construction_twin.extensions.{node.type}")
    name = module.removeprefix("construction_twin.extensions.")
    try:
        found = importlib.import_module(module) if name == module else import_extension(name)
    except ExtensionAbsent:
        return  # its node waits, and the others work without it
    found.NODE.checked_parameters(parameters)


def refusals(nodes: Iterable[Node], values: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the nodes that would refuse a start, by their sentence."""
    found: dict[str, list[str]] = {}
    for node in nodes:
        if node.package == "construction_twin" and node.type not in _UNCHECKED:
            try:
                check_node(node, values)
            except ConstructionTwinError as error:
                found.setdefault(str(error), []).append(f"{node.namespace}{node.name}")
    return found


def read_launch(file: str, words: list[str]) -> ROSLaunchConfig:
    """Return what roslaunch would start with arguments ``name:=value``."""
    return load_config_default([(file, words)], None, verbose=False, assign_machines=False)


def main() -> int:
    """Print the obstacles to a launch file's start, bringup.launch by default, with arguments; return the exit code."""
    words = [word for word in sys.argv[1:] if ":=" in word]
    file = next((word for word in sys.argv[1:] if ":=" not in word), "bringup.launch")
    file = file if "/" in file else str(share_folder() / "launch" / file)
    try:
        expect_known([file, *words])
        config = read_launch(file, words)
    except (RLException, ConstructionTwinError) as error:
        print(f"cannot start: {error}", file=sys.stderr)
        return 1
    # where roslaunch starts the nodes
    if ros_home().is_dir():
        os.chdir(ros_home())
    found = refusals(config.nodes, {name: param.value for name, param in config.params.items()})
    uri = rosgraph.get_master_uri()
    there = running([f"{node.namespace}{node.name}" for node in config.nodes], uri)
    try:
        expect_wall_clock(uri)
        if there:
            more = f" and {len(there) - 1} more" if len(there) > 1 else ""
            raise ConfigurationError(uri, f"{there[0]}{more}", "no such nodes: end their launch, or give another robot")
    except ConfigurationError as error:
        found[str(error)] = ["startup"]
    for sentence, nodes in found.items():
        print(f"cannot start: {sentence} ({', '.join(sorted(nodes))})", file=sys.stderr)
    if not found:
        print("ok")
    return 1 if found else 0

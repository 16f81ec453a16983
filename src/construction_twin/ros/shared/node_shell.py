"""One shell for every robot's node: its parameters, their check, and all that it has to do with ROS, declared before it starts."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Generic

import pydantic

from construction_twin.robot.description import RobotModel
from construction_twin.ros.shared.launch_arguments import Given, Values
from construction_twin.ros.shared.node import run_node
from construction_twin.ros.shared.params import Settings, read_parameters, robot_from_parameters, settings_of
from construction_twin.ros.shared.ports import Interface, Ports


def nothing_more(_settings: pydantic.BaseModel, _robot: RobotModel) -> None:
    """Check nothing: what the model of the parameters accepts, the node can start with."""


def _nothing(_given: Given) -> Values:
    return {}


def _always(_given: Given) -> bool:
    return True


@dataclass(frozen=True)
class ConfigFile:
    """The file of a node's parameters, `config/<name>.yaml`, as bringup.launch loads it.

    Attributes:
        launched: Takes the arguments; returns what the launch files give beside the file: where any value will do, one that does.
        loaded: Takes the arguments; returns whether it is loaded.
    """

    launched: Callable[[Given], Values] = _nothing
    loaded: Callable[[Given], bool] = _always


@dataclass(frozen=True)
class NodeShell(Generic[Settings]):
    """One robot's node, as its process starts it and as `preflight` checks it before anything starts.

    Attributes:
        name: Default node name.
        settings: Model of its private parameters.
        start: Makes the node of these, its robot and what is open by then; a result with a `run` method is run in the main thread.
        interface: All that it has to do with ROS.
        check: Raises a ConstructionTwinError for parameters that fit the model and yet cannot work with this robot. Pure.
        file: Of its parameters, which preflight reads and checks; None: the launch files give them all.
        fast: It is on the 250 Hz path: its threads take turns every millisecond.
    """

    name: str
    settings: type[Settings]
    start: Callable[[Settings, RobotModel, Ports], object]
    interface: Interface
    check: Callable[[Settings, RobotModel], object] = nothing_more
    file: ConfigFile | None = None
    fast: bool = False

    def check_values(self, values: Mapping[str, object], robot: RobotModel) -> None:
        """Raise the ConstructionTwinError that the node would end with, were these its private parameters."""
        self.check(settings_of(self.settings, values), robot)

    def run(self) -> None:
        """Be the node's process."""
        if self.fast:
            sys.setswitchinterval(0.001)
        run_node(self.name, self._start)

    def _start(self) -> object:
        settings, robot = read_parameters(self.settings), robot_from_parameters()
        self.check(settings, robot)
        return self.open(settings, robot)

    def open(self, settings: Settings, robot: RobotModel) -> Any:
        """Return the node, with all that it has to do with ROS."""
        ports = Ports(self.interface, settings, robot)
        node = self.start(settings, robot, ports)
        ports.connect(node)
        return node

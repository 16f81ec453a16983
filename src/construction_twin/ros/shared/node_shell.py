"""One shell for every robot's node: its parameters, their check, and all that it has to do with ROS, declared before it starts."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic

import pydantic
import rospy

from construction_twin.robot.description import RobotModel
from construction_twin.ros.shared.node import run_node
from construction_twin.ros.shared.params import Parameters, Settings, read_parameters, robot_from_parameters
from construction_twin.ros.shared.ports import Interface, Ports, Shared
from construction_twin.ros.shared.start_refusal import expect_own_parameters, refuse


def nothing_more(_settings: pydantic.BaseModel, _robot: RobotModel, _shared: Shared) -> None:
    """Check nothing: what the model of the parameters accepts, the node can start with."""


@dataclass(frozen=True)
class NodeShell(Generic[Settings]):
    """One robot's node, as its process starts it and as `preflight` checks it before anything starts.

    Attributes:
        name: Default node name.
        settings: Model of its private parameters.
        start: Makes the node of these, its robot and what is open by then; a result with a `run` method is run in the main thread.
        interface: All that it has to do with ROS.
        check: Takes parameters, robot and the shared parameters of the interface; raises a ConstructionTwinError where the node
            cannot work with them, or must not. Changes nothing.
        fast: It is on the 250 Hz path: its threads take turns every millisecond.
        refused: As of `run_node`.
    """

    name: str
    settings: type[Settings]
    start: Callable[[Settings, RobotModel, Ports], object]
    interface: Interface
    check: Callable[[Settings, RobotModel, Shared], object] = nothing_more
    fast: bool = False
    refused: Callable[[str], object] = refuse

    def checked(self, parameters: Parameters = rospy) -> tuple[Settings, RobotModel]:
        """Return what the node starts with; raise the ConstructionTwinError that it is refused for."""
        settings, robot = read_parameters(self.settings, parameters), robot_from_parameters(parameters=parameters)
        self.check(settings, robot, self.interface.shared(parameters))
        return settings, robot

    def run(self) -> None:
        """Be the node's process."""
        if self.fast:
            sys.setswitchinterval(0.001)
        run_node(self.name, self._start, self.refused)

    def _start(self) -> object:
        found = self.checked()
        expect_own_parameters()
        return self.open(*found)

    def open(self, settings: Settings, robot: RobotModel) -> Any:
        """Return the node, with all that it has to do with ROS."""
        ports = Ports(self.interface, settings, robot)
        node = self.start(settings, robot, ports)
        ports.connect(node)
        return node

"""Parameters, read once at start and checked as a whole, and values saved for the process after this one."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import pydantic
import rospy

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.units import NANOSECONDS
from construction_twin.robot.description import RobotModel, load_robot
from construction_twin.validation import StrictModel

Settings = TypeVar("Settings", bound=StrictModel)

#: Where a node's parameters are: `rospy`, or what a launch file would set, with `get_name` and `get_param`.
Parameters = Any


class NodeSettings(StrictModel):
    """Private parameters of a node on the 250 Hz path; SCHED_FIFO priority where the system permits it, 0: none."""

    realtime_priority: int = pydantic.Field(0, ge=0, le=99)


def read_parameters(model: type[Settings], parameters: Parameters = rospy) -> Settings:
    """Return the node's private parameters; raises like `StrictModel.read`."""
    return model.read(parameters.get_param("~", {}))


def robot_from_parameters(namespace: str = "", parameters: Parameters = rospy) -> RobotModel:
    """Return the robot of a namespace's ``robot_description`` and ``robot`` parameters: ``/kr120/``; the node's own by default."""
    names = [namespace + name for name in ("robot_description", "robot")]
    values = [parameters.get_param(name, None) for name in names]
    for name, value in zip(names, values):
        if value is None:
            raise ConfigurationError(rospy.resolve_name(name), None, "a robot, as launch/robot.launch loads it")
    return load_robot(*values)


def robot_file(path: str, robot: str) -> Path:
    """Return where a robot's own file is: relative to ROS_HOME, ``{robot}`` stands for the robot's name."""
    return ros_home() / Path(path.replace("{robot}", robot)).expanduser()


def ros_home() -> Path:
    """Return the folder for a node's own files: environment variable ROS_HOME, by default ``~/.ros`` (as roslaunch does)."""
    return Path(os.environ.get("ROS_HOME") or Path.home() / ".ros")


#: A write that failed is tried again after this time [ns].
_RETRY = NANOSECONDS


class SavedParameter:
    """A text or bool on the parameter server, written by a thread that may wait; `fault`: why writing failed."""

    def __init__(self, value: object, write: Callable[[Any], object], name: str):
        self.fault = ""
        self._name = name
        self._write = write
        self._written = value
        self._writer: threading.Thread | None = None
        self._tried_at: int | None = None

    @property
    def writing(self) -> bool:
        """Whether a value is being written now."""
        return self._writer is not None and self._writer.is_alive()

    def save(self, value: object, now: int) -> None:
        """Save a value; returns at once. To be called again and again, from one thread, `now` in ns."""
        if value == self._written or self.writing:
            return
        if self._tried_at is not None and self.fault and now - self._tried_at < _RETRY:
            return
        self._tried_at = now
        self._writer = threading.Thread(target=self._write_value, args=(value,), daemon=True)
        self._writer.start()

    def _write_value(self, value: object) -> None:
        try:
            # XML-RPC takes a plain text only
            self._write(str(value) if isinstance(value, str) else value)
        except Exception as error:  # noqa: BLE001 (sockets, HTTP and XML-RPC raise kinds of their own; each is reported and tried again)
            self.fault = f"{self._name} was not written, and what it says would not outlast this node ({error})"
            return
        self._written, self.fault = value, ""

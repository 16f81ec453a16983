"""Parameters read once at start, checked as a whole, into one immutable object."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

import pydantic
import rospy

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.validation import configuration_error
from construction_twin.robot.description import RobotModel, load_robot

Settings = TypeVar("Settings", bound=pydantic.BaseModel)


#: Where a node's parameters are: `rospy`, or what a launch file would set, with `get_name` and `get_param`.
Parameters = Any


class PrivateSettings(pydantic.BaseModel):
    """Private parameters of a node: a misspelt key is an error, not a silent default."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)


class NodeSettings(PrivateSettings):
    """Private parameters of a node on the 250 Hz path; SCHED_FIFO priority where the system permits it, 0: none."""

    realtime_priority: int = pydantic.Field(0, ge=0, le=99)


def settings_of(model: type[Settings], values: Mapping[str, object], where: str = "") -> Settings:
    """Return values as a model has them; ConfigurationError naming the key, and `where` it stands."""
    try:
        return model.model_validate(values)
    except pydantic.ValidationError as error:
        raise configuration_error(error, model, where) from error


def read_parameters(model: type[Settings], parameters: Parameters = rospy) -> Settings:
    """Return the node's private parameters; raises like `settings_of`."""
    return settings_of(model, parameters.get_param("~", {}))


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

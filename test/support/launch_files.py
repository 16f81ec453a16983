"""Launch files as roslaunch reads them, in this process: of the commands of parameters only that of the URDF is carried out."""

from __future__ import annotations

import functools
import shlex
from pathlib import Path

from roslaunch.config import ROSLaunchConfig, load_config_default
from roslaunch.core import RLException
from roslaunch.xmlloader import XmlLoader

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.urdf import expand_xacro, xacro_arguments
from construction_twin.ros.commands import preflight

LAUNCH = Path(__file__).resolve().parents[2] / "launch"
_expanded = functools.cache(lambda path, words: expand_xacro(path, xacro_arguments(words)))


class Reader(XmlLoader):
    """roslaunch's own reader, which starts no program."""

    def param_value(self, verbose, name, ptype, value, textfile, binfile, command):
        """Return a parameter's value; of one that is a command its text."""
        if command is None:
            return super().param_value(verbose, name, ptype, value, textfile, binfile, command)
        if not name.endswith("robot_description"):
            return command
        _, path, *words = shlex.split(command)
        try:
            return _expanded(path, shlex.join(words))
        except ConfigurationError as error:
            raise RLException(f"robot_xacro: {error}") from error


@functools.cache
def read_launch(file: str, *words: str) -> ROSLaunchConfig:
    """Return what roslaunch would start with arguments ``name:=value``; `file` is a name in launch/."""
    launch = [(str(LAUNCH / f"{file}.launch"), list(words))]
    return load_config_default(launch, None, loader=Reader(), verbose=False, assign_machines=False)


def parameters(file: str, *words: str) -> dict[str, object]:
    """Return the parameters by name, those of commands but the URDF as texts."""
    return {name: param.value for name, param in read_launch(file, *words).params.items()}


def twin_in_tf(*words: str) -> str:
    """Return the stream of poses that the twin's tree of bringup's tf is made of, and joint_states with it."""
    nodes = {node.name: dict(node.remap_args) for node in read_launch("bringup", *words).nodes}
    assert nodes["robot_state_publisher"]["joint_states"] == "shown/twin"
    # the stock node, between two topics of ours
    assert parameters("bringup", *words)["/kr120/joint_state_publisher/source_list"] == ["velocities/joint_states"]
    return nodes["display"].get("twin/joint_states", "twin/joint_states")


def refusals(file: str, *words: str, only: str = "", **changes: object) -> dict[str, list[str]]:
    """Return which nodes would refuse this start, by their sentence.

    Args:
        only: Name of the one node that is asked; empty: all are.
        changes: Parameters of the robot kr120 that a file of config/ would set otherwise: node__key.
    """
    config = read_launch(file, *words)
    values = {name: param.value for name, param in config.params.items()}
    for name, value in changes.items():
        full = f"/kr120/{name.replace('__', '/')}"
        values = {key: kept for key, kept in values.items() if not key.startswith(f"{full}/") and key != full}
        if value is not None:
            values[full] = value
    return preflight.refusals([node for node in config.nodes if only in ("", node.name)], values)

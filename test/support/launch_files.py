"""Launch files as roslaunch reads them, in this process: the commands of parameters are not carried out but stand as texts, so that
what `preflight` would be asked can be asked here.
"""

from __future__ import annotations

import functools
import shlex
from pathlib import Path

from roslaunch.config import ROSLaunchConfig, load_config_default
from roslaunch.core import RLException
from roslaunch.xmlloader import XmlLoader

from construction_twin.ros.commands import preflight
from construction_twin.views.roslaunch_call import RoslaunchCall

LAUNCH = Path(__file__).resolve().parents[2] / "launch"


class Reader(XmlLoader):
    """roslaunch's own reader, which starts no program."""

    #: The command of the last parameter `preflight` that was read.
    asked = ""

    def param_value(self, verbose, name, ptype, value, textfile, binfile, command):
        """Return a parameter's value; of one that is a command its text."""
        if command is None:
            return super().param_value(verbose, name, ptype, value, textfile, binfile, command)
        if name == "preflight":
            self.asked = command
        return command


@functools.cache
def _read(file: str, *words: str) -> tuple[ROSLaunchConfig | RLException, str]:
    """Return what roslaunch would start, or why it cannot be read, and the command of `preflight`, which comes before the rest."""
    reader, launch = Reader(), [(str(LAUNCH / f"{file}.launch"), list(words))]
    try:
        config = load_config_default(launch, None, loader=reader, verbose=False, assign_machines=False)
    except RLException as error:
        return error, reader.asked
    return config, reader.asked


def read_launch(file: str, *words: str) -> ROSLaunchConfig:
    """Return what roslaunch would start with arguments ``name:=value``; `file` is a name in launch/."""
    config, _ = _read(file, *words)
    if isinstance(config, RLException):
        raise config
    return config


def node_names(file: str, *words: str) -> list[str]:
    """Return the nodes in the order in which they are started."""
    return [f"{node.namespace}{node.name}" for node in read_launch(file, *words).nodes]


def node_arguments(name: str, file: str, *words: str) -> str:
    """Return the command line of a node."""
    nodes = {f"{node.namespace}{node.name}": node for node in read_launch(file, *words).nodes}
    return f" {nodes[name].args} "


def parameters(file: str, *words: str) -> dict[str, object]:
    """Return the parameters by name, those of commands as texts."""
    return {name: param.value for name, param in read_launch(file, *words).params.items()}


def twin_in_tf(*words: str) -> str:
    """Return the stream of poses that the twin's tree of bringup's tf is made of, and joint_states with it."""
    nodes = {node.name: dict(node.remap_args) for node in read_launch("bringup", *words).nodes}
    assert nodes["robot_state_publisher"]["joint_states"] == "shown/twin"
    # the stock node, between two topics of ours
    assert parameters("bringup", *words)["/kr120/joint_state_publisher/source_list"] == ["velocities/joint_states"]
    return nodes["display"].get("twin/joint_states", "twin/joint_states")


def asked(file: str, *words: str) -> dict[str, str]:
    """Return the arguments with which the launch file calls `preflight`."""
    _, command = _read(file, *words)
    return dict(word.split(":=", 1) for word in shlex.split(command) if ":=" in word)


def refusal(file: str, *words: str) -> str:
    """Return why `preflight` would refuse this start, without a look at what runs here; empty when it would not."""
    given = dict(word.split(":=", 1) for word in words)
    call = RoslaunchCall(("construction_twin", f"{file}.launch"), given, {})
    # the whole call is looked at first: what no launch file reads, roslaunch would not pass on either
    return preflight.call_problem(call) or preflight.refusal(asked(file, *words), call, "")

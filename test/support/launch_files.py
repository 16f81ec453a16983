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


def poses_in_tf(*words: str) -> dict[tuple[str, str], str]:
    """Return the stream of poses that each tree of bringup's tf is made of, by the publishing node and the tree's name."""
    nodes = {node.name: node for node in read_launch("bringup", *words).nodes}
    known = {name.removeprefix("/kr120/"): value for name, value in parameters("bringup", *words).items()}
    found = {}
    for node in nodes.values():
        if node.type != "robot_state_publisher":
            continue
        topic = dict(node.remap_args).get("joint_states", "joint_states")
        # ours between, which leaves out poses at rest
        topic = {"shown/twin": "joint_states", "shown/physical": "physical/joint_states"}.get(topic, topic)
        if topic == "joint_states":
            # the stock node between, and ours that adds velocities to the twin's poses
            (topic,) = known["joint_state_publisher/source_list"]
            assert topic == "velocities/joint_states"
            topic = dict(nodes["joint_velocities"].remap_args).get("twin/joint_states", "twin/joint_states")
        found[node.name, known[f"{node.name}/tf_prefix"].removeprefix("kr120/")] = topic
    return found


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

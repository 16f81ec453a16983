"""The command `expand_xacro`: a URDF, or a robot YAML's home pose, for a launch file's parameter; roslaunch waits for it."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path

import yaml

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.units import radians


def home_positions(path: str | Path) -> dict[str, float]:
    """Return the positions of a robot YAML's home pose and other joints, by joint name [rad], [m]; the nodes check the file."""
    robot = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    joints = robot["joints"].items()
    home = {
        name: joint["home_mm"] / 1e3 if "home_mm" in joint else radians((joint["home_deg"],))[0]
        for name, joint in joints
    }
    return home | robot.get("other_joints", {})


def main() -> None:
    """Print the URDF of a xacro file, or a robot YAML's home pose [rad], [m]; a wrong file ends the program with a sentence."""
    words = sys.argv[1:]
    if len(words) == 2 and words[0] == "--home":
        try:
            print(yaml.safe_dump(home_positions(words[1])))
        except (OSError, yaml.YAMLError, TypeError, KeyError, AttributeError) as error:
            sys.exit(f"robot_config: {words[1]}: found {' '.join(str(error).split())}, expected a robot YAML")
        return
    if not words:
        sys.exit("usage: expand_xacro FILE [argument=value ...], or expand_xacro --home ROBOT_YAML")
    # a home pose needs no xacro, and roslaunch waits
    from construction_twin.robot.urdf import expand_xacro, xacro_arguments

    try:
        print(expand_xacro(words[0], xacro_arguments(shlex.join(words[1:]))))
    except ConfigurationError as error:
        sys.exit(f"robot_xacro: {error}")

"""The command `home_pose`: the home pose of a robot YAML, for a launch file's parameter; roslaunch waits for it."""

from __future__ import annotations

import sys
from pathlib import Path

import yaml

from construction_twin.core.units import radians


def home_positions(path: str | Path) -> dict[str, float]:
    """Return the home pose of a robot YAML, and where its other joints stand, by name [rad], [m]; the nodes check the file."""
    robot = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    joints = robot["joints"].items()
    home = {
        name: joint["home_mm"] / 1e3 if "home_mm" in joint else radians((joint["home_deg"],))[0]
        for name, joint in joints
    }
    return home | robot.get("other_joints", {})


def main() -> None:
    """Print the home pose as YAML [rad], [m]; what is wrong with the file ends the process with one sentence."""
    if len(sys.argv) != 2:
        sys.exit("usage: home_pose FILE")
    try:
        print(yaml.safe_dump(home_positions(sys.argv[1])))
    except (OSError, yaml.YAMLError, TypeError, KeyError, AttributeError) as error:
        sys.exit(f"robot_config: {sys.argv[1]}: found {' '.join(str(error).split())}, expected a robot YAML")

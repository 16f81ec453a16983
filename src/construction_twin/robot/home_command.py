"""The command `home_pose`: the home pose of a robot YAML, for a launch file's parameter."""

from __future__ import annotations

import sys

import yaml

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.description import home_positions


def main() -> None:
    """Print the home pose as YAML [rad], [m]; what is wrong with the file ends the process with one sentence."""
    if len(sys.argv) != 2:
        sys.exit("usage: home_pose FILE")
    try:
        print(yaml.safe_dump(home_positions(sys.argv[1])))
    except ConfigurationError as error:
        sys.exit(str(error))

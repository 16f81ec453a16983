"""The command `expand_xacro`: a robot's URDF, for a launch file's robot_description."""

from __future__ import annotations

import shlex
import sys

from construction_twin.core.errors import ConfigurationError
from construction_twin.robot.urdf import expand_xacro, xacro_arguments


def main() -> None:
    """Print the URDF of a xacro file; what is wrong with it ends the process with one sentence."""
    if len(sys.argv) < 2:
        sys.exit("usage: expand_xacro FILE [argument=value ...]")
    try:
        print(expand_xacro(sys.argv[1], xacro_arguments(shlex.join(sys.argv[2:]))))
    except ConfigurationError as error:
        sys.exit(f"robot_xacro: {error}")

"""The command `srdf`, and what it has in common with `moveit_config`. Needs no ROS master."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.files import write_whole
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.robot.srdf import srdf
from construction_twin.scene.self_collision_file import parse_pairs, read_pairs_yaml


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the SRDF of a robot."""
    parser = robot_parser(
        "srdf", "Write a robot's SRDF: groups, home pose, end effectors, pairs of links that are not checked."
    )
    parser.add_argument("output", nargs="?", default="-", help="file to write; - or nothing: the terminal")
    options = parser.parse_args(arguments)
    run("srdf", lambda: _write(options))


def robot_parser(name: str, description: str) -> argparse.ArgumentParser:
    """Return the parser of a command that reads a robot's files."""
    parser = argparse.ArgumentParser(prog=name, description=description)
    parser.add_argument("urdf", help="URDF or xacro")
    parser.add_argument("robot", help="robot YAML, e.g. config/kr120.yaml")
    parser.add_argument("self_collision", help="file that `self_collision` wrote for this robot")
    parser.add_argument("--robot-xacro-args", default="", metavar="'NAME=VALUE ...'", help="arguments of the xacro")
    return parser


def run(name: str, work: Callable[[], None]) -> None:
    """Do a command's work; what is wrong with its files ends the process with one sentence."""
    try:
        work()
    except (ConstructionTwinError, OSError) as error:
        sys.exit(f"{name}: {error}")


def read(options: argparse.Namespace) -> tuple[RobotModel, Mapping[frozenset[str], str]]:
    """Return the robot that a command's options name, and the reason of each pair that is not checked.

    Whether the pairs fit the robot's geometry is not asked, because a launch file waits for this: bringup and its nodes ask.
    """
    robot = read_robot_files(options.urdf, options.robot, options.robot_xacro_args)
    return robot, parse_pairs(read_pairs_yaml(options.self_collision), options.self_collision).reasons


def _write(options: argparse.Namespace) -> None:
    text = srdf(*read(options))
    if options.output == "-":
        print(text, end="")
        return
    write_whole(Path(options.output), text)
    print(f"{Path(options.output).absolute()}: written")

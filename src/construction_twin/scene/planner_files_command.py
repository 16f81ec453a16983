"""The commands `srdf` and `moveit_config`: a robot's files for other planners. Need no ROS master."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.robot.moveit_config import moveit_files
from construction_twin.robot.srdf import srdf
from construction_twin.scene.self_collision_file import parse_pairs, read_pairs_yaml


def srdf_main(arguments: Sequence[str] | None = None) -> None:
    """Write the SRDF of a robot."""
    parser = _parser(
        "srdf", "Write a robot's SRDF: groups, home pose, end effectors, pairs of links that are not checked."
    )
    parser.add_argument("output", nargs="?", default="-", help="file to write; - or nothing: the terminal")
    options = parser.parse_args(arguments)
    _run("srdf", lambda: _write_srdf(options))


def moveit_config_main(arguments: Sequence[str] | None = None) -> None:
    """Write the folder of a robot's files for MoveIt."""
    parser = _parser(
        "moveit_config",
        "Write a robot's files for MoveIt 1 into a folder: SRDF, joint limits, kinematics, OMPL, controllers. "
        "move_group.launch takes the folder as config:=...",
    )
    parser.add_argument("folder", help="folder to write into; made when it is not there")
    options = parser.parse_args(arguments)
    _run("moveit_config", lambda: _write_folder(options))


def _parser(name: str, description: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog=name, description=description)
    parser.add_argument("urdf", help="URDF or xacro")
    parser.add_argument("robot", help="robot YAML, e.g. config/kr120.yaml")
    parser.add_argument("self_collision", help="file that `self_collision` wrote for this robot")
    parser.add_argument("--robot-xacro-args", default="", metavar="'NAME=VALUE ...'", help="arguments of the xacro")
    return parser


def _run(name: str, work: Callable[[], None]) -> None:
    try:
        work()
    except (ConstructionTwinError, OSError) as error:
        sys.exit(f"{name}: {error}")


def _read(options: argparse.Namespace) -> tuple[RobotModel, Mapping[frozenset[str], str]]:
    robot = read_robot_files(options.urdf, options.robot, options.robot_xacro_args)
    pairs = parse_pairs(read_pairs_yaml(options.self_collision), options.self_collision)
    return robot, pairs.reasons


def _write_srdf(options: argparse.Namespace) -> None:
    text = srdf(*_read(options))
    if options.output == "-":
        print(text, end="")
        return
    Path(options.output).write_text(text, encoding="utf-8")
    print(f"{Path(options.output).absolute()}: written")


def _write_folder(options: argparse.Namespace) -> None:
    files = moveit_files(*_read(options))
    folder = Path(options.folder).absolute()
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    print(f"{folder}: {', '.join(files)}")
    print(f"start MoveIt with: roslaunch construction_twin move_group.launch config:={folder} robot:=...")

"""The command `moveit_config`: a robot's folder of files for MoveIt. Needs no ROS master."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from construction_twin.core.files import write_whole
from construction_twin.robot.moveit_config import moveit_files
from construction_twin.scene.srdf_command import read, robot_parser, run


def main(arguments: Sequence[str] | None = None) -> None:
    """Write the folder of a robot's files for MoveIt."""
    parser = robot_parser(
        "moveit_config",
        "Write a robot's files for MoveIt 1 into a folder: SRDF, joint limits, kinematics, OMPL, controllers. "
        "move_group.launch takes the folder as config:=...",
    )
    parser.add_argument("folder", help="folder to write into; made when it is not there")
    options = parser.parse_args(arguments)
    run("moveit_config", lambda: _write(options))


def _write(options: argparse.Namespace) -> None:
    files = moveit_files(*read(options))
    folder = Path(options.folder).absolute()
    for name, text in files.items():
        write_whole(folder / name, text)
    print(f"{folder}: {', '.join(files)}")
    print(f"start MoveIt with: roslaunch construction_twin move_group.launch config:={folder} robot:=...")

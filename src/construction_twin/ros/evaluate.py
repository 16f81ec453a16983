"""Command line: evaluates a bag and writes the report. Runs without a ROS master."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import rospkg
import rospy
from rich.console import Console

from construction_twin.errors import ConstructionTwinError
from construction_twin.evaluation.report import write_report
from construction_twin.evaluation.tables import render_tables
from construction_twin.robot import RobotModel, read_robot_files
from construction_twin.ros.bag import read_recording

XACRO, DESCRIPTION = "urdf/kr120r2500.urdf.xacro", "config/kr120.yaml"


def main(arguments: list[str] | None = None) -> int:
    """Evaluate the bag named on the command line.

    Parameters
    ----------
    arguments : list of str, optional
        Default: the process's, without what roslaunch adds.

    Returns
    -------
    status : int
        0, or 1 after a sentence on standard error.
    """
    options = _parser().parse_args(rospy.myargv()[1:] if arguments is None else arguments)
    directory = options.output or options.bag.with_suffix("").with_name(options.bag.stem + "_evaluation")
    console = Console(highlight=False)
    try:
        recording = read_recording(options.bag, options.robot)
        robot = _robot(options)
        report = write_report(recording, robot, directory)
    except (ConstructionTwinError, OSError) as error:
        print(f"evaluate: {error}", file=sys.stderr)
        return 1
    render_tables(report.summary, console)
    if robot.joint_names != recording.joint_names:
        console.print(
            f"No figure8.png: {robot.name} has other joints than the bag; see --robot-xacro and --robot-config."
        )
    print_files(console, report.files)
    return 0


def print_files(console: Console, files) -> None:
    """Print where the files of a report are."""
    console.print("\nWritten:")
    for path in files:
        console.print(f"  {path}", soft_wrap=True)


def package_file(relative: str) -> Path:
    """Return the path of a file of this package."""
    return Path(rospkg.RosPack().get_path("construction_twin"), relative)


def _robot(options: argparse.Namespace) -> RobotModel:
    return read_robot_files(
        options.robot_xacro or package_file(XACRO), options.robot_config or package_file(DESCRIPTION)
    )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="evaluate", description="Compare twin and physical arm in a bag: tables, figures and summary.json."
    )
    parser.add_argument(
        "bag", type=Path, help="a bag with at least .../twin/joint_states and .../physical/joint_states"
    )
    parser.add_argument("--output", type=Path, metavar="DIR", help="folder for the files (default: BAG + _evaluation)")
    parser.add_argument("--robot", metavar="NAMESPACE", help="which robot, when the bag holds several, e.g. /kr120")
    parser.add_argument(
        "--robot-xacro", type=Path, metavar="FILE", help=f"URDF or xacro for figure 8 (default: {XACRO})"
    )
    parser.add_argument("--robot-config", type=Path, metavar="FILE", help=f"robot YAML (default: {DESCRIPTION})")
    return parser

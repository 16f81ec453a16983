"""Command line: evaluates a bag and writes the report, without a ROS master; and what other commands that read a bag share."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import genpy
import rospy
from rich.console import Console

from construction_twin.core.errors import ConstructionTwinError, command_message, system_message
from construction_twin.core.files import check_writable
from construction_twin.core.share import share_file
from construction_twin.evaluation.bag import PLAN, TYPES, choose_robot, open_bag, read_recording, write_mcap
from construction_twin.evaluation.recording import Recording
from construction_twin.evaluation.report import write_report
from construction_twin.evaluation.tables import render_tables, table_console
from construction_twin.msg import Plan as PlanMsg
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.robot.plan import Plan
from construction_twin.ros.messages.convert import plan_from_msg


def read_plans(path: Path, namespace: str | None = None) -> list[Plan]:
    """Return every plan of one robot in a bag, the oldest first."""
    try:
        with open_bag(path) as bag:
            robot = choose_robot(bag.topics, namespace, PLAN)
            recorded = bag.raw({f"{robot.rstrip('/')}/{PLAN}": TYPES[PLAN]})
            messages = [PlanMsg().deserialize(data) for _, data, _ in recorded]
    except genpy.DeserializationError as error:
        raise ConstructionTwinError(f"{path} cannot be read as a rosbag: {system_message(error)}") from error
    # a latched plan is recorded once more by whoever listens again
    return list({message.id: plan_from_msg(message) for message in messages}.values())


def bag_parser(program: str, description: str, needs: str, suffix: str) -> argparse.ArgumentParser:
    """Return the parser of such a command; `suffix`, behind the bag's name, is the folder for its files."""
    parser = argparse.ArgumentParser(prog=program, description=description)
    parser.add_argument("bag", type=Path, help=needs)
    parser.add_argument("--output", type=Path, metavar="DIR", help=f"folder for the files (default: BAG + {suffix})")
    parser.add_argument("--robot", metavar="NAMESPACE", help="which robot, when the bag holds several, e.g. /kr120")
    parser.set_defaults(suffix=suffix)
    return parser


def report_bag(
    program: str, options: argparse.Namespace, write: Callable[[Recording, Path, Console], Iterable[Path]]
) -> int:
    """Read the bag that the options name, have `write` print what it finds and make files, and print where they are."""
    directory = options.output or options.bag.with_suffix("").with_name(options.bag.stem + options.suffix)
    console = table_console()
    try:
        # before anything that takes long
        check_writable(directory)
        files = write(read_recording(options.bag, options.robot), directory, console)
    except (ConstructionTwinError, OSError) as error:
        print(f"{program}: {command_message(error)}", file=sys.stderr)
        return 1
    print_files(console, files)
    return 0


def print_files(console: Console, files: Iterable[Path]) -> None:
    """Print where the files of a report are."""
    console.print("\nWritten:")
    for path in files:
        console.print(f"  {path}", soft_wrap=True)


#: This package's arms, as URDF and robot YAML; the first one whose joints are the bag's is taken.
ROBOTS = (
    ("urdf/kr120r2500.urdf.xacro", "config/kr120.yaml"),
    ("urdf/kr120_track.urdf.xacro", "config/kr120_track.yaml"),
)


def main(arguments: list[str] | None = None) -> int:
    """Evaluate the bag named on the command line."""
    parser = bag_parser(
        "evaluate",
        "Compare twin and physical arm in a bag: tables, figures and summary.json.",
        "a bag with at least .../twin/joint_states and .../physical/joint_states",
        "_evaluation",
    )
    parser.add_argument(
        "--mcap", action="store_true", help="also write the bag as recording.mcap, for Foxglove or Rerun"
    )
    xacro = "URDF or xacro for figure 8 and units (default: the one here that fits the bag)"
    parser.add_argument("--robot-xacro", type=Path, metavar="FILE", help=xacro)
    parser.add_argument("--robot-xacro-args", default="", metavar="'NAME=VALUE ...'", help="arguments of the xacro")
    parser.add_argument("--robot-config", type=Path, metavar="FILE", help="robot YAML (default: likewise)")
    options = parser.parse_args(rospy.myargv()[1:] if arguments is None else arguments)

    def write(recording: Recording, directory: Path, console: Console) -> tuple[Path, ...]:
        robot = _robot(options, recording.joint_names)
        report = write_report(recording, robot, directory)
        others: tuple[Path, ...] = ()
        if options.mcap:
            others = (directory / "recording.mcap",)
            write_mcap(options.bag, others[0])
        render_tables(report.summary, console)
        if robot.joint_names != recording.joint_names:
            console.print(f"No figure8.png: {robot.name} has other joints than the bag: --robot-xacro, --robot-config.")
        return (*report.files, *others)

    return report_bag("evaluate", options, write)


def _robot(options: argparse.Namespace, joint_names: tuple[str, ...]) -> RobotModel:
    if options.robot_xacro or options.robot_config or options.robot_xacro_args:
        files = [given or share_file(own) for given, own in zip((options.robot_xacro, options.robot_config), ROBOTS[0])]
        return read_robot_files(files[0], files[1], options.robot_xacro_args)
    robots = [read_robot_files(share_file(xacro), share_file(config)) for xacro, config in ROBOTS]
    return next((robot for robot in robots if robot.joint_names == joint_names), robots[0])

"""What the commands share that read a bag: its plans, their options, the folder for their files, how they end."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import genpy
from rich.console import Console

from construction_twin.core.errors import ConstructionTwinError, command_message, system_message
from construction_twin.core.files import check_writable
from construction_twin.evaluation.bag import PLAN, TYPES, choose_robot, open_bag, read_recording
from construction_twin.evaluation.recording import Recording
from construction_twin.evaluation.tables import table_console
from construction_twin.msg import Plan as PlanMsg
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

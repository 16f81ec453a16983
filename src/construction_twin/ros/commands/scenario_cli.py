"""Command line of `scenario`: judges a recorded run again, and makes the table of many. Runs without a ROS master."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from rich.console import Console

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.robot.description import read_robot_files
from construction_twin.ros.commands.evaluate import package_file
from construction_twin.ros.commands.scenario import judge_folder
from construction_twin.scenario.definition import read_scenario
from construction_twin.scenario.table import markdown_table, print_verdict, put_into, read_verdicts

XACRO, DESCRIPTION = "urdf/kr120r2500.urdf.xacro", "config/kr120.yaml"


def main(arguments: list[str]) -> int:
    """Do what the options say; return the exit code: 0, 1 when a scenario failed or after a sentence."""
    options = _parser().parse_args(arguments)
    console = Console(highlight=False, markup=False)
    try:
        if options.judge:
            return _judge(options, console)
        verdicts = read_verdicts(options.table)
        table = markdown_table(verdicts)
        print(table)
        if options.into:
            options.into.write_text(put_into(options.into.read_text(), table, str(options.into)))
    except (ConstructionTwinError, OSError) as error:
        print(f"scenario: {error}", file=sys.stderr)
        return 1
    return 0 if all(run["passed"] for runs in verdicts.values() for run in runs) else 1


def _judge(options: argparse.Namespace, console: Console) -> int:
    robot = read_robot_files(
        options.robot_xacro or package_file(XACRO), options.robot_config or package_file(DESCRIPTION)
    )
    name = options.judge.resolve().name
    scenario = read_scenario(options.scenario or package_file(f"config/scenarios/{name}.yaml"))
    verdict = judge_folder(options.judge, scenario, robot, options.decimals, None)
    print_verdict(verdict, console)
    return 0 if verdict.passed else 1


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="scenario", description="Judge recorded scenarios; without options it is the node of scenario.launch."
    )
    what = parser.add_mutually_exclusive_group(required=True)
    what.add_argument("--table", type=Path, metavar="DIR", help="print the table of all verdicts below DIR")
    what.add_argument("--judge", type=Path, metavar="DIR", help="judge the recording in DIR again")
    parser.add_argument("--into", type=Path, metavar="FILE", help="also put the table between the marks in FILE")
    parser.add_argument(
        "--scenario", type=Path, metavar="FILE", help="scenario YAML (default: the shipped one of DIR's name)"
    )
    parser.add_argument("--decimals", type=int, default=3, help="decimals of a degree on the wire [3]")
    parser.add_argument("--robot-xacro", type=Path, metavar="FILE", help=f"URDF or xacro (default: {XACRO})")
    parser.add_argument("--robot-config", type=Path, metavar="FILE", help=f"robot YAML (default: {DESCRIPTION})")
    return parser

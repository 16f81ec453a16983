"""Command line: compares the motor currents of a run with those of a reference run of the same plan. Runs without a ROS master."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import rospy
from rich.console import Console

from construction_twin.core.files import write_whole
from construction_twin.evaluation.bag import read_recording
from construction_twin.evaluation.current_tables import currents_csv, render_currents
from construction_twin.evaluation.currents import CurrentRun, compare_currents, runs_of, same_plan, summary_of
from construction_twin.evaluation.recording import Recording
from construction_twin.ros.commands.bag_report import bag_parser, read_plans, report_bag
from construction_twin.ros.commands.evaluate import shipped_robot


def main(arguments: list[str] | None = None) -> int:
    """Compare the bags named on the command line.

    Args:
        arguments: Default: the process's, without what roslaunch adds.

    Returns:
        0, whatever the comparison shows; 1 after a sentence on standard error, where nothing can be compared.
    """
    options = _parser().parse_args(rospy.myargv()[1:] if arguments is None else arguments)

    def write(recording: Recording, directory: Path, console: Console) -> list[Path]:
        known = _runs(options.reference, read_recording(options.reference, recording.robot), recording.robot)
        pair = same_plan(known, _runs(options.bag, recording, recording.robot))
        comparison = compare_currents(*pair, any_pace=options.any_pace)
        # matplotlib takes a second
        from construction_twin.evaluation.current_figure import current_figure

        summary = summary_of(comparison)
        directory.mkdir(parents=True, exist_ok=True)
        files = [directory / f"currents.{ending}" for ending in ("json", "csv", "png")]
        write_whole(files[0], json.dumps(summary, indent=2, allow_nan=False) + "\n")
        write_whole(files[1], currents_csv(summary))
        current_figure(comparison).savefig(files[2])
        robot = shipped_robot(recording.joint_names)
        linear = [joint for joint, slides in zip(robot.joint_names, robot.linear) if slides] if robot else []
        render_currents(summary, linear, console)
        return files

    return report_bag("currents", options, write)


def _runs(bag: Path, recording: Recording, robot: str) -> list[CurrentRun]:
    return runs_of(str(bag), recording, read_plans(bag, robot))


def _parser() -> argparse.ArgumentParser:
    parser = bag_parser(
        "currents",
        "Compare the motor currents of a run with those of a reference run of the same plan: a table, a figure, a file per form. "
        "The two are aligned by where the arm was on the plan. Exit code 1 when they cannot be compared.",
        "a bag with at least twin, physical, physical/current, next and command/joint_states, plan and execution",
        "_currents",
    )
    parser.add_argument(
        "--reference", type=Path, required=True, metavar="BAG", help="a bag of the reference run, with the same topics"
    )
    parser.add_argument(
        "--any-pace", action="store_true", help="also compare setpoints that the two runs passed at another pace"
    )
    return parser

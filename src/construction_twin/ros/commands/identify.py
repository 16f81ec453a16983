"""Command line: finds how the arm's servos answer from a bag, and writes it for the monitor. Runs without a ROS master."""

from __future__ import annotations

import argparse
from pathlib import Path

import rospy
from rich import box
from rich.console import Console
from rich.table import Table

from construction_twin.core.files import write_whole
from construction_twin.evaluation.driven import cycle_of, drives_of
from construction_twin.evaluation.recording import Recording
from construction_twin.ros.commands.bag_report import bag_parser, report_bag
from construction_twin.servo.file import servo_file
from construction_twin.servo.identification import Identified, identify

#: Columns of the printed table: what they are called, and in which unit.
COLUMNS = (
    "joint", "omega, rad/s", "zeta", "delay, cycles", "velocity, ms", "acceleration, ms^2", "backlash, mrad",
    "lag, ms", "residual rms, urad", "largest, urad",
)  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Identify the servos from the bag named on the command line.

    Args:
        arguments: Default: the process's, without what roslaunch adds.

    Returns:
        0, or 1 after a sentence on standard error.
    """
    options = _parser().parse_args(rospy.myargv()[1:] if arguments is None else arguments)

    def write(recording: Recording, directory: Path, console: Console) -> list[Path]:
        cycle_ns = cycle_of(recording)
        drives = drives_of(recording, cycle_ns)
        found = identify(recording.joint_names, drives, cycle_ns)
        directory.mkdir(parents=True, exist_ok=True)
        path = directory / "servos.yaml"
        write_whole(path, servo_file(found.joints, cycle_ns, options.bag.name))
        console.print(servo_table(found))
        return [path]

    return report_bag("identify", options, write)


def servo_table(found: Identified) -> Table:
    """Return what was found, one row per joint: each fitted parameter with its standard deviation; what was not needed is empty."""
    table = Table(title=f"servos, cycle {found.cycle_ns // 1_000_000} ms; +- one standard deviation", box=box.SIMPLE)
    for column in COLUMNS:
        table.add_column(column, justify="left" if column == "joint" else "right")
    for each in found.joints:
        scales = {"omega": 1.0, "zeta": 1.0, "delay": 1.0, "velocity": 1e3, "acceleration": 1e6, "backlash": 1e3}
        cells = [
            f"{scale * getattr(each.servo, name):.4g} +- {scale * each.deviations[name]:.1g}"
            if name in each.deviations
            else ""
            for name, scale in scales.items()
        ]
        lag = f"{1e3 * each.servo.lag(found.cycle_ns * 1e-9):.3f} +- {1e3 * each.lag_error:.1g}"
        table.add_row(each.name, *cells, lag, f"{1e6 * each.residual_rms:.1f}", f"{1e6 * each.residual_max:.1f}")
    return table


def _parser() -> argparse.ArgumentParser:
    return bag_parser(
        "identify",
        "Find how the arm's servos answer their targets: a file for the argument servo_model.",
        "a bag with at least twin, physical, physical/feedback and command/joint_states",
        "_servos",
    )

"""Command line: finds how the arm's servos answer from a bag, and writes it for the monitor. Runs without a ROS master."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rospy
from rich import box
from rich.console import Console
from rich.table import Table

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.files import write_atomically
from construction_twin.core.units import NANOSECONDS
from construction_twin.evaluation.alignment import TwinPath
from construction_twin.evaluation.recording import Recording
from construction_twin.extensions.physics.identification import (
    NO_MOTION,
    IdentifiedJoint,
    RecordedMotion,
    identify,
    servo_file,
)
from construction_twin.ros.commands.evaluate import bag_parser, report_bag
from construction_twin.servo.model import PACE, STEADY

#: An arm whose target has not changed for so long rests [ns].
RESTED = NANOSECONDS // 5
#: Shortest stretch that is used [cycles].
SHORTEST = 100


def cycle_of(recording: Recording) -> int:
    """Return the controller's cycle [ns], in whole ms: by how much command stamps advance from state to state, mostly."""
    feedback = recording.feedback
    if feedback is not None and len(feedback) > 1:
        steps = np.diff(feedback.seq.astype(np.int64)) == 1
        known = (feedback.command_stamps[1:] > 0) & (feedback.command_stamps[:-1] > 0)
        advances = np.diff(feedback.command_stamps)[steps & known]
        if len(advances) and np.median(advances) >= NANOSECONDS // 1000:
            return round(float(np.median(advances)) * 1000 / NANOSECONDS) * (NANOSECONDS // 1000)
    raise ConstructionTwinError(NO_MOTION)


def recorded_motions(recording: Recording, cycle_ns: int) -> list[RecordedMotion]:
    """Return the stretches of a recording in which the controller's targets are known, each from rest.

    A command stamp says which target the controller took; a reply that did not arrive shows as a stamp that comes twice. Rows where
    the gateway braked or stretched the motion, or the gate was closed, drive the model on and are not judged.

    Args:
        cycle_ns: The controller's cycle [ns].
    """
    feedback, command = recording.feedback, recording.command
    if feedback is None or command is None:
        return []
    base = int(command.stamps.min())
    path = TwinPath(command, base)
    times = (feedback.command_stamps - base).astype(float)
    known = (feedback.command_stamps > 0) & path.covers(times)
    targets = np.zeros_like(feedback.positions)
    targets[known] = path(times[known])
    advances = np.diff(feedback.command_stamps, prepend=0)
    follows = known & np.concatenate([[False], known[:-1]]) & (np.diff(feedback.seq.astype(np.int64), prepend=0) == 1)
    steady = _lasts(np.abs(advances - cycle_ns) <= cycle_ns // PACE, STEADY // cycle_ns)
    counts = steady & _lasts(_in_sync(recording), STEADY // cycle_ns)
    drives = []
    for begin, end in _stretches(known, follows):
        rows = slice(begin, end)
        rest = _first_rest(targets[rows], RESTED // cycle_ns)
        if rest is not None and end - begin - rest >= SHORTEST:
            rows = slice(begin + rest, end)
            drives.append(RecordedMotion(targets[rows], feedback.positions[rows], counts[rows]))
    return drives


def _stretches(known: np.ndarray, follows: np.ndarray) -> list[tuple[int, int]]:
    """Return begin and end of each run of rows that are known and each follow the one before."""
    begins = np.flatnonzero(known & ~follows)
    ends = np.flatnonzero(~known | ~follows)
    return [(begin, int(min(ends[ends > begin], default=len(known)))) for begin in begins.tolist()]


def _first_rest(targets: np.ndarray, cycles: int) -> int | None:
    """Return the first row after so many cycles with an unchanged target; None when there is none."""
    still = np.concatenate([[True], (np.diff(targets, axis=0) == 0.0).all(axis=1)])
    rested = np.flatnonzero(_lasts(still, cycles))
    return int(rested[0]) if len(rested) else None


def _lasts(holds: np.ndarray, rows: int) -> np.ndarray:
    """Return at which rows something has held for so many rows, shape (m,), bool."""
    number = np.arange(len(holds))
    broken = np.maximum.accumulate(np.where(holds, -1, number))
    return number - broken >= rows


def _in_sync(recording: Recording) -> np.ndarray:
    """Return at which rows of the feedback the gate was open, as far as it reported, shape (m,), bool."""
    changes = [change for change in recording.changes if change.source == "gate"]
    stamps = recording.feedback.stamps  # type: ignore[union-attr]  # `recorded_motions` has seen to that
    if not changes:
        return np.ones(len(stamps), bool)
    at = np.searchsorted([change.stamp for change in changes], stamps, side="right") - 1
    open_after = np.array([change.state == "IN_SYNC" for change in changes])
    return (at >= 0) & open_after[np.maximum(at, 0)]


#: Columns of the printed table: what they are called, and in which unit.
COLUMNS = (
    "joint", "omega, rad/s", "zeta", "delay, cycles", "velocity, ms", "acceleration, ms^2", "backlash, mrad",
    "lag, ms", "residual rms, urad", "largest, urad",
)  # fmt: skip


def main(arguments: list[str] | None = None) -> int:
    """Identify the servos from the bag named on the command line; return 0, or 1 after a sentence on standard error."""
    parser = bag_parser(
        "evaluate identify",
        "Find how the arm's servos answer their targets: a file for the argument servo_model.",
        "a bag with at least twin, physical, physical/feedback and command/joint_states",
        "_servos",
    )
    options = parser.parse_args(rospy.myargv()[1:] if arguments is None else arguments)

    def write(recording: Recording, directory: Path, console: Console) -> list[Path]:
        cycle_ns = cycle_of(recording)
        drives = recorded_motions(recording, cycle_ns)
        found = identify(recording.joint_names, drives, cycle_ns)
        directory.mkdir(parents=True, exist_ok=True)
        path = directory / "servos.yaml"
        write_atomically(path, servo_file(found, cycle_ns, options.bag.name))
        console.print(servo_table(found, cycle_ns))
        return [path]

    return report_bag("evaluate identify", options, write)


def servo_table(joints: Sequence[IdentifiedJoint], cycle_ns: int) -> Table:
    """Return what was found, one row per joint: each fitted parameter with its standard deviation; what was not needed is empty."""
    table = Table(title=f"servos, cycle {cycle_ns // 1_000_000} ms; +- one standard deviation", box=box.SIMPLE)
    for column in COLUMNS:
        table.add_column(column, justify="left" if column == "joint" else "right")
    for each in joints:
        scales = {"omega": 1.0, "zeta": 1.0, "delay": 1.0, "velocity": 1e3, "acceleration": 1e6, "backlash": 1e3}
        cells = [
            f"{scale * getattr(each.servo, name):.4g} +- {scale * each.deviations[name]:.1g}"
            if name in each.deviations
            else ""
            for name, scale in scales.items()
        ]
        lag = f"{1e3 * each.servo.lag(cycle_ns * 1e-9):.3f} +- {1e3 * each.lag_error:.1g}"
        table.add_row(each.name, *cells, lag, f"{1e6 * each.residual_rms:.1f}", f"{1e6 * each.residual_max:.1f}")
    return table

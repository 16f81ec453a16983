"""work check: what the arm can do of a building model, before anything starts. Runs without a ROS master.

Prints one line per task and writes check.json and check.png. Exit code 0: every task is possible; 1: some are not; 2: it could
not be checked, after one sentence on standard error.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from construction_twin.core.errors import ConstructionTwinError, spoken
from construction_twin.core.extras import check_extras
from construction_twin.core.files import check_writable, write_whole
from construction_twin.core.sentences import Sentence
from construction_twin.evaluation.tables import table_console
from construction_twin.kinematics.chain import Chain
from construction_twin.robot.description import RobotModel
from construction_twin.ros.commands.evaluate import package_file
from construction_twin.ros.commands.work_check_pool import Arm, Checked, Setup, check_all
from construction_twin.scene.objects import SceneObject
from construction_twin.work.building import BuildingModel
from construction_twin.work.check_report import as_json, cell_picture, row, why
from construction_twin.work.ifc.reading import read_building
from construction_twin.work.proposed_schedule import propose
from construction_twin.work.schedule import Job, Schedule
from construction_twin.work.site import Site, pose_of, read_site
from construction_twin.work.standing import check_placement
from construction_twin.work.worker import WorkerError

#: By how much bodies may be larger than their element without being told [m].
_TOLD = 0.0005
#: What the exit codes mean.
ALL, SOME, NOT_CHECKED = 0, 1, 2


@dataclass(frozen=True, eq=False)
class _Work:
    """A model with its order and cell, ready to be checked."""

    building: BuildingModel
    site: Site
    schedule: Schedule
    jobs: tuple[Job, ...]
    notes: tuple[str, ...]


def main(arguments: list[str]) -> int:
    """Check the model named on the command line.

    Returns:
        0, 1 or 2, see above.
    """
    options = _parser().parse_args(arguments)
    console = table_console()
    directory = options.output or options.model.with_name(options.model.stem + "_check")
    try:
        check_extras("work")
        check_writable(directory)
        arm = _arm(options)
        robot = arm.robot()
        work = _work(options, robot)
        with tempfile.TemporaryDirectory(prefix="work_check_") as folder:
            pieces, inexact = _pieces(work, Path(folder))
            # needs the packages of `check_extras`
            from construction_twin.work.standing import standing

            # what is doubted, or has no usable body, stands as an obstacle
            stands = standing(work.building, pieces, work.site, robot, Path(folder))
            notes = tuple(map(work.building.called, (*work.notes, *inexact, *stands.notes)))
            for note in notes:
                console.print(note, markup=False, soft_wrap=True)
            setup = Setup(
                arm, options.cell, work.building, pieces, work.jobs, robot=options.robot, standing=stands.pieces,
                removals=work.schedule.removals,
            )  # fmt: skip
            checked = _remarked(_check(setup, options.processes, console), work)
            about = {
                "model": work.building.file, "digest": work.building.digest, "cell": str(options.cell), "robot": robot.name,
                "proposed": work.schedule.proposed, "seconds": checked.seconds, "rss_mb": checked.rss_mb, "notes": notes,
            }  # fmt: skip
            picture = cell_picture(checked.tasks, setup.layout(robot))
            contents: dict[str, str | bytes] = {"check.json": as_json(about, checked.tasks), "check.png": picture}
            for name, content in contents.items():
                write_whole(directory / name, content)
    except (ConstructionTwinError, OSError) as error:
        ended = isinstance(error, WorkerError) and not error.kind
        said = "a process was ended, perhaps for want of memory; try --processes 1" if ended else spoken(error)
        print(f"work check: {said}", file=sys.stderr)
        return NOT_CHECKED
    _print(console, checked, [directory / name for name in contents])
    return ALL if all(task.possible for task in checked.tasks) else SOME


def _work(options: argparse.Namespace, robot: RobotModel) -> _Work:
    building = read_building(options.model)
    site = read_site(options.cell)
    missing = proposed = not building.tasks
    if proposed:
        building = propose(building).applied(building)
    schedule = Schedule.of(building, proposed, site.recipes.process)
    proposed = schedule.proposed
    base = site.base(building).id if site.file.base_element else ""
    tool = pose_of(site.tool.tool.tool0_T_tcp)
    chain = Chain(robot)
    reach = chain.reach + float(np.linalg.norm(chain.shoulder)) + float(np.linalg.norm(tool.position))
    notes = [*building.notes, *schedule.notes, *check_placement(building, site.model_T_base(building), reach, base)]
    if proposed:
        notes.insert(
            0,
            Sentence("work.order.proposed_all" if missing else "work.order.proposed_some"),
        )
    return _Work(building, site, schedule, schedule.jobs, tuple(notes))


def _pieces(work: _Work, folder: Path) -> tuple[dict[str, tuple[SceneObject, ...]], tuple[str, ...]]:
    """Return the bodies of the elements that are placed, of those that have any, and what is not exact or missing."""
    # needs the packages of `check_extras`
    from construction_twin.work.element_bodies import element_shapes

    elements = map(work.building.element, dict.fromkeys(job.element for job in work.jobs))
    sure = [element for element in elements if element.bodies and not element.doubt]
    shapes, failures = element_shapes(sure, folder)
    notes = [failure.sentence for failure in failures.values()]
    notes += [
        Sentence(
            "work.body.larger_checked",
            element=name,
            excess=1e3 * shape.excess,
        )
        for name, shape in shapes.items()
        if shape.excess > _TOLD
    ]
    return {name: shape.objects for name, shape in shapes.items()}, tuple(notes)


def _check(setup: Setup, processes: int, console: Console) -> Checked:
    columns = (TextColumn("checking"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, auto_refresh=False) as progress:
        bar = progress.add_task("check", total=len(setup.numbers))
        progress.refresh()
        return check_all(setup, processes, lambda _: progress.update(bar, advance=1, refresh=True))


def _remarked(checked: Checked, work: _Work) -> Checked:
    remarks = {job: tuple(map(work.building.called, said)) for job, said in work.schedule.remarks.items()}
    return replace(checked, tasks=tuple(replace(task, remarks=remarks.get(task.job, ())) for task in checked.tasks))


#: Headings of the table in the terminal; whether the column holds words; its greatest width, 0: what is left of the terminal.
_COLUMNS = {
    "#": (False, 4), "task": (True, 20), "possible": (False, 8), "grip": (True, 0), "track\nm": (False, 6),
    "clear\nmm": (False, 5), "time\ns": (False, 5), "why": (True, 9),
}  # fmt: skip
#: Width of all columns but `grip` and `why`, with what is between them.
_BESIDE_GRIP = 66


def _print(console: Console, checked: Checked, files: Iterable[Path]) -> None:
    impossible = any(not task.possible for task in checked.tasks)
    # numbers are shown whole; in a narrow terminal words are cut
    table = Table(box=box.SIMPLE, padding=(0, 1, 0, 0))
    widest = max(10, console.width - _BESIDE_GRIP - (_COLUMNS["why"][1] + 2) * impossible)
    for heading, (words, most) in _COLUMNS.items():
        if heading != "why" or impossible:
            justify: Literal["left", "right"] = "left" if words else "right"
            table.add_column(heading, justify=justify, no_wrap=True, overflow="ellipsis", max_width=most or widest)
    for task in checked.tasks:
        table.add_row(*row(task)[: len(table.columns)], style="" if task.possible else "red")
    console.print(table)
    for task in checked.tasks:
        about = f"{task.number + 1} {task.name} ({task.element_name or task.element})"
        if not task.possible:
            console.print(f"{about}: {why(task)}", markup=False, soft_wrap=True)
        for remark in task.remarks:
            console.print(f"{about}, note: {remark}", markup=False, soft_wrap=True)
    count = sum(task.possible for task in checked.tasks)
    console.print(
        f"{count} of {len(checked.tasks)} tasks are possible; checked in {checked.seconds:.0f} s, {checked.rss_mb:.0f} MB"
    )
    for file in files:
        console.print(str(file), markup=False, soft_wrap=True)


def _arm(options: argparse.Namespace) -> Arm:
    kind = ("kr120_track", "kr120_track") if options.track else ("kr120r2500", "kr120")
    return Arm(
        options.robot_xacro or package_file(f"urdf/{kind[0]}.urdf.xacro"),
        options.robot_config or package_file(f"config/{kind[1]}.yaml"),
        options.self_collision or package_file(f"config/{kind[1]}_self_collision.yaml"),
        package_file("config/planner.yaml"),
        options.robot_xacro_args,
    )


def _processes(text: str) -> int:
    value = int(text)
    if not 1 <= value <= 64:
        raise argparse.ArgumentTypeError(Sentence("view.argument.range", value=value, lowest=1, largest=64))
    return value


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="work check", description="What the arm can do of a building model: a table, check.json and check.png."
    )
    parser.add_argument("model", type=Path, help="an IFC file")
    parser.add_argument(
        "--cell", type=Path, required=True, metavar="FILE", help="cell file, as config/work/timber_panel.yaml"
    )
    parser.add_argument("--track", action="store_true", help="the KR 120 on its track (default: without)")
    parser.add_argument("--robot", default="", metavar="NAME", help="only tasks that this robot may do, e.g. kr120")
    parser.add_argument("--output", type=Path, metavar="DIR", help="folder for the files (default: MODEL + _check)")
    parser.add_argument(
        "--processes", type=_processes, default=max(1, min(8, os.cpu_count() or 1)), metavar="N",
        help="tasks that are checked at once (default: one per core, at most 8)",
    )  # fmt: skip
    parser.add_argument("--robot-xacro", type=Path, metavar="FILE", help="URDF or xacro of another arm")
    parser.add_argument("--robot-xacro-args", default="", metavar="'NAME=VALUE ...'", help="arguments of the xacro")
    parser.add_argument("--robot-config", type=Path, metavar="FILE", help="its robot YAML")
    parser.add_argument("--self-collision", type=Path, metavar="FILE", help="its self-collision file")
    return parser


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

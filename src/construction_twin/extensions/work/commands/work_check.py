"""work check: what the arm can do of a building model, before anything starts. Runs without a ROS master.

Prints one line per task and writes check.png. Exit code 0: every task is possible; 1: some are not; 2: it could
not be checked, after one sentence on standard error.
"""

from __future__ import annotations

import argparse
import io
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

import yaml
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from construction_twin.core.errors import ConstructionTwinError, command_message
from construction_twin.core.extensions import check_extras
from construction_twin.core.files import check_writable, write_atomically
from construction_twin.core.share import share_file
from construction_twin.core.worker import Worker, WorkerError, rss_mb
from construction_twin.evaluation.tables import table_console
from construction_twin.extensions.work.loaded_model import WORKER, LoadedModel
from construction_twin.robot.description import read_robot_files

if TYPE_CHECKING:
    from construction_twin.extensions.work.worker_functions import CheckedTask

#: Of every planning.
SEED = 1
#: What the exit codes mean.
ALL, SOME, NOT_CHECKED = 0, 1, 2


def main(arguments: list[str]) -> int:
    """Check the model named on the command line; return the exit code."""
    options = _parser().parse_args(arguments)
    console = table_console()
    picture = (options.output or options.model.with_name(options.model.stem + "_check")) / "check.png"
    try:
        check_extras("work")
        check_writable(picture.parent)
        with tempfile.TemporaryDirectory(prefix="work_check_") as folder:
            checked = _check(options, folder, console)
            schedule = checked.loaded.schedule
            proposed = (
                "This order, or a part of it, is proposed from the model's geometry, and a person must accept it."
            )
            for note in (*([proposed] if schedule.proposed else []), *checked.loaded.notes, *schedule.notes):
                console.print(note, markup=False, soft_wrap=True)
            write_atomically(picture, cell_picture(checked.tasks, checked.loaded))
    except (ConstructionTwinError, OSError) as error:
        ended = isinstance(error, WorkerError) and not error.kind
        said = "a process was ended, perhaps for want of memory; try --processes 1" if ended else command_message(error)
        print(f"work check: {said}", file=sys.stderr)
        return NOT_CHECKED
    _print(console, checked)
    console.print(str(picture), markup=False, soft_wrap=True)
    return ALL if all(task.possible for task in checked.tasks) else SOME


@dataclass(frozen=True)
class Checked:
    """What was found, in the order of the schedule; `rss_mb`: of all processes, what they share counted in each."""

    loaded: LoadedModel
    tasks: tuple[CheckedTask, ...]
    seconds: float
    rss_mb: float


def check_all(processes: int, console: Console | None = None, robot_name: str = "", **arguments: Any) -> Checked:
    """Check every job of a model that a robot (empty: any) may do, in several processes; `arguments`: of `load_model`.

    Raises:
        WorkerError: With an empty `kind` if a process was ended, by want of memory for instance.
    """
    began = time.monotonic()
    workers = [Worker(WORKER) for _ in range(processes)]
    idle: SimpleQueue[Worker] = SimpleQueue()
    found: dict[int, CheckedTask] = {}
    memory: dict[int, float] = {}

    def check(number: int) -> tuple[CheckedTask, int, float]:
        worker = idle.get()
        try:
            return worker.ask("check", number=number)
        finally:
            idle.put(worker)

    with ThreadPoolExecutor(processes) as threads:
        try:
            # the others find in the cache what the first has read
            loaded: LoadedModel = workers[0].ask("load_model", **arguments)
            list(threads.map(lambda worker: worker.ask("load_model", **arguments), workers[1:]))
            for worker in workers:
                idle.put(worker)
            jobs = enumerate(loaded.schedule.jobs)
            numbers = [n for n, job in jobs if not robot_name or not job.robots or robot_name in job.robots]
            futures = as_completed([threads.submit(check, number) for number in numbers])
            for future in track(
                futures, "checking", len(numbers), console=console, transient=True, disable=not console
            ):
                task, process, rss = future.result()
                found[task.number], memory[process] = task, rss
        finally:
            threads.shutdown(wait=False, cancel_futures=True)
            for worker in workers:
                worker.close()
    tasks = tuple(found[number] for number in sorted(found))
    return Checked(loaded, tasks, time.monotonic() - began, rss_mb() + sum(memory.values()))


def _check(options: argparse.Namespace, folder: str, console: Console) -> Checked:
    kind = ("kr120_track", "kr120_track") if options.track else ("kr120r2500", "kr120")
    xacro = options.robot_xacro or share_file(f"urdf/{kind[0]}.urdf.xacro")
    config = options.robot_config or share_file(f"config/{kind[1]}.yaml")
    return check_all(
        options.processes,
        console,
        options.robot,
        model=str(options.model),
        cell=str(options.cell),
        robot=read_robot_files(xacro, config, options.robot_xacro_args),
        self_collision=str(options.self_collision or share_file(f"config/{kind[1]}_self_collision.yaml")),
        # the same model and cell give the same findings
        planner={**yaml.safe_load(share_file("config/planner.yaml").read_text(encoding="utf-8")), "seed": SEED},
        cache=folder,
    )


def _print(console: Console, checked: Checked) -> None:
    table = Table(box=box.SIMPLE, padding=(0, 1, 0, 0))
    for heading in ("#", "task", "possible", "grip", "track m", "clear mm", "time s", "why"):
        # numbers are shown whole; in a narrow terminal words are cut
        words = heading in ("task", "grip", "why")
        table.add_column(heading, justify="left" if words else "right", no_wrap=words, overflow="ellipsis")
    lines: list[str] = []
    for task in checked.tasks:
        numbers = zip(
            ("{:.2f}", "{:.0f}", "{:.1f}"),
            (task.track, None if task.clearance is None else 1e3 * task.clearance, task.duration),
        )
        shown = ("" if value is None else form.format(value) for form, value in numbers)
        why = "" if task.possible else task.stage or task.reason[:30]
        row = (str(task.number + 1), task.name, "yes" if task.possible else "no", task.grip, *shown, why)
        table.add_row(*row, style="" if task.possible else "red")
        about = f"{task.number + 1} {task.name} ({task.element_name or task.element})"
        if not task.possible:
            lines.append(f"{about}: {task.stage}: {task.reason}" if task.stage else f"{about}: {task.reason}")
    console.print(table)
    for line in lines:
        console.print(line, markup=False, soft_wrap=True)
    count = sum(task.possible for task in checked.tasks)
    console.print(
        f"{count} of {len(checked.tasks)} tasks are possible; checked in {checked.seconds:.0f} s, {checked.rss_mb:.0f} MB"
    )


def cell_picture(tasks: Sequence[CheckedTask], loaded: LoadedModel) -> bytes:
    """Return a PNG of the cell from above."""
    figure = Figure(figsize=(9, 7))
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(aspect="equal", xlabel="x in the base, m", ylabel="y in the base, m")
    axes.set_title("triangle: base, grey: stock, green: can be placed, red: cannot")
    axes.plot(0.0, 0.0, "k^")
    for task in tasks:
        facts, slot = loaded.elements[task.element], loaded.stock.slots.get(task.element)
        if slot is not None:
            axes.plot(*slot.base_T_element.position[:2], ".", color="grey")
        axes.plot(*facts.base_T_goal.position[:2], ".", color="green" if task.possible else "red")
    buffer = io.BytesIO()
    figure.savefig(buffer)
    return buffer.getvalue()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="work check", description="What the arm can do of a building model: a table and check.png."
    )
    parser.add_argument("model", type=Path, help="an IFC file")
    parser.add_argument(
        "--cell", type=Path, required=True, metavar="FILE", help="cell file, as config/work/timber_panel.yaml"
    )
    parser.add_argument("--track", action="store_true", help="the KR 120 on its track (default: without)")
    parser.add_argument("--robot", default="", metavar="NAME", help="only tasks that this robot may do, e.g. kr120")
    parser.add_argument("--output", type=Path, metavar="DIR", help="folder for the picture (default: MODEL + _check)")
    parser.add_argument(
        "--processes", type=int, choices=range(1, 65), default=max(1, min(8, os.cpu_count() or 1)), metavar="N",
        help="tasks that are checked at once (default: one per core, at most 8)",
    )  # fmt: skip
    parser.add_argument("--robot-xacro", type=Path, metavar="FILE", help="URDF or xacro of another arm")
    parser.add_argument("--robot-xacro-args", default="", metavar="'NAME=VALUE ...'", help="arguments of the xacro")
    parser.add_argument("--robot-config", type=Path, metavar="FILE", help="its robot YAML")
    parser.add_argument("--self-collision", type=Path, metavar="FILE", help="its self-collision file")
    return parser

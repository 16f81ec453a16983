"""Work benchmark: how long `work check` takes and what memory, and whether every task of the samples can be planned.

    python benchmarks/work.py --output results/bench/work.json

`check`: rows of 10, 50 and 200 bricks as copies of the sample's, in the brick wall's cell with the stock filled again, all
processes together. `samples`: every task of both sample models, in order, each in the scene that its turn finds; success is the
part of the tasks that can be planned, and the median is that of the planning of one task, one at a time.
"""

from __future__ import annotations

import argparse
import os
import statistics
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml
from link_world import environment, write_figures

from construction_twin.extensions.work.building import BuildingModel, Element, Task
from construction_twin.extensions.work.commands.work_check import SEED, Checked, check_all
from construction_twin.extensions.work.ifc.reading import read_building
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.description import read_robot_files

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("ifcopenshell", "numpy", "coal", "ompl", "pin", "toppra")
SAMPLES = ("timber_panel", "brick_wall")
#: Bricks of one course of the wall that is checked.
COURSE = 10


def sample(name: str) -> BuildingModel:
    """Return a sample model."""
    return read_building(ROOT / "models" / f"{name}.ifc")


def cell(name: str) -> Path:
    """Return a sample's cell file."""
    return ROOT / "config/work" / f"{name}.yaml"


def wall(count: int) -> BuildingModel:
    """Return a straight wall of so many of the sample's bricks, course by course, one task each."""
    model = sample("brick_wall")
    brick = next(element for element in model.elements.values() if element.bodies)
    bricks = [_brick(brick, number) for number in range(count)]
    tasks = {one.id: Task(one.id, one.name, products=(one.id,)) for one in bricks}
    return replace(model, elements={one.id: one for one in bricks}, tasks=tasks, sequences=())


def _brick(brick: Element, number: int) -> Element:
    course, place = divmod(number, COURSE)
    at = brick.model_T_element.position + np.array([0.25 * place + 0.125 * (course % 2), 0.0, 0.071 * course])
    pose = Pose(at, brick.model_T_element.rotation)
    return replace(brick, id=f"brick{number:04d}", name=f"Brick {number + 1}", model_T_element=pose)


def refilled(folder: Path) -> Path:
    """Write the brick wall's cell with a rack that is filled again, and return its path."""
    content = yaml.safe_load(cell("brick_wall").read_text(encoding="utf-8"))
    for key in ("tool", "recipes", "scene"):
        content[key] = str((cell("brick_wall").parent / content[key]).resolve())
    content["racks"]["bricks"]["refill"] = True
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def check(model: BuildingModel, where: Path, folder: str, processes: int) -> Checked:
    """Check a model with the track, as the command does."""
    return check_all(
        processes,
        model=model,
        cell=str(where),
        robot=read_robot_files(ROOT / "urdf/kr120_track.urdf.xacro", ROOT / "config/kr120_track.yaml"),
        self_collision=str(ROOT / "config/kr120_track_self_collision.yaml"),
        planner={**yaml.safe_load((ROOT / "config/planner.yaml").read_text(encoding="utf-8")), "seed": SEED},
        cache=folder,
    )


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description="Benchmark of work from a building model.")
    parser.add_argument("--output", type=Path, default=ROOT / "results/bench/work.json", metavar="FILE")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1, help="default: one per core")
    parser.add_argument("--counts", type=int, nargs="*", default=[10, 50, 200], help="default: 10 50 200")
    options = parser.parse_args()
    figures: dict = {"environment": environment(PACKAGES), "check": {}, "samples": {}}
    for count in options.counts:
        with tempfile.TemporaryDirectory() as folder:
            checked = check(wall(count), refilled(Path(folder)), folder, options.processes)
        possible = sum(task.possible for task in checked.tasks)
        rss_mb = round(checked.rss_mb, 1)
        figures["check"][str(count)] = {"s": round(checked.seconds, 2), "rss_mb": rss_mb, "possible": possible}
        print(f"check.{count}: {figures['check'][str(count)]}", flush=True)
    for name in SAMPLES:
        with tempfile.TemporaryDirectory() as folder:
            checked = check(sample(name), cell(name), folder, 1)
        figures["samples"][name] = {
            "success": sum(task.possible for task in checked.tasks) / len(checked.tasks),
            "planning_s_median": round(statistics.median(task.planning for task in checked.tasks), 3),
        }
        for task in checked.tasks:
            if not task.possible:
                print(f"  {task.name}: {task.stage}: {task.reason}", flush=True)
    write_figures(options.output, figures)


if __name__ == "__main__":
    main()

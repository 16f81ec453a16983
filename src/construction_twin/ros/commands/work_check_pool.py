"""The tasks of a building model, checked in several processes at once. Knows no ROS and no terminal.

The processes are forked from the caller with one planner each and take one task after the other. What a process needs grows with
the elements of one scene, not with the number of tasks.
"""

from __future__ import annotations

import multiprocessing
import os
import resource
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml

from construction_twin.planning.planner import PlannerSettings
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.scene.objects import SceneObject
from construction_twin.scene.self_collision import read_self_collision
from construction_twin.work.building import BuildingModel
from construction_twin.work.check import CheckedTask, Checker, reason_kind
from construction_twin.work.schedule import Job
from construction_twin.work.site import read_site
from construction_twin.work.site_scene import Layout

#: Most time for the changes of one task [s].
TASK_CHANGES = 15.0


@dataclass(frozen=True)
class Arm:
    """The files that say what the arm is."""

    xacro: Path
    config: Path
    self_collision: Path
    planner: Path
    xacro_args: str = ""

    def robot(self) -> RobotModel:
        """Return the arm."""
        return read_robot_files(self.xacro, self.config, self.xacro_args)


@dataclass(frozen=True, eq=False)
class Setup:
    """All that a process needs.

    Attributes:
        pieces: Of the elements that have geometry.
        jobs: In the order of the schedule.
        changes: For all changes that are tried, of all tasks together [s]; 0: none are tried.
        robot: Only jobs that this robot may do are checked; empty: all. The others' elements are placed in their turn as well.
        standing: See `Layout`.
        removals: What people take down before jobs that wait for it.
    """

    arm: Arm
    cell: Path
    building: BuildingModel
    pieces: dict[str, tuple[SceneObject, ...]]
    jobs: tuple[Job, ...]
    seed: int = 1
    changes: float = 60.0
    robot: str = ""
    standing: dict[str, tuple[SceneObject, ...]] = field(default_factory=dict)
    removals: tuple[Job, ...] = ()

    @property
    def numbers(self) -> tuple[int, ...]:
        """Which jobs are checked."""
        wanted = self.robot
        return tuple(
            number for number, job in enumerate(self.jobs) if not wanted or not job.robots or wanted in job.robots
        )

    def layout(self, robot: RobotModel) -> Layout:
        """Return where everything is; raises as `checker`."""
        order = [job.element for job in self.jobs if job.element in self.pieces]
        return Layout(read_site(self.cell), self.building, self.pieces, order, robot.tip_link, self.standing)

    def checker(self) -> Checker:
        """Return a checker.

        Raises:
            ConstructionTwinError: If a file cannot be used, or an element has no rack.
        """
        robot = self.arm.robot()
        shipped = yaml.safe_load(self.arm.planner.read_text(encoding="utf-8"))
        known = {key: value for key, value in shipped.items() if key in PlannerSettings.model_fields}
        settings = PlannerSettings(**{**known, "seed": self.seed})
        layout = self.layout(robot)
        rng = np.random.default_rng(self.seed)
        collision = read_self_collision(self.arm.self_collision, robot)
        return Checker(robot, collision, settings, layout, self.jobs, time.monotonic, rng, removals=self.removals)


@dataclass(frozen=True)
class Checked:
    """What was found.

    Attributes:
        tasks: In the order of the schedule.
        rss_mb: Largest resident memory of all processes together [MB]; what they share is counted in each.
    """

    tasks: tuple[CheckedTask, ...]
    seconds: float
    rss_mb: float


def check_all(setup: Setup, processes: int, done: Callable[[CheckedTask], None] = lambda _: None) -> Checked:
    """Check every job. To be called before the caller has threads: the processes are forked from it.

    Args:
        processes: At least 1.
        done: Called with each result as it comes, in any order.

    Raises:
        ConstructionTwinError: As `Setup.checker`.
        BrokenProcessPool: If a process was ended, by want of memory for instance.
    """
    began = time.monotonic()
    worker = _Worker(setup.checker())
    found: dict[int, CheckedTask] = {}
    memory: dict[int, float] = {}
    pool = ProcessPoolExecutor(processes, multiprocessing.get_context("fork"), _take, (worker,))
    try:
        for future in as_completed([pool.submit(_check, number) for number in setup.numbers]):
            task, process, rss = future.result()
            found[task.number] = task
            memory[process] = rss
            done(task)
        until = time.monotonic() + setup.changes
        failed = _first_of_each_reason([found[number] for number in sorted(found) if not found[number].possible])
        for future in as_completed([pool.submit(_change, task, until) for task in failed if setup.changes > 0.0]):
            task, process, rss = future.result()
            found[task.number] = task
            memory[process] = rss
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    tasks = tuple(found[number] for number in sorted(found))
    return Checked(tasks, time.monotonic() - began, _rss_mb() + sum(memory.values()))


class _Worker:
    """What a process checks with. Forked, not pickled: a checker holds shapes of compiled libraries."""

    def __init__(self, checker: Checker):
        self.checker = checker


#: Of this process, set when it begins.
_taken: list[_Worker] = []


def _take(worker: _Worker) -> None:
    _taken.append(worker)


def _check(number: int) -> tuple[CheckedTask, int, float]:
    return _taken[-1].checker.check(number), os.getpid(), _rss_mb()


def _change(task: CheckedTask, until: float) -> tuple[CheckedTask, int, float]:
    # the clock of all processes of a machine is the same
    within = min(until, time.monotonic() + TASK_CHANGES)
    return _taken[-1].checker.changed(task, within), os.getpid(), _rss_mb()


def _first_of_each_reason(failed: list[CheckedTask]) -> list[CheckedTask]:
    """Return tasks with the first of each reason before all others."""
    first = list({reason_kind(task): task for task in reversed(failed)}.values())[::-1]
    return first + [task for task in failed if task not in first]


def _rss_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0

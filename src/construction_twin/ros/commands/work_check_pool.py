"""The tasks of a building model, checked in several processes at once. Knows no ROS and no terminal.

The processes (`work.worker`) have one planner each and take one task after the other. ``python -m`` with this module's name is one.
"""

from __future__ import annotations

import os
import resource
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from queue import SimpleQueue

import numpy as np
import yaml

from construction_twin.planning.planner import PlannerSettings
from construction_twin.robot.description import RobotModel, read_robot_files
from construction_twin.scene.objects import SceneObject
from construction_twin.scene.self_collision import read_self_collision
from construction_twin.work.building import BuildingModel
from construction_twin.work.check import CheckedTask, Checker
from construction_twin.work.schedule import Job
from construction_twin.work.site import read_site
from construction_twin.work.site_scene import Layout
from construction_twin.work.worker import Worker, serve_parent

#: What a process is started with.
PROGRAM = (sys.executable, "-m", "construction_twin.ros.commands.work_check_pool")
#: Of every planning: the same model and cell give the same findings.
SEED = 1


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
        robot: Only jobs that this robot may do are checked; empty: all. The others' elements are placed in their turn as well.
        standing: See `Layout`.
        removals: What people take down before jobs that wait for it.
    """

    arm: Arm
    cell: Path
    building: BuildingModel
    pieces: dict[str, tuple[SceneObject, ...]]
    jobs: tuple[Job, ...]
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
        order = [element for element in dict.fromkeys(job.element for job in self.jobs) if element in self.pieces]
        site = read_site(self.cell)
        return Layout(site, self.building, self.pieces, order, robot.tip_link, self.standing, self.jobs)

    def checker(self) -> Checker:
        """Return a checker.

        Raises:
            ConstructionTwinError: If a file cannot be used, or an element has no rack.
        """
        robot = self.arm.robot()
        shipped = yaml.safe_load(self.arm.planner.read_text(encoding="utf-8"))
        known = {key: value for key, value in shipped.items() if key in PlannerSettings.model_fields}
        settings = PlannerSettings(**{**known, "seed": SEED})
        layout = self.layout(robot)
        rng = np.random.default_rng(SEED)
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
    """Check every job.

    Args:
        processes: At least 1.
        done: Called with each result as it comes, in any order.

    Raises:
        WorkerError: As `Setup.checker`; with an empty `kind` if a process was ended, by want of memory for instance.
    """
    began = time.monotonic()
    found: dict[int, CheckedTask] = {}
    memory: dict[int, float] = {}
    with _pool(setup, processes) as pool:
        for task, process, rss in pool.each(setup.numbers):
            found[task.number] = task
            memory[process] = rss
            done(task)
    tasks = tuple(found[number] for number in sorted(found))
    return Checked(tasks, time.monotonic() - began, _rss_mb() + sum(memory.values()))


@contextmanager
def _pool(setup: Setup, processes: int) -> Iterator[_Pool]:
    """Yield processes that are ready to check; they end with the context, and with this process."""
    pool = _Pool(processes)
    try:
        pool.prepare(setup)
        yield pool
    finally:
        pool.close()


class _Pool:
    """Processes that check, each asked one thing at a time."""

    def __init__(self, processes: int):
        self._workers = [Worker(PROGRAM) for _ in range(processes)]
        self._idle: SimpleQueue[Worker] = SimpleQueue()
        self._threads = ThreadPoolExecutor(processes)

    def prepare(self, setup: Setup) -> None:
        """Give every process all it needs, and wait until it has it."""
        for future in [self._threads.submit(worker.ask, "prepare", setup=setup) for worker in self._workers]:
            future.result()
        for worker in self._workers:
            self._idle.put(worker)

    def each(self, numbers: Iterable[int]) -> Iterator[tuple[CheckedTask, int, float]]:
        """Yield what is found for jobs as it comes: task, process, and its memory [MB]."""
        for future in as_completed([self._threads.submit(self._check, number) for number in numbers]):
            yield future.result()

    def close(self) -> None:
        """End the processes."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        for worker in self._workers:
            worker.close()
        self._threads.shutdown(wait=True)

    def _check(self, number: int) -> tuple[CheckedTask, int, float]:
        worker = self._idle.get()
        try:
            return worker.ask("check", number=number)
        finally:
            self._idle.put(worker)


#: Of this process, made by `_prepare`.
_checkers: list[Checker] = []


def _prepare(setup: Setup) -> None:
    _checkers[:] = [setup.checker()]


def _check(number: int) -> tuple[CheckedTask, int, float]:
    return _checkers[0].check(number), os.getpid(), _rss_mb()


def _rss_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


if __name__ == "__main__":
    serve_parent({"prepare": _prepare, "check": _check})

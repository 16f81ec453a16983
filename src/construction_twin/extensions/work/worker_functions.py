"""What a process of the work does: read a model in its cell, plan its tasks for the node, and check them. See `worker`."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from construction_twin.core.worker import rss_mb, serve_parent
from construction_twin.extensions.work.building import BuildingModel, Element
from construction_twin.extensions.work.built import pose_of_tuple
from construction_twin.extensions.work.check import CheckedTask, Checker
from construction_twin.extensions.work.element_bodies import element_shapes, element_triangles
from construction_twin.extensions.work.errors import TaskPlanningError
from construction_twin.extensions.work.ifc.reading import read_building
from construction_twin.extensions.work.motions import TaskPlanner
from construction_twin.extensions.work.prepared import ElementFacts, Prepared, Scheduled
from construction_twin.extensions.work.process import TaskMotions, WorkJob, process_of
from construction_twin.extensions.work.proposed_schedule import propose
from construction_twin.extensions.work.schedule import Schedule
from construction_twin.extensions.work.site import Site, pose_of, read_site
from construction_twin.extensions.work.site_scene import Layout
from construction_twin.extensions.work.standing import check_placement, standing
from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.planning.planner import PlannerSettings
from construction_twin.robot.description import RobotModel
from construction_twin.scene.objects import Scene, tool_objects
from construction_twin.scene.self_collision import read_self_collision

#: By how much bodies may be larger than their element without being told [m].
_TOLD = 0.0005


@dataclass(frozen=True, eq=False)
class _Session:
    """What was read, for planning."""

    layout: Layout
    planner: TaskPlanner
    checker: Checker


#: Filled by `prepare`; the process serves one parent.
_SESSIONS: list[_Session] = []


def prepare(
    model: str | BuildingModel,
    cell: str,
    robot: RobotModel,
    self_collision: str,
    planner: Mapping[str, Any],
    cache: str,
) -> Prepared:
    """Read a model and its cell.

    Args:
        model: Path of the IFC file, or what was read of it.
        planner: The planner node's settings.
        cache: Folder for what was read, and for bodies.
    """
    site = read_site(cell)
    building = read_building(model, Path(cache) / "models") if isinstance(model, str) else model
    proposed = not building.tasks
    if proposed:
        building = propose(building)
    schedule = Schedule.of(building, proposed, site.recipes.process)
    order = list(dict.fromkeys(job.element for job in schedule.jobs))
    chain = Chain(robot)
    tool = pose_of(site.tool.tool.tool0_T_tcp)
    reach = chain.reach + float(np.linalg.norm(chain.shoulder)) + float(np.linalg.norm(tool.position))
    base = site.base(building).id if site.file.base_element else ""
    placement = check_placement(building, site.model_T_base(building), reach, base)
    # what is doubted, or has no usable body, stands as an obstacle
    sure = [element for element in order if not building.element(element).doubt]
    shapes, failures = element_shapes(map(building.element, sure), Path(cache) / "bodies")
    pieces = {element: shape.objects for element, shape in shapes.items()}
    stands = standing(building, pieces, site, reach, Path(cache) / "bodies")
    schedule.notes = tuple(map(building.called, schedule.notes))
    schedule.remarks = {job: tuple(map(building.called, said)) for job, said in schedule.remarks.items()}
    # one element without usable body does not stop the others
    usable = [element for element in order if element in pieces]
    layout = Layout(site, building, pieces, usable, robot.tip_link, stands.pieces, schedule.jobs)
    unplannable = {element: str(failure) for element, failure in failures.items()}
    unplannable |= {element: building.element(element).doubt for element in order if element not in sure}
    removed = [job.element for job in schedule.removals]
    elements = {}
    for element in dict.fromkeys((*order, *removed)):
        read = building.element(element)
        elements[element] = ElementFacts(
            read.name or read.tag or element, pieces.get(element, ()),
            layout.base_T_goal(element), element_triangles(read), _mass(site, building, schedule, read),
            read.ifc_class,
        )  # fmt: skip
    notes = [*building.notes, *placement, *(str(failure) for failure in failures.values()), *stands.notes]
    notes += [
        f"{element} is planned with bodies up to {1e3 * shape.excess:.1f} mm larger than it is."
        for element, shape in shapes.items()
        if shape.excess > _TOLD
    ]
    known = {name: value for name, value in planner.items() if name in PlannerSettings.model_fields}
    rng = np.random.default_rng(known["seed"])
    solver = inverse_kinematics(chain, IkSettings(budget_s=planner.get("ik_budget", 0.5)), rng, time.monotonic)
    links = read_self_collision(self_collision, robot)
    tasks = TaskPlanner(
        robot, solver, PlannerSettings.model_validate(known), links, site.tool, site.recipes, time.monotonic
    )
    unplannable = {element: building.called(why) for element, why in unplannable.items()}
    _SESSIONS[:] = [_Session(layout, tasks, Checker(robot, tasks, layout, schedule, unplannable, time.monotonic))]
    return Prepared(
        model=Path(building.file).name,
        digest=building.digest,
        cell=str(cell),
        schedule=schedule,
        schedule_digest=schedule_digest(schedule),
        elements=elements,
        stock=layout.stock,
        tool=site.tool.tool,
        tool_objects=tool_objects(site.tool, robot.tip_link),
        notes=tuple(map(building.called, notes)),
        unplannable=unplannable,
        standing=layout.standing,
        scheduled=_scheduled(building, schedule),
        comes_after=layout.comes_after,
    )


def schedule_digest(schedule: Schedule) -> str:
    """Return the SHA-256 of what a person accepts."""
    return hashlib.sha256(json.dumps([asdict(job) for job in schedule.jobs]).encode()).hexdigest()


def _mass(site: Site, building: BuildingModel, schedule: Schedule, element: Element) -> float | None:
    """Return the mass that an element is planned with [kg]; None: nobody says, or its recipe is wrong, which planning tells."""
    placing = schedule.placing.get(element.id)
    task = building.tasks.get(schedule.job(placing).task) if placing else None
    job = WorkJob(element.id, element, task_properties=task.properties if task is not None else {})
    try:
        name, recipe = site.recipes.of(job)
        return process_of(recipe.process).mass(job, name, recipe, site.tool.tool)
    except TaskPlanningError:
        return element.mass


def _scheduled(building: BuildingModel, schedule: Schedule) -> dict[str, Scheduled]:
    """Return when the model's schedule has each job; the duration of a task that makes several elements is none of theirs."""
    return {
        job.id: Scheduled(task.start, task.duration if job.id == job.task else None)
        for job in schedule.jobs
        if (task := building.tasks.get(job.task)) is not None
    }


def plan(task: str, element: str, start: tuple[float, ...], scene: Scene, held: tuple[float, ...] = ()) -> TaskMotions:
    """Plan a task.

    Args:
        start: Length n. Where the arm stands.
        held: Length 7 or 0. ``tool0_T_element`` of an element that is in the grip already; empty: it lies in its stock.
    """
    if not _SESSIONS:
        raise TaskPlanningError(task, "the model has not been read in this process yet")
    session = _SESSIONS[0]
    job = session.layout.job_for(element, scene, task)
    try:
        return session.planner.plan(job, start, scene, held=pose_of_tuple(held) if held else None)
    except TaskPlanningError as error:
        reason = session.layout.building.called(error.reason, element)
        raise TaskPlanningError(error.task, reason, error.stage, error.method) from error


def check(number: int) -> tuple[CheckedTask, int, float]:
    """Return what was found for one job of the schedule, by its number from 0; this process, and its memory [MB]."""
    return _SESSIONS[0].checker.check(number), os.getpid(), rss_mb()


if __name__ == "__main__":
    serve_parent({"prepare": prepare, "plan": plan, "check": check})

"""The process of the work: reads a model in its cell, plans its tasks for the node, and checks them. See `core.worker`."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.worker import rss_mb, serve_parent
from construction_twin.extensions.work.building import BuildingModel, Element, PlacementError, wholes
from construction_twin.extensions.work.element_bodies import box_of, element_shapes, element_triangles
from construction_twin.extensions.work.ifc.reading import read_building
from construction_twin.extensions.work.layout import Layout
from construction_twin.extensions.work.loaded_model import ElementFacts, LoadedModel, Scheduled, pose_of_tuple
from construction_twin.extensions.work.motions import TaskPlanner
from construction_twin.extensions.work.process import TaskMotions, TaskPlanningError, WorkJob, process_of
from construction_twin.extensions.work.schedule import Schedule, propose
from construction_twin.extensions.work.work_cell import WorkCell, pose_of, read_work_cell
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.planning.planner import PlannerSettings
from construction_twin.robot.description import RobotModel
from construction_twin.scene.objects import Scene, SceneObject, tool_objects
from construction_twin.scene.self_collision import read_self_collision

#: Excess of a body over its element from which a note is written [m].
_NOTABLE_EXCESS = 0.0005
#: What is carried reaches further than the tool: half of the longest element that an arm carries, and something [m].
_CARRIED = 5.0


@dataclass(frozen=True)
class CheckedTask:
    """What was found for one job.

    Attributes:
        grip: `TaskMotions.method`, or the one that came furthest.
        track: First linear joint where the process acts [m].
        duration: Of all motions [s], without the waiting for the tool.
        stage, reason: What was not possible, and why.
    """

    number: int
    name: str
    element: str
    element_name: str
    possible: bool
    grip: str = ""
    track: float | None = None
    clearance: float | None = None
    duration: float | None = None
    planning: float = 0.0
    stage: str = ""
    reason: str = ""


@dataclass(frozen=True, eq=False)
class PlanningContext:
    """What `load_model` leaves for the plans of one process. For one thread."""

    robot: RobotModel
    planner: TaskPlanner
    layout: Layout
    schedule: Schedule
    unplannable: Mapping[str, str]

    def check(self, number: int) -> CheckedTask:
        """Plan a job by its number from 0, from home and with all that comes before it standing as designed."""
        job, building = self.schedule.jobs[number], self.layout.building
        began = time.monotonic()
        found = CheckedTask(number, job.name, job.element, building.element(job.element).name, False)
        if job.element in self.unplannable:
            return replace(found, reason=self.unplannable[job.element])
        scene, place = self._turn(number)
        try:
            plan = self.planner.plan(place, self.robot.home, scene)
        except ConstructionTwinError as error:
            reason = str(error)
            if isinstance(error, TaskPlanningError):
                found, reason = replace(found, stage=error.stage, grip=error.method), error.reason
            return replace(found, planning=time.monotonic() - began, reason=building.with_names(reason))
        acts = process_of(job.process).acts
        at = next(segment for segment in plan.segments if segment.name == acts).trajectory.positions[-1]
        return replace(
            found,
            possible=True,
            grip=plan.method,
            track=next((float(value) for value, linear in zip(at, self.robot.linear) if linear), None),
            clearance=float(plan.clearance),
            duration=float(plan.duration),
            planning=time.monotonic() - began,
        )

    def _turn(self, number: int) -> tuple[Scene, WorkJob]:
        job, layout = self.schedule.jobs[number], self.layout
        before = [each.element for each in self.schedule.jobs[:number] if each.element in layout.order]
        # what it waits for, at first or second hand
        left, waited = [job], {job.id}
        while left:
            new = {wait.job for wait in left.pop().after} - waited
            waited |= new
            left += map(self.schedule.job, new)
        gone = frozenset(each.element for each in self.schedule.removals if each.id in waited)
        scene = layout.scene({one: layout.base_T_goal(one) for one in before}, gone)
        return scene, layout.job_for(job.element, scene, job.id)


#: Filled by `load_model`; the process serves one parent.
_CONTEXTS: list[PlanningContext] = []


def load_model(
    model: str | BuildingModel,
    cell: str,
    robot: RobotModel,
    self_collision: str,
    planner: Mapping[str, Any],
    cache: str,
) -> LoadedModel:
    """Load a model, its path or what was read, in its cell, and prepare the plans of its tasks; `cache`: folder."""
    work_cell = read_work_cell(cell)
    building = read_building(model, Path(cache) / "models") if isinstance(model, str) else model
    proposed = not building.tasks
    if proposed:
        building = propose(building)
    schedule = Schedule.of(building, proposed, work_cell.recipes.process)
    order = list(dict.fromkeys(job.element for job in schedule.jobs))
    chain = Chain(robot)
    tool = pose_of(work_cell.tool.tool.tool0_T_tcp)
    reach = chain.reach + float(np.linalg.norm(chain.shoulder)) + float(np.linalg.norm(tool.position))
    check_placement(building, work_cell.model_T_base, reach)
    # what is doubted, or has no usable body, stands as an obstacle, and does not stop the others
    doubted = {one: building.element(one).doubt for one in order if building.element(one).doubt}
    bodies = Path(cache) / "bodies"
    shapes, failures = element_shapes((building.element(one) for one in order if one not in doubted), bodies)
    pieces = {element: shape.objects for element, shape in shapes.items()}
    stands, boxed = standing_obstacles(building, pieces, work_cell, reach, bodies)
    schedule.notes = tuple(map(building.with_names, schedule.notes))
    usable = [element for element in order if element in pieces]
    layout = Layout(work_cell, building, pieces, usable, robot.tip_link, stands, schedule.jobs)
    unplannable = {element: building.with_names(why) for element, why in (failures | doubted).items()}
    elements = {}
    for element in dict.fromkeys((*order, *(job.element for job in schedule.removals))):
        read = building.element(element)
        elements[element] = ElementFacts(
            read.name or read.tag or element, pieces.get(element, ()),
            layout.base_T_goal(element), element_triangles(read), _mass(work_cell, building, schedule, read),
        )  # fmt: skip
    notes = [*building.notes, *failures.values(), *boxed]
    notes += [
        f"{element} is planned with bodies up to {1e3 * shape.excess:.1f} mm larger than it is."
        for element, shape in shapes.items()
        if shape.excess > _NOTABLE_EXCESS
    ]
    known = {name: value for name, value in planner.items() if name in PlannerSettings.model_fields}
    rng, processor_time = np.random.default_rng(known["seed"]), time.thread_time
    solver = inverse_kinematics(chain, IkSettings(budget_s=planner.get("ik_budget", 0.5)), rng, processor_time)
    links, settings = read_self_collision(self_collision, robot), PlannerSettings.model_validate(known)
    tasks = TaskPlanner(robot, solver, settings, links, work_cell.tool, work_cell.recipes, processor_time)
    _CONTEXTS[:] = [PlanningContext(robot, tasks, layout, schedule, unplannable)]
    # the duration of a task that makes several elements is none of theirs
    scheduled = {
        job.id: Scheduled(task.start, task.duration if job.id == job.task else None)
        for job in schedule.jobs
        if (task := building.tasks.get(job.task)) is not None
    }
    return LoadedModel(
        model=building.file,
        digest=building.digest,
        cell=str(cell),
        schedule=schedule,
        schedule_digest=hashlib.sha256(json.dumps([asdict(job) for job in schedule.jobs]).encode()).hexdigest(),
        elements=elements,
        stock=layout.stock,
        tool=work_cell.tool.tool,
        tool_objects=tool_objects(work_cell.tool, robot.tip_link),
        notes=tuple(map(building.with_names, notes)),
        unplannable=unplannable,
        standing=layout.standing,
        scheduled=scheduled,
        comes_after=layout.comes_after,
    )


def _mass(work_cell: WorkCell, building: BuildingModel, schedule: Schedule, element: Element) -> float | None:
    """Return the mass that an element is planned with [kg]; None: unknown."""
    placing = schedule.placing.get(element.id)
    task = building.tasks.get(schedule.job(placing).task) if placing else None
    job = WorkJob(element.id, element, task_properties=task.properties if task is not None else {})
    try:
        name, recipe = work_cell.recipes.of(job)
        return process_of(recipe.process).mass(job, name, recipe, work_cell.tool.tool)
    except TaskPlanningError:
        return element.mass


def plan(task: str, element: str, start: tuple[float, ...], scene: Scene, held: tuple[float, ...] = ()) -> TaskMotions:
    """Plan a task; `held`: length 7 or 0, ``tool0_T_element`` of an element in the grip."""
    if not _CONTEXTS:
        raise TaskPlanningError(task, "the model has not been read in this process yet")
    context = _CONTEXTS[0]
    job = context.layout.job_for(element, scene, task)
    try:
        return context.planner.plan(job, start, scene, held=pose_of_tuple(held) if held else None)
    except TaskPlanningError as error:
        reason = context.layout.building.with_names(error.reason)
        raise TaskPlanningError(error.task, reason, error.stage, error.method) from error


def check(number: int) -> tuple[CheckedTask, int, float]:
    """Return what was found for a job by its number from 0, this process, and its memory [MB]."""
    return _CONTEXTS[0].check(number), os.getpid(), rss_mb()


def check_placement(model: BuildingModel, model_T_base: Pose, reach: float) -> None:
    """Refuse a model out of reach."""
    boxes = {one.id: one.box for one in model.elements.values() if one.bodies}
    if not boxes:
        raise PlacementError(f"{model.file}: no element has geometry, so nothing can be placed")
    distances = {name: _distance(box, model_T_base) for name, box in boxes.items()}
    nearest = min(distances, key=lambda one: distances[one])
    if distances[nearest] > reach:
        low, high = np.min(list(boxes.values()), axis=(0, 1)), np.max(list(boxes.values()), axis=(0, 1))
        problem = f"all {len(boxes)} elements are out of the robot's reach of {reach:.2f} m: the nearest"
        base_at = f"{distances[nearest]:.2f} m from its base at {_figures(model_T_base.position)}"
        stand = f"The elements stand at {_figures(low)} to {_figures(high)}."
        raise PlacementError(f"{problem}, element {model.labels.get(nearest, nearest)}, is {base_at}. {stand}")


def _distance(box: np.ndarray, model_T_base: Pose) -> float:
    """Return how far a box in the model, shape (2, 3), is from the base's origin [m]."""
    low, high = box - model_T_base.position
    return float(np.linalg.norm(np.maximum(np.maximum(low, -high), 0.0)))


def _figures(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in values) + ") m"


def standing_obstacles(
    building: BuildingModel, made_by_tasks: Collection[str], work_cell: WorkCell, reach: float, folder: Path
) -> tuple[dict[str, tuple[SceneObject, ...]], list[str]]:
    """Return the convex pieces of what no task makes and the arm, or what it carries, can reach, and notes."""
    # what exists stands, whatever new is a part of it
    whole = {
        one for name in made_by_tasks for one in wholes(building.elements, name) if not building.elements[one].status
    }
    base, most = work_cell.model_T_base, reach + _CARRIED
    others = [one for one in building.elements.values() if one.bodies and one.id not in {*made_by_tasks, *whole}]
    shapes, failures = element_shapes([one for one in others if _distance(one.box, base) <= most], folder)
    sentence = "cannot be divided into bodies, its box is the obstacle, and the arm does not place it"
    notes = [f"{name} {sentence}: {failure}" for name, failure in failures.items()]
    boxes = {name: (box_of(building.element(name)),) for name in failures}
    return {name: shape.objects for name, shape in shapes.items()} | boxes, notes


if __name__ == "__main__":
    # records that are sent must be of a module that the parent has, too
    from construction_twin.extensions.work import worker_functions as own

    serve_parent({"load_model": own.load_model, "plan": own.plan, "check": own.check})

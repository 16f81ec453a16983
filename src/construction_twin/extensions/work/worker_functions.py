"""What a process of the work does: read a model in its cell, plan its tasks for the node, and check them. See `worker`.

To be checked, each task is planned in the scene that its turn finds if everything before it stands as designed, from the arm's home
pose: so each can be checked on its own.
"""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.worker import rss_mb, serve_parent
from construction_twin.extensions.work.building import BuildingModel, Element
from construction_twin.extensions.work.built import pose_of_tuple
from construction_twin.extensions.work.element_bodies import box_of, element_shapes, element_triangles
from construction_twin.extensions.work.errors import PlacementError, TaskPlanningError
from construction_twin.extensions.work.ifc.reading import read_building
from construction_twin.extensions.work.motions import TaskPlanner
from construction_twin.extensions.work.names import first_few
from construction_twin.extensions.work.prepared import ElementFacts, Prepared, Scheduled
from construction_twin.extensions.work.process import DEFAULT, TaskMotions, WorkJob, process_of
from construction_twin.extensions.work.proposed_schedule import propose
from construction_twin.extensions.work.schedule import Schedule
from construction_twin.extensions.work.site import Site, inverse, pose_of, read_site
from construction_twin.extensions.work.site_scene import Layout
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.planning.planner import PlannerSettings
from construction_twin.robot.description import RobotModel
from construction_twin.scene.objects import Scene, SceneObject, product, tool_objects
from construction_twin.scene.self_collision import read_self_collision

#: By how much bodies may be larger than their element without being told [m].
_TOLD = 0.0005


#: Points of the tool's path that are kept are this far apart [s].
_PATH_STEP = 0.1


@dataclass(frozen=True)
class CheckedTask:
    """What was found for one job.

    Attributes:
        grip: How it is done, see `TaskMotions.method`, or the method that came furthest; empty: none.
        track: Value of the first linear joint where the process acts at the element's place [m]; None: the robot has none, or
            there is no plan.
        clearance: [m], see `TaskMotions`.
        duration: Of all motions [s], without the waiting for the tool.
        planning: Time it took to find out [s].
        stage, reason: What was not possible, and why; empty if it is possible.
        remarks: What a person should know of the task or its element, as the model was read.
        path: Length 3. The tool's centre point in the base [m].
    """

    number: int
    job: str
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
    remarks: tuple[str, ...] = ()
    path: tuple[tuple[float, float, float], ...] = field(default=(), repr=False)
    process: str = DEFAULT


class Checker:
    """Plans every job of a schedule on its own. Not for use from several threads at once.

    `unplannable`: Why an element can never be planned, by GlobalId.
    """

    def __init__(
        self,
        robot: RobotModel,
        planner: TaskPlanner,
        layout: Layout,
        schedule: Schedule,
        unplannable: Mapping[str, str],
        clock: Callable[[], float],
    ):
        self._robot, self._planner, self._layout, self._clock = robot, planner, layout, clock
        self._schedule, self._unplannable = schedule, unplannable
        self._jobs = schedule.jobs
        self._chain = Chain(robot)
        self._tool0_T_tcp = pose_of(layout.site.tool.tool.tool0_T_tcp)

    def check(self, number: int) -> CheckedTask:
        """Return what was found for one job of the schedule, by its number from 0."""
        job = self._jobs[number]
        element = self._layout.building.element(job.element)
        began = self._clock()
        remarks = self._schedule.remarks.get(job.id, ())
        about = number, job.id, job.name, job.element, element.name
        found = CheckedTask(*about, False, remarks=remarks, process=job.process)
        if job.element in self._unplannable:
            return replace(found, reason=self._unplannable[job.element])
        scene, place = self._turn(number)
        try:
            plan = self._planner.plan(place, self._robot.home, scene)
        except ConstructionTwinError as error:
            found = replace(found, planning=self._clock() - began, reason=str(error))
            if isinstance(error, TaskPlanningError):
                found = replace(found, stage=error.stage, grip=error.method, reason=error.reason)
            return replace(found, reason=self._layout.building.called(found.reason, job.element))
        return replace(self._described(found, plan), planning=self._clock() - began)

    def _before(self, number: int) -> set[str]:
        """Return the elements that a job waits for, at first or second hand."""
        open_jobs, elements = [self._jobs[number]], set()
        while open_jobs:
            for wait in open_jobs.pop().after:
                other = self._schedule.job(wait.job)
                if other.element not in elements:
                    elements.add(other.element)
                    open_jobs.append(other)
        return elements

    def _turn(self, number: int) -> tuple[Scene, WorkJob]:
        """Return scene and job when everything before it stands, of what has geometry."""
        before = [job.element for job in self._jobs[:number] if job.element in self._layout.order]
        gone = frozenset(job.element for job in self._schedule.removals) & self._before(number)
        scene = self._layout.scene({one: self._layout.base_T_goal(one) for one in before}, gone)
        return scene, self._layout.job_for(self._jobs[number].element, scene, self._jobs[number].id)

    def _described(self, found: CheckedTask, plan: TaskMotions) -> CheckedTask:
        acts = process_of(found.process).acts
        at = next(segment for segment in plan.segments if segment.name == acts).trajectory.positions[-1]
        linear = [float(value) for value, is_linear in zip(at, self._robot.linear, strict=True) if is_linear]
        return replace(
            found,
            possible=True,
            grip=plan.method,
            track=linear[0] if linear else None,
            clearance=float(plan.clearance),
            duration=float(plan.duration),
            path=tuple(self._path(plan)),
        )

    def _path(self, plan: TaskMotions) -> Iterator[tuple[float, float, float]]:
        for segment in plan.segments:
            count = max(2, int(segment.trajectory.duration / _PATH_STEP))
            for q in segment.trajectory.sample_many(np.linspace(0.0, segment.trajectory.duration, count))[0]:
                x, y, z = product(self._chain.forward(q), self._tool0_T_tcp).position
                yield round(float(x), 3), round(float(y), 3), round(float(z), 3)


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


# -- what stands, and where


def check_placement(model: BuildingModel, model_T_base: Pose, reach: float, base: str = "") -> tuple[str, ...]:
    """Return what is out of reach while others are not, as one sentence, or nothing.

    Args:
        reach: Largest distance of the tool's centre point from the base's origin, along a track and with the tool [m], above 0.
        base: GlobalId of the element that stands for the robot's base, which is not compared; empty: none.
    """
    boxes = {one.id: _box(one) for one in model.elements.values() if one.bodies and one.id != base}
    if not boxes:
        raise PlacementError(f"{model.file}: no element has geometry, so nothing can be placed")
    at = model_T_base.position
    distances = {
        identifier: float(np.linalg.norm(np.maximum(np.maximum(low - at, at - high), 0.0)))
        for identifier, (low, high) in boxes.items()
    }
    far = tuple(one for one, distance in distances.items() if distance > reach)
    if len(far) == len(boxes):
        nearest = min(distances, key=lambda one: distances[one])
        low = np.min([box[0] for box in boxes.values()], axis=0)
        high = np.max([box[1] for box in boxes.values()], axis=0)
        said = f"all {len(boxes)} elements are out of the robot's reach of {reach:.2f} m: the nearest"
        away = f"{distances[nearest]:.2f} m from its base at {_figures(at)}"
        stand = f"The elements stand at {_figures(low)} to {_figures(high)}."
        raise PlacementError(f"{said}, {_named(model, (nearest,))}, is {away}. {stand}")
    if not far:
        return ()
    most = max(distances[one] for one in far)
    limits = f"up to {most:.2f} m from the base, reach {reach:.2f} m"
    return (f"{_named(model, far)} out of reach whatever the arm does: {limits}.",)


def _box(element: Element) -> np.ndarray:
    """Return the lowest and highest coordinates in the model, shape (2, 3)."""
    vertices = np.concatenate([body.vertices for body in element.bodies])
    pose = element.model_T_element
    points = vertices @ pose.rotation.T + pose.position
    return np.array([points.min(axis=0), points.max(axis=0)])


def _figures(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in values) + ") m"


def _named(model: BuildingModel, ids: tuple[str, ...]) -> str:
    if len(ids) == 1:
        return f"element {model.labels.get(ids[0], ids[0])}"
    return f"{len(ids)} elements ({first_few(model.labels.get(one, one) for one in ids)})"


#: What is carried reaches further than the tool: half of the longest element that an arm carries, and something [m].
_CARRIED = 5.0


@dataclass(frozen=True, eq=False)
class Standing:
    """What stands.

    Attributes:
        pieces: Convex pieces of each element in its own frame, ``<GlobalId>/<number>``; for `site_scene.Layout`.
        notes: One sentence for each element whose geometry is unusable: its box stands for it.
    """

    pieces: dict[str, tuple[SceneObject, ...]]
    notes: tuple[str, ...]


def standing(building: BuildingModel, made: Collection[str], site: Site, reach: float, folder: Path) -> Standing:
    """Return what stands of a model within reach of the arm and what it carries.

    Args:
        reach: As of `check_placement`.
        made: GlobalIds of the elements that tasks make; these, what they are parts of, and the element that stands for the base are
            not among what stands.
        folder: For mesh files, see `element_bodies.element_shapes`.
    """
    base_T_model = inverse(site.model_T_base(building))
    near = []
    for element in standing_elements(building, made, site):
        pose = product(base_T_model, element.model_T_element)
        points = np.concatenate([body.vertices for body in element.bodies]) @ pose.rotation.T + pose.position
        nearest = np.maximum(np.maximum(points.min(axis=0), -points.max(axis=0)), 0.0)
        if not np.linalg.norm(nearest) > reach + _CARRIED:
            near.append(element)
    shapes, failures = element_shapes(near, folder)
    said = "cannot be divided into bodies, its box is the obstacle, and the arm does not place it"
    notes = tuple(f"{name} {said}: {failure}" for name, failure in failures.items())
    boxes = {name: (box_of(building.element(name)),) for name in failures}
    return Standing({name: shape.objects for name, shape in shapes.items()} | boxes, notes)


def standing_elements(building: BuildingModel, made: Collection[str], site: Site) -> tuple[Element, ...]:
    """Return the elements with bodies that no task makes, wherever they are; see `standing`."""
    left_out = set(made)
    for identifier in made:
        above: list[str] = []
        parent = building.element(identifier).assembly
        while parent in building.elements and parent not in above:
            above.append(parent)
            parent = building.elements[parent].assembly
        # what exists stands, whatever new is a part of it
        left_out |= {one for one in above if not building.elements[one].status}
    if site.file.base_element:
        left_out.add(site.base(building).id)
    return tuple(one for one in building.elements.values() if one.bodies and one.id not in left_out)


if __name__ == "__main__":
    # records that are sent must be of a module that the parent has, too
    from construction_twin.extensions.work import worker_functions as own

    serve_parent({"prepare": own.prepare, "plan": own.plan, "check": own.check})

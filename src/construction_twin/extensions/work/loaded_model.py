"""A building model in its cell, loaded: what is to be done, with what, and where everything is. Poses in the base_link [m]."""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from construction_twin.extensions.work.building import labels
from construction_twin.extensions.work.ledger import Ledger, ModelElement, TaskStates, bodies_digest
from construction_twin.extensions.work.schedule import Job, Schedule
from construction_twin.extensions.work.task_memory import TaskMemory, TaskState
from construction_twin.kinematics.batch_kinematics import angles_between
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import quaternion_to_rotation, rotation_to_quaternion, rpy_to_rotation
from construction_twin.robot.tool import Tool
from construction_twin.scene.objects import Scene, SceneObject, product, relative
from construction_twin.scene.scene_change import SceneChange

if TYPE_CHECKING:
    # whoever only draws elements waits for no library of shapes
    from construction_twin.extensions.work.layout import StockPlan

#: The process that reads the model and plans tasks, see `core.worker`.
WORKER = (sys.executable, "-m", "construction_twin.extensions.work.worker_functions")


@dataclass(frozen=True, eq=False)
class ElementFacts:
    """An element that is to be worked on; in its frame: convex pieces ``<GlobalId>/0``, ..., and triangles, shape (t, 3, 3) [m]."""

    name: str
    bodies: tuple[SceneObject, ...]
    base_T_goal: Pose
    triangles: np.ndarray
    mass: float | None = None


@dataclass(frozen=True)
class Scheduled:
    """When the model's schedule has a job: ISO 8601, and [s]."""

    start: str = ""
    duration: float | None = None


@dataclass(frozen=True, eq=False)
class LoadedModel:
    """A loaded model.

    Attributes:
        unplannable: By GlobalId, why an element can never be planned.
        standing: What no task makes.
        comes_after: By GlobalId, the elements that are placed before one is there.
    """

    model: str
    digest: str
    cell: str
    schedule: Schedule
    schedule_digest: str
    elements: Mapping[str, ElementFacts]
    stock: StockPlan
    tool: Tool
    tool_objects: tuple[SceneObject, ...]
    notes: tuple[str, ...] = ()
    unplannable: Mapping[str, str] = field(default_factory=dict)
    standing: tuple[SceneObject, ...] = ()
    scheduled: Mapping[str, Scheduled] = field(default_factory=dict)
    comes_after: Mapping[str, frozenset[str]] = field(default_factory=dict)

    @property
    def predecessors(self) -> dict[str, tuple[str, ...]]:
        """The jobs that each removal and job waits for, in the schedule's order."""
        return {
            job.id: tuple(dict.fromkeys(wait.job for wait in job.after))
            for job in (*self.schedule.removals, *self.schedule.jobs)
        }

    @cached_property
    def titles(self) -> dict[str, str]:
        """What each job and removal is called in sentences."""
        every = {job.id: job.name for job in (*self.schedule.jobs, *self.schedule.removals)}
        return {**{job: job for job in every}, **labels(every)}

    @cached_property
    def model_elements(self) -> dict[str, ModelElement]:
        """What the model says of the element of each job and removal."""
        jobs = (*self.schedule.jobs, *self.schedule.removals)
        return {job.id: _model_element(job.element, self.elements[job.element]) for job in jobs}

    @property
    def standing_elements(self) -> frozenset[str]:
        """The elements that no task places."""
        worked_on = (job.element for job in self.schedule.jobs if not job.moves)
        return frozenset((*map(element_in, self.standing), *worked_on)) - {*self.schedule.placing}

    def stays(self, job: str) -> bool:
        """Return whether the process of a job leaves its element where it stands."""
        return not self.schedule.job(job).moves

    @property
    def removals(self) -> dict[str, str]:
        """The element that each removal takes down."""
        return {job.id: job.element for job in self.schedule.removals}


def glb(elements: Mapping[str, ElementFacts], model_hash: str) -> bytes:
    """Return the elements as binary glTF for the console's page: a node each, y up."""
    # slow to import
    import trimesh
    from trimesh.exchange.gltf import export_glb

    scene, upright = trimesh.Scene(), np.eye(4)
    upright[:3, :3] = rpy_to_rotation((-90.0, 0.0, 0.0))
    for name, facts in elements.items():
        if not len(facts.triangles):
            continue
        base_T_goal, corners = np.eye(4), facts.triangles.reshape(-1, 3)
        base_T_goal[:3] = np.column_stack((facts.base_T_goal.rotation, facts.base_T_goal.position))
        mesh = trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3))
        extras = {"element": name, "label": facts.name}
        scene.add_geometry(mesh, node_name=name, transform=upright @ base_T_goal, metadata=extras)

    def add_hash(document: dict) -> None:
        document["asset"]["extras"] = {"model_hash": model_hash}

    return bytes(export_glb(scene, include_normals=False, tree_postprocessor=add_hash))


def _model_element(element: str, facts: ElementFacts) -> ModelElement:
    """Return what the model says of an element; its place to 0.1 mm, as files round numbers."""
    digest = ""
    if facts.bodies:
        goal = np.column_stack((facts.base_T_goal.rotation, facts.base_T_goal.position))
        # no -0.0 beside 0.0
        place = (np.round(goal, 4) + 0.0).tolist()
        said = [element, facts.name, bodies_digest(facts.bodies), place]
        digest = hashlib.sha256(json.dumps(said).encode()).hexdigest()
    return ModelElement(element, digest)


def element_in(item: SceneObject) -> str:
    """Return the GlobalId of the element that a body of the scene is of."""
    return item.name.split("/", 1)[0]


#: Further than this from where the model has it, an element was turned by a symmetry of its own [m], [rad].
_TURNED_BY, _TURNED_ABOUT = 1e-3, math.radians(1.0)


@dataclass(frozen=True)
class Deviation:
    """How far an element stands from where the model has it: of its frame's origin [m], and turned [rad]."""

    distance: float
    angle: float


def pose_tuple(pose: Pose) -> tuple[float, ...]:
    """Return a pose as seven numbers."""
    return (*map(float, pose.position), *map(float, rotation_to_quaternion(pose.rotation)))


def pose_of_tuple(values: tuple[float, ...]) -> Pose:
    """Return a pose from seven numbers."""
    x, y, z, w = values[3:]
    return Pose(np.array(values[:3]), quaternion_to_rotation((x, y, z, w)))


def deviation(base_T_built: Pose, base_T_goal: Pose) -> Deviation:
    """Return how far a pose is from another."""
    angle = angles_between(base_T_built.rotation[None], base_T_goal.rotation[None])[0]
    return Deviation(float(np.linalg.norm(base_T_built.position - base_T_goal.position)), float(angle))


def as_built(base_T_tool0: Pose, base_T_tool0_planned: Pose, tool0_T_element: Pose, base_T_goal: Pose) -> Pose:
    """Return where the arm has set an element down; turned by a symmetry as planned, it counts as not turned."""
    planned = product(base_T_tool0_planned, tool0_T_element)
    built = product(base_T_tool0, tool0_T_element)
    found = deviation(planned, base_T_goal)
    if found.distance <= _TURNED_BY and found.angle <= _TURNED_ABOUT:
        return built
    return product(built, relative(planned, base_T_goal))


def placed_at(memory: TaskMemory, base_T_goal: Pose) -> Pose:
    """Return where a placed element stands: as built if known, else where the model has it, or had it then."""
    found = memory.base_T_element or memory.goal
    return pose_of_tuple(found) if found else base_T_goal


def bodies_at(bodies: Sequence[SceneObject], pose: Pose, link: str = "") -> tuple[SceneObject, ...]:
    """Return bodies at an element's pose, in the base_link or on a link."""
    return tuple(item.moved(product(pose, item.pose), link) for item in bodies)


def scene_change(scene: Scene, wanted: Mapping[str, SceneObject], left_alone: Collection[str]) -> SceneChange:
    """Return the change that makes the work's objects the wanted ones."""
    there = {item.name: item for item in scene.objects}
    put = tuple(item for name, item in wanted.items() if name not in there or there[name].contents() != item.contents())
    mine = [name for name in there if "/" in name and name.split("/", 1)[0] not in left_alone]
    return SceneChange(put, tuple(name for name in mine if name not in wanted))


#: Tolerances of a placed element [m], [rad].
OFF, OFF_ANGLE = 0.005, 0.01
ORIGIN = Pose(np.zeros(3), np.eye(3))


class AsBuilt:
    """What stands, lies in stock or is in the grip: the ledger read against the model."""

    def __init__(self, loaded: LoadedModel, ledger: Ledger, tip_link: str):
        self.loaded, self.ledger = loaded, ledger
        self._tip_link = tip_link
        self._stored_bodies: dict[tuple[str, str], tuple[SceneObject, ...]] = {}
        for memory in self.states.tasks.values():
            if memory.placed:
                # what stands and cannot be shown is told at once
                self.bodies(memory)

    @property
    def states(self) -> TaskStates:
        """The present states of the ledger."""
        return self.ledger.states

    def job(self, task: str) -> Job:
        """Return a task's job, of a former task what the ledger says."""
        if task in self.states.predecessors:
            return self.loaded.schedule.job(task)
        memory = self.states.tasks[task]
        return Job(task, task, memory.name, memory.element, (), ())

    def element(self, task: str) -> ElementFacts:
        """Return a task's element, of a former task what the ledger says."""
        if task in self.states.predecessors:
            return self.loaded.elements[self.job(task).element]
        memory = self.states.tasks[task]
        name = memory.name or memory.element or task
        return ElementFacts(name, self.bodies(memory), placed_at(memory, ORIGIN), np.empty((0, 3, 3)))

    def bodies(self, memory: TaskMemory) -> tuple[SceneObject, ...]:
        """Return an element's pieces as they were placed, if the ledger has any; read once."""
        key = memory.element, memory.body
        if key not in self._stored_bodies:
            self._stored_bodies[key] = self.ledger.saved_bodies(*key) if memory.body else ()
        return self._stored_bodies[key]

    def in_stock(self) -> tuple[str, ...]:
        """Return the elements that lie in their stock."""
        return self.loaded.stock.in_stock(self.out_of_stock())

    def out_of_stock(self) -> list[str]:
        """Return the elements that have left their stock."""
        tasks = self.states.tasks
        return [element for element, task in self.loaded.schedule.placing.items() if tasks[task].has_left_stock]

    def taken_down(self) -> set[str]:
        """Return the elements that people have taken down."""
        return {element for task, element in self.loaded.removals.items() if self.states.tasks[task].gone}

    def placing(self, element: str) -> TaskMemory | None:
        """Return the task that places an element, or did; None: it stands as the model has it."""
        task = self.loaded.schedule.placing.get(element)
        if task is not None:
            return self.states.tasks[task]
        return next((memory for memory in self.states.former.values() if memory.element == element), None)

    def deviation(self, task: str) -> Deviation | None:
        """Return how far a placed element stands from the model, if measured."""
        memory = self.states.tasks[task]
        if task not in self.states.predecessors or not (memory.placed and memory.base_T_element) or memory.as_planned:
            return None
        return deviation(pose_of_tuple(memory.base_T_element), self.element(task).base_T_goal)

    def wanted_scene(self) -> tuple[dict[str, SceneObject], tuple[str, ...]]:
        """Return the work's objects of the scene by name, and the elements whose objects are left as they are."""
        gone, former = self.taken_down(), {memory.element: memory for memory in self.states.former.values()}
        wanted = {item.name: item for item in self.loaded.tool_objects}
        left_alone: list[str] = []
        # what was placed stands as it was placed, whatever the model says of it
        placed_before = {element for element, memory in former.items() if memory.body}
        for item in self.loaded.standing:
            element = element_in(item)
            before = map(self.placing, self.loaded.comes_after.get(element, ()))
            if element not in gone | placed_before and all(memory is not None and memory.placed for memory in before):
                wanted[item.name] = item

        def place(
            element: str, bodies: Sequence[SceneObject], memory: TaskMemory | None, stock: Pose | None, goal: Pose
        ) -> None:
            """Add an element where the ledger has it; where the model has it if no task places it."""
            found: tuple[SceneObject, ...] = ()
            if memory is None or memory.placed:
                # also while it is asked about: it stands until a person says that it does not
                found = bodies_at(bodies, goal if memory is None else placed_at(memory, goal))
            elif memory.state is TaskState.ASKS:
                left_alone.append(element)
            elif memory.in_grip:
                found = bodies_at(bodies, pose_of_tuple(memory.tool0_T_element), self._tip_link)
            elif not memory.gone and stock is not None:
                found = bodies_at(bodies, stock)
            wanted.update((item.name, item) for item in found)

        for element, memory in former.items():
            if bodies := self.bodies(memory):
                place(element, bodies, memory, None, ORIGIN)
            else:
                left_alone.append(element)
        slots, in_stock = self.loaded.stock.slots, self.in_stock()
        for element in dict.fromkeys(job.element for job in self.loaded.schedule.jobs):
            if element in gone | placed_before:
                continue
            facts, stock = self.loaded.elements[element], slots[element].base_T_element if element in in_stock else None
            known = self.placing(element)
            bodies = self.bodies(known) if known is not None and known.placed else ()
            place(element, bodies or facts.bodies, known, stock, facts.base_T_goal)
        return wanted, tuple(left_alone)

    def forms(self, task: str) -> tuple[tuple[SceneObject, ...], ...]:
        """Return the objects of a task's element in its stock, in the grip, and at its place."""
        facts, memory = self.element(task), self.placing(self.job(task).element)
        slot = self.loaded.stock.slots.get(self.job(task).element)
        places = [(slot.base_T_element, "")] if slot is not None else []
        if memory is not None and memory.base_T_element:
            places.append((pose_of_tuple(memory.base_T_element), ""))
        if memory is not None and memory.tool0_T_element:
            places.append((pose_of_tuple(memory.tool0_T_element), self._tip_link))
        places.append((facts.base_T_goal, ""))
        return tuple(bodies_at(facts.bodies, place, link) for place, link in places)

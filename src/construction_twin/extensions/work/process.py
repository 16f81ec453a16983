"""A process, such as `place`: what is asked of it; and the recipes, by which tasks are carried out. Metres, seconds.

A process is a folder beside this module, with a module that has `PROCESS`. Recipes stand in a file; the model can name one.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pydantic

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.sentences import Sentence
from construction_twin.extensions.work.building import Element, Task, Value, WorkError
from construction_twin.kinematics.chain import Pose
from construction_twin.planning.work_segment import WorkSegment
from construction_twin.robot.tool import Tool
from construction_twin.robot.urdf import read_yaml
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.validation import StrictModel

#: The model's own property set for this package.
PROPERTY_SET = "CTwin_RobotTask"
#: Its property that chooses a recipe by its name, of an element or of a task.
RECIPE = "Recipe"
#: The process of a recipe that names none.
DEFAULT = "place"

Finite = Annotated[float, pydantic.Field(allow_inf_nan=False, ge=-1e4, le=1e4)]
Length = Annotated[float, pydantic.Field(allow_inf_nan=False, gt=0.0, le=10.0)]
Scale = Annotated[float, pydantic.Field(gt=0.0, le=1.0)]
#: ``Pset_Name.Property``
_Property = Annotated[str, pydantic.Field(pattern=r"^[^.]+\.[^.]+$")]


class Match(StrictModel):
    """What an element must be, all of it; names are patterns with ``*`` and ``?``, `elements` GlobalIds or whole names."""

    ifc_class: tuple[str, ...] = ()
    type_name: str = ""
    name: str = ""
    elements: tuple[str, ...] = ()
    properties: dict[_Property, bool | int | float | str] = {}

    def fits(self, element: Element) -> bool:
        """Return whether an element is meant."""
        if self.ifc_class and element.ifc_class not in self.ifc_class:
            return False
        if not (_like(element.type_name, self.type_name) and _like(element.name, self.name)):
            return False
        if self.elements and element.id not in self.elements and element.name not in self.elements:
            return False
        return all(_holds(element.properties, path, value) for path, value in self.properties.items())


def _like(text: str, pattern: str) -> bool:
    return not pattern or fnmatch.fnmatchcase(text.casefold(), pattern.casefold())


def _holds(properties: Mapping[str, Mapping[str, Value]], path: str, value: bool | float | str) -> bool:
    group, _, name = path.partition(".")
    found = properties.get(group, {}).get(name)
    # True == 1 in Python, but not in a model
    return found == value and isinstance(found, bool) == isinstance(value, bool)


class Recipe(StrictModel):
    """How elements of one kind are worked on.

    `speed`: on straight ways [m/s]. `free_speed_scale`: on free ways. `penetration`: of bodies that may touch [m].
    """

    match: Match = Match()
    process: str = DEFAULT
    speed: Annotated[float, pydantic.Field(gt=0.0, le=2.0)]
    free_speed_scale: Scale
    penetration: Annotated[float, pydantic.Field(ge=0.0, le=0.02)] = 0.0005


@dataclass(frozen=True, eq=False)
class WorkJob:
    """What is to be done with one element.

    Attributes:
        bodies: Convex pieces ``<GlobalId>/0``, ..., in the element's frame.
        base_T_stock: None: its process does not move it.
        supports: Scene objects that it may touch in stock and at its place.
        up: Against gravity, a unit vector in the base.
    """

    task: str
    element: Element
    bodies: tuple[SceneObject, ...] = ()
    base_T_stock: Pose | None = None
    base_T_goal: Pose = Pose(np.zeros(3), np.eye(3))
    supports: tuple[str, ...] = ()
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    task_properties: Mapping[str, Value] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """The element in a sentence; `BuildingModel.with_names` names it."""
        return f"element {self.element.id}"


@dataclass(frozen=True, eq=False)
class TaskMotions:
    """A whole task, planned.

    Attributes:
        method: How its process does it: of `place` the grip.
        scenes: Of each segment, and the one after the last.
        clearance: Smallest, without what is approached on purpose [m].
        tool0_T_element: None: the element is not moved.
    """

    job: WorkJob
    method: str
    segments: tuple[WorkSegment, ...]
    scenes: tuple[Scene, ...]
    planning_time: float
    clearance: float
    tool0_T_element: Pose | None = None

    @property
    def duration(self) -> float:
        """Time of all motions [s], without the waiting for switches."""
        return sum(segment.trajectory.duration for segment in self.segments)


class TaskPlanningError(WorkError):
    """A task cannot be planned; `stage`: the segment that failed, with the `method` that came furthest."""

    def __init__(self, task: str, reason: str, stage: str = "", method: str = ""):
        self.task, self.reason, self.stage, self.method = task, reason, stage, method
        where = (f", {stage}" if stage else "") + (f" with {method!r}" if method else "")
        super().__init__(Sentence("task {task}{where}: {reason}", task=task, where=where, reason=reason))


#: The stage of every process at which the arm does not get there at all.
REACH = "reach"


@dataclass(frozen=True)
class Process:
    """One process.

    Attributes:
        moves: It takes the element from its stock to its place; else a person is asked whether the task was carried out.
        check_recipe: Takes a recipe, the tool, and file and name of the recipe; raises ConfigurationError.
        mass: Takes a job, name of its recipe, the recipe and the tool [kg]; raises TaskPlanningError.
        acts: Name of the segment at whose end it acts.
        plan: Takes a `motions.Search`; raises `motions.AttemptFailed`, or TaskPlanningError.
    """

    moves: bool
    recipe: type[Recipe]
    check_recipe: Callable[[Any, Tool, str], None]
    mass: Callable[[WorkJob, str, Any, Tool], float | None]
    acts: str
    plan: Callable[[Any], TaskMotions]


#: Module of each process; its `PROCESS` is the process.
MODULES = {DEFAULT: "construction_twin.extensions.work.place.planner"}


@cache
def process_of(name: str) -> Process:
    """Return a process by its name."""
    if name not in MODULES:
        raise ConfigurationError("process", name, f"one of {', '.join(MODULES)}")
    return import_module(MODULES[name]).PROCESS


# -- the recipes of a file


@dataclass(frozen=True)
class Recipes:
    """The recipes of one file, in their order."""

    file: str
    recipes: Mapping[str, Recipe]

    def of(self, job: WorkJob) -> tuple[str, Recipe]:
        """Return name and recipe for a job: the one that its task or element names, else the first that fits.

        Raises:
            TaskPlanningError: If none fits, or `PROPERTY_SET` has anything but the name of one.
        """
        own = job.element.properties.get(PROPERTY_SET, {})
        of_task, of_element = self._named(job, job.task_properties), self._named(job, own)
        name = of_task or of_element or self._first(job)
        return name, self.recipes[name]

    def process(self, element: Element, task: Task | None = None) -> str:
        """Return the process of an element or a task; `DEFAULT` where the recipe is wrong, which planning tells."""
        try:
            return self.of(WorkJob(element.id, element, task_properties=task.properties if task else {}))[1].process
        except TaskPlanningError:
            return DEFAULT

    def check_tool(self, tool: Tool) -> None:
        """Check that a tool can do what every recipe asks of it."""
        for name, recipe in self.recipes.items():
            process_of(recipe.process).check_recipe(recipe, tool, f"{self.file}/recipes/{name}")

    def _named(self, job: WorkJob, own: Mapping[str, Value]) -> str:
        for other, value in own.items():
            if other not in (RECIPE, "id") and value is not None:
                raise _wrong(job, other, value, f"no property but {RECIPE}: what it says stands in a recipe")
        name = own.get(RECIPE)
        if name is not None and name not in self.recipes:
            raise _wrong(job, RECIPE, name, f"one of {', '.join(self.recipes)} in {self.file}")
        return str(name or "")

    def _first(self, job: WorkJob) -> str:
        element = job.element
        for name, recipe in self.recipes.items():
            if recipe.match.fits(element):
                return name
        kind = f"{element.ifc_class} {element.type_name!r}" if element.type_name else element.ifc_class
        to_do = f"add one, or name one in {PROPERTY_SET}"
        raise TaskPlanningError(job.task, f"no recipe of {self.file} fits {job.label}, {kind}; {to_do}")


class _File(StrictModel):
    recipes: Annotated[dict[str, dict[str, Any]], pydantic.Field(min_length=1)]


def read_recipes(path: str | Path) -> Recipes:
    """Read a recipes file."""
    description = read_yaml(path, " of recipes, as config/work/recipes.yaml")
    entries = _File.read(description, str(path)).recipes
    return Recipes(str(path), {name: _recipe(f"{path}/recipes/{name}", entry) for name, entry in entries.items()})


def _recipe(where: str, entry: dict[str, Any]) -> Recipe:
    process = entry.get("process", DEFAULT)
    if process not in list(MODULES):
        raise ConfigurationError(f"{where}/process", process, f"one of {', '.join(MODULES)}")
    return process_of(process).recipe.read(entry, where)


def _wrong(job: WorkJob, name: str, value: object, expected: str) -> TaskPlanningError:
    where = f"{job.label}, {PROPERTY_SET}.{name}"
    return TaskPlanningError(job.task, f"{where}: found {value!r}, expected {expected}")

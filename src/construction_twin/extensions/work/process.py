"""A process, such as `place`: what is asked of it; and the recipes, by which tasks are carried out. Metres, seconds.

A process is one folder beside this module, of which a module has `PROCESS`. Recipes stand in a file
(config/work/recipes.yaml); the building model overrides single keys.
"""

from __future__ import annotations

import difflib
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
from construction_twin.core.validation import configuration_error, wrong_value
from construction_twin.extensions.work.building import Element, Task, Value
from construction_twin.extensions.work.errors import TaskPlanningError
from construction_twin.kinematics.chain import Pose
from construction_twin.planning.work_segment import WorkSegment
from construction_twin.robot.tool import Tool
from construction_twin.robot.urdf import read_yaml
from construction_twin.scene.objects import Scene, SceneObject

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


class Strict(pydantic.BaseModel):
    """A part of a recipe: an unknown key is refused."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)


class Match(Strict):
    """What an element must be; all that is given must hold.

    Attributes:
        type_name, name: Patterns with ``*`` and ``?``, case ignored.
        elements: GlobalIds or whole names.
        properties: ``Pset_MemberCommon.Reference: S1``
    """

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


class Recipe(Strict):
    """How elements of one kind are worked on.

    Attributes:
        speed: Of the tool on the straight ways [m/s].
        free_speed_scale: Fraction of the joints' limits on the free ways.
        penetration: How deep bodies that may touch may be in each other [m].
    """

    match: Match = Match()
    process: str = DEFAULT
    speed: Annotated[float, pydantic.Field(gt=0.0, le=2.0)]
    free_speed_scale: Scale
    penetration: Annotated[float, pydantic.Field(ge=0.0, le=0.02)] = 0.0005


def as_list(value: Value) -> Any:
    """Return a text as numbers, or as words when one is none; any other value as it is."""
    if not isinstance(value, str):
        return value
    try:
        return tuple(map(float, value.split()))
    except ValueError:
        return tuple(value.split())


@dataclass(frozen=True)
class Override:
    """A property in the model that replaces a key of the recipe."""

    key: tuple[str, ...]
    ifc_type: str
    read: Callable[[Value], Any] = as_list


#: What every process lets the model override.
SHARED: Mapping[str, Override] = {"Speed": Override(("speed",), "IfcReal")}


@dataclass(frozen=True, eq=False)
class WorkJob:
    """What is to be done with one element.

    Attributes:
        bodies: Convex pieces ``<GlobalId>/0``, ..., in the element's frame.
        base_T_stock: ``base_T_element`` in its stock; None: its process does not move it.
        base_T_goal: ``base_T_element`` at its place, or as built where it stands.
        supports: Scene objects that it may touch in stock and at its place.
        up: Against gravity, a unit vector in the base.
        task_properties: Of the task's own `CTwin_RobotTask`.
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
        """The element in a sentence."""
        return (
            f"element {self.element.name!r} ({self.element.id})" if self.element.name else f"element {self.element.id}"
        )


@dataclass(frozen=True, eq=False)
class TaskMotions:
    """A whole task, planned.

    Attributes:
        method: How its process does it: of `place` the grip.
        scenes: One more than segments: of each, and the one after the last.
        planning_time: [s]
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


#: The stage of every process at which the arm does not get there at all.
REACH = "reach"


@dataclass(frozen=True)
class Process:
    """One process.

    Attributes:
        moves: It takes the element from its stock to its place; else a person is asked whether the task was carried out.
        overrides: By property of an element in the model.
        check_recipe: Takes a recipe, the tool, and file and name of the recipe; raises ConfigurationError.
        mass: Takes a job, name of its recipe, the recipe and the tool [kg]; None: unknown. Raises TaskPlanningError.
        acts: Name of the segment at whose end it acts.
        plan: Takes a `motions.Search`; raises `motions.AttemptFailed`, of the attempt that came furthest, or TaskPlanningError.
    """

    moves: bool
    recipe: type[Recipe]
    overrides: Mapping[str, Override]
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

#: Its property that racks of the kind `delivered` read.
DELIVERED = "Delivered"

_TYPES: dict[str, Any] = {"IfcLabel": str, "IfcInteger": int, "IfcReal": (int, float), "IfcBoolean": bool}


@dataclass(frozen=True)
class Recipes:
    """The recipes of one file, in their order."""

    file: str
    recipes: Mapping[str, Recipe]

    def of(self, job: WorkJob) -> tuple[str, Recipe]:
        """Return the name of the recipe for a job, and it with the overrides of the model.

        Raises:
            TaskPlanningError: If no recipe fits, or a property of `PROPERTY_SET` is wrong.
        """
        own = {name: value for name, value in job.element.properties.get(PROPERTY_SET, {}).items() if name != "id"}
        of_task = self._named(job, job.task_properties)
        name = of_task or self._named(job, own) or self._first(job)
        recipe = self.recipes[name]
        if of_task:
            # what the element says to the process of another task is not for this one
            others = {key for each in self.recipes.values() for key in process_of(each.process).overrides}
            others -= process_of(recipe.process).overrides.keys()
            own = {key: value for key, value in own.items() if key not in others}
        return name, self._overridden(job, recipe, {**own, **job.task_properties})

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
        name = own.get(RECIPE)
        if name is None:
            return ""
        if name not in self.recipes:
            raise _wrong(job, RECIPE, name, f"one of {', '.join(self.recipes)} in {self.file}")
        return str(name)

    def _first(self, job: WorkJob) -> str:
        element = job.element
        for name, recipe in self.recipes.items():
            if recipe.match.fits(element):
                return name
        kind = f"{element.ifc_class} {element.type_name!r}" if element.type_name else element.ifc_class
        to_do = f"add one, or name one in {PROPERTY_SET}"
        raise TaskPlanningError(job.task, f"no recipe of {self.file} fits {job.label}, {kind}; {to_do}")

    def _overridden(self, job: WorkJob, recipe: Recipe, own: Mapping[str, Value]) -> Recipe:
        overrides = process_of(recipe.process).overrides
        for name, value in own.items():
            if name in (RECIPE, DELIVERED) or value is None:
                continue
            if name not in overrides:
                near = difflib.get_close_matches(name, [*overrides, RECIPE, DELIVERED], n=1)
                known = f"no such property; did you mean {near[0]}?" if near else "no such property"
                raise _wrong(job, name, value, known)
            override = overrides[name]
            is_bool = override.ifc_type == "IfcBoolean"
            if isinstance(value, bool) != is_bool or not isinstance(value, _TYPES[override.ifc_type]):
                raise _wrong(job, name, value, override.ifc_type)
            document = recipe.model_dump()
            inner = document
            for key in override.key[:-1]:
                inner = inner[key]
            inner[override.key[-1]] = override.read(value)
            try:
                recipe = type(recipe).model_validate(document)
            except pydantic.ValidationError as error:
                wrong = wrong_value(error, type(recipe).model_json_schema())
                raise _wrong(job, name, value, f"{wrong.expected} ({override.ifc_type})") from error
        return recipe


class _File(Strict):
    recipes: Annotated[dict[str, dict[str, Any]], pydantic.Field(min_length=1)]


def read_recipes(path: str | Path) -> Recipes:
    """Read a recipes file."""
    description = read_yaml(path, " of recipes, as config/work/recipes.yaml")
    try:
        entries = _File.model_validate(description).recipes
    except pydantic.ValidationError as error:
        raise configuration_error(error, _File, str(path)) from error
    return Recipes(str(path), {name: _recipe(f"{path}/recipes/{name}", entry) for name, entry in entries.items()})


def _recipe(where: str, entry: dict[str, Any]) -> Recipe:
    process = entry.get("process", DEFAULT)
    if process not in list(MODULES):
        raise ConfigurationError(f"{where}/process", process, f"one of {', '.join(MODULES)}")
    recipe = process_of(process).recipe
    try:
        return recipe.model_validate(entry)
    except pydantic.ValidationError as error:
        raise configuration_error(error, recipe, where) from error


def _wrong(job: WorkJob, name: str, value: object, expected: str) -> TaskPlanningError:
    where = f"{job.label}, {PROPERTY_SET}.{name}"
    return TaskPlanningError(job.task, f"{where}: found {value!r}, expected {expected}")

"""The recipes of one file: which one an element is worked on with, and what the building model overrides of it.

The first recipe that fits is used, unless the task or the element names one.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import pydantic

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.validation import configuration_error, wrong_value
from construction_twin.extensions.work.building import Element, Task, Value
from construction_twin.extensions.work.errors import TaskPlanningError
from construction_twin.extensions.work.process import MODULES, WorkJob, process_of
from construction_twin.extensions.work.recipe import DEFAULT, PROPERTY_SET, RECIPE, Recipe, Strict
from construction_twin.robot.tool import Tool
from construction_twin.robot.urdf import read_yaml

#: Property of it that is read by racks of the kind `delivered`. But for this one and `RECIPE` they are the process's own,
#: `Process.overrides`.
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
        raise TaskPlanningError(job.task, f"no recipe of {self.file} fits {job.called}, {kind}; {to_do}")

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
    where = f"{job.called}, {PROPERTY_SET}.{name}"
    return TaskPlanningError(job.task, f"{where}: found {value!r}, expected {expected}")

"""The recipe of `place`. Metres, kilograms, seconds; degrees in ``_deg``. Each key is explained in config/work/recipes.yaml."""

from __future__ import annotations

from typing import Annotated, Literal

import pydantic

from construction_twin.core.errors import ConfigurationError
from construction_twin.extensions.work.errors import TaskPlanningError
from construction_twin.extensions.work.process import Finite, Length, Recipe, Scale, Strict, WorkJob
from construction_twin.robot.tool import Tool

_Small = Annotated[float, pydantic.Field(allow_inf_nan=False, ge=0.0, le=10.0)]
_Turn = Annotated[float, pydantic.Field(allow_inf_nan=False, ge=-360.0, le=360.0)]
_Axis = Literal["up", "+x", "-x", "+y", "-y", "+z", "-z"]
_Face = Literal["up", "+x", "-x", "+y", "-y", "+z", "-z", "any"]


def _not_zero(asked: str | tuple[float, float, float]) -> str | tuple[float, float, float]:
    if not isinstance(asked, str) and not any(asked):
        raise ValueError("a vector that is not zero")
    return asked


#: A direction: an axis of the element, up, or a vector in the robot's base_link.
Direction = Annotated[_Axis | tuple[Finite, Finite, Finite], pydantic.AfterValidator(_not_zero)]


class Grips(Strict):
    """Where an element may be gripped; lengths in m."""

    faces: Annotated[tuple[_Face, ...], pydantic.Field(min_length=1)] = ("up",)
    along: Annotated[tuple[Finite, ...], pydantic.Field(min_length=1)] = (0.0,)
    across: Annotated[tuple[Finite, ...], pydantic.Field(min_length=1)] = (0.0,)
    yaws_deg: Annotated[tuple[_Turn, ...], pydantic.Field(min_length=1)] = (0.0,)
    turns_deg: Annotated[tuple[_Turn, ...], pydantic.Field(min_length=1)] = (0.0,)
    min_cups: Annotated[int, pydantic.Field(ge=1, le=100)] = 1
    margin: _Small = 0.002
    lever: _Small = 0.05
    touching: Annotated[tuple[str, ...], pydantic.Field(min_length=1)]
    beside: tuple[str, ...] = ()


class Stock(Strict):
    """How the element is fetched; lengths in m."""

    approach: Length = 0.1
    leave: Annotated[tuple[Direction, ...], pydantic.Field(min_length=1)] = ("up",)
    lengths: Annotated[tuple[Length, ...], pydantic.Field(min_length=1)] = (0.1,)


class Place(Strict):
    """How the element is set down; lengths in m."""

    arrive: Annotated[tuple[Direction, ...], pydantic.Field(min_length=1)] = ("up",)
    lengths: Annotated[tuple[Length, ...], pydantic.Field(min_length=1)] = (0.1,)
    retreat: Length = 0.1
    fastened: bool = False


class PlaceRecipe(Recipe):
    """How elements of one kind are placed; `mass`: of elements without one in the model [kg], None: refused."""

    grips: Grips
    stock: Stock = Stock()
    place: Place = Place()
    carry_speed_scale: Scale
    carry_engaged: bool = False
    mass: Annotated[float, pydantic.Field(gt=0.0, le=1e4)] | None = None


def mass_of(job: WorkJob, name: str, recipe: PlaceRecipe, tool: Tool) -> float:
    """Return the mass that an element is placed with [kg]."""
    mass = recipe.mass if job.element.mass is None else job.element.mass
    if mass is None:
        said = f"give it a weight or a density in the model, or recipe {name!r} a mass"
        raise TaskPlanningError(job.task, f"the mass of {job.label} is not known: {said}")
    if not mass > 0.0:
        raise TaskPlanningError(job.task, f"{job.label} has a mass of {mass:g} kg; expected above 0")
    if mass > tool.payload:
        most = f"tool {tool.name!r} carries at most {tool.payload:g} kg"
        raise TaskPlanningError(job.task, f"{job.label} has {mass:.1f} kg; {most}")
    if tool.mass + mass > tool.load:
        both = f"{job.label} and tool {tool.name!r} together have {tool.mass + mass:.1f} kg"
        raise TaskPlanningError(job.task, f"{both}; the controller's load data are for {tool.load:g} kg")
    return mass


def check_tool(recipe: PlaceRecipe, tool: Tool, where: str) -> None:
    """Check that a recipe names shapes that the tool has."""
    for key, shapes in (("touching", recipe.grips.touching), ("beside", recipe.grips.beside)):
        for shape in shapes:
            if shape not in tool.shapes:
                known = ", ".join(tool.shapes)
                raise ConfigurationError(f"{where}/grips/{key}", shape, f"one of the tool's shapes: {known}")

"""What every recipe has, whatever its process, and how the building model overrides a key of one.

Metres, seconds; a process adds its own keys, see `process.Process.recipe`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import pydantic

from construction_twin.work.building import Value
from construction_twin.work.matching import Match

#: The model's own property set for this package.
PROPERTY_SET = "CTwin_RobotTask"
#: Its property that chooses a recipe by its name, of an element or of a task.
RECIPE = "Recipe"
#: The process of a recipe that names none.
DEFAULT = "place"

Finite = Annotated[float, pydantic.Field(allow_inf_nan=False, ge=-1e4, le=1e4)]
Length = Annotated[float, pydantic.Field(allow_inf_nan=False, gt=0.0, le=10.0)]
Scale = Annotated[float, pydantic.Field(gt=0.0, le=1.0)]


class Strict(pydantic.BaseModel):
    """A part of a recipe: an unknown key is refused."""

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)


class Recipe(Strict):
    """How elements of one kind are worked on.

    Attributes:
        match: Which elements.
        process: Name of the process, see `processes`.
        speed: Of the tool on the straight ways [m/s].
        free_speed_scale: Fraction of the joints' limits on the free ways.
        penetration: How deep bodies that may touch may be in each other, by rounding and by inexact pieces [m].
    """

    match: Match = Match()
    process: str = DEFAULT
    speed: Annotated[float, pydantic.Field(gt=0.0, le=2.0)]
    free_speed_scale: Scale
    penetration: Annotated[float, pydantic.Field(ge=0.0, le=0.02)] = 0.0005


@dataclass(frozen=True)
class Override:
    """A property of an element in the model that replaces a key of its recipe.

    Attributes:
        key: The key of the recipe that it replaces.
        ifc_type: Type of its value.
        meaning: For documents.
        read: From the property's value to the key's.
    """

    key: tuple[str, ...]
    ifc_type: str
    meaning: str
    read: Callable[[Value], Any]


def same(value: Value) -> Value:
    """Return a property as it is."""
    return value


def words(value: Value) -> tuple[str, ...]:
    """Return a text as words."""
    return tuple(str(value).split())


def numbers(value: Value) -> tuple[float, ...] | tuple[str, ...]:
    """Return a text as numbers; as words when one is none, so that the recipe refuses it."""
    found = str(value).split()
    try:
        return tuple(map(float, found))
    except ValueError:
        return tuple(found)


#: What every process lets the model override.
SHARED: Mapping[str, Override] = {
    "Speed": Override(("speed",), "IfcReal", "of the tool on the straight ways [m/s]", same)
}

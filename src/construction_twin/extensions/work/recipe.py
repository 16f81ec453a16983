"""What every recipe has, and how the building model overrides a key of one. Metres, seconds."""

from __future__ import annotations

import fnmatch
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import pydantic

from construction_twin.extensions.work.building import Element, Value

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


@dataclass(frozen=True)
class Override:
    """A property in the model that replaces a key of the recipe."""

    key: tuple[str, ...]
    ifc_type: str
    read: Callable[[Value], Any] = lambda value: value


def words(value: Value) -> tuple[str, ...]:
    """Return a text as words."""
    return tuple(str(value).split())


def numbers(value: Value) -> tuple[float, ...] | tuple[str, ...]:
    """Return a text as numbers; as words when one is none, for the recipe to refuse."""
    found = str(value).split()
    try:
        return tuple(map(float, found))
    except ValueError:
        return tuple(found)


#: What every process lets the model override.
SHARED: Mapping[str, Override] = {"Speed": Override(("speed",), "IfcReal")}

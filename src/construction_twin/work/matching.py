"""Which elements an entry of a recipes or cell file is for: by IFC class, type name, name, GlobalId and property values."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping
from typing import Annotated, Protocol

import pydantic

from construction_twin.work.building import Value

#: ``Pset_Name.Property``
_Property = Annotated[str, pydantic.Field(pattern=r"^[^.]+\.[^.]+$")]


class Described(Protocol):
    """What is asked of an element."""

    @property
    def id(self) -> str:
        """GlobalId."""

    @property
    def ifc_class(self) -> str:
        """``IfcMember``."""

    @property
    def name(self) -> str:
        """Its name in the model."""

    @property
    def type_name(self) -> str:
        """Name of its type."""

    @property
    def properties(self) -> Mapping[str, Mapping[str, Value]]:
        """Values by property set and name."""


class Match(pydantic.BaseModel):
    """What an element must be; everything that is given must hold. Nothing given: every element.

    Attributes:
        ifc_class: One of these: ``IfcMember``.
        type_name, name: Patterns with ``*`` and ``?``, upper and lower case alike; empty: any.
        elements: GlobalIds or whole names, one of these.
        properties: ``Pset_MemberCommon.Reference: S1``: the property must have exactly this value.
    """

    model_config = pydantic.ConfigDict(extra="forbid", frozen=True)

    ifc_class: tuple[str, ...] = ()
    type_name: str = ""
    name: str = ""
    elements: tuple[str, ...] = ()
    properties: dict[_Property, bool | int | float | str] = {}

    def fits(self, element: Described) -> bool:
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

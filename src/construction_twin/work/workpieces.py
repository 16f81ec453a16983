"""Which elements the robot places, unless it is told otherwise: those that are delivered in one piece."""

from __future__ import annotations

import re
from collections.abc import Iterable

from construction_twin.core.sentences import Sentence
from construction_twin.core.work_errors import BuildingError
from construction_twin.work.building import BuildingModel, Element

#: Classes of elements that are delivered in one piece.
CLASSES = (
    "IfcMember",
    "IfcBeam",
    "IfcColumn",
    "IfcPlate",
    "IfcCovering",
    "IfcBuildingElementPart",
    "IfcSlab",
    "IfcBuildingElementProxy",
    "IfcProxy",
    "IfcWall",
    "IfcElementAssembly",
)


def plain_class(ifc_class: str) -> str:
    """Return a class without the cases that IFC2x3 and IFC4 make classes of: ``IfcWall`` for ``IfcWallStandardCase``."""
    return re.sub("(StandardCase|ElementedCase)$", "", ifc_class)


def is_workpiece(element: Element, has_parts: bool) -> bool:
    """Return whether an element is a workpiece by default.

    Args:
        has_parts: Whether other elements with bodies are parts of it.
    """
    # what stands already is no workpiece
    kind = plain_class(element.ifc_class)
    if not element.bodies or element.status or kind not in CLASSES:
        return False
    # a wall of several bodies, or what is made of parts, is built and not placed
    return not (has_parts and kind in ("IfcWall", "IfcElementAssembly")) and (
        kind != "IfcWall" or len(element.bodies) == 1
    )


def workpieces(model: BuildingModel, also: Iterable[str] = (), only: Iterable[str] = ()) -> tuple[str, ...]:
    """Return which elements the robot places.

    Args:
        also: GlobalIds, or IFC classes (``IfcWall`` means ``IfcWallStandardCase`` too), in addition to those by default.
        only: The same, instead of those by default.

    Returns:
        GlobalIds in the file's order.

    Raises:
        BuildingError: If a name is neither the id of an element nor the class of one, or an element asked for by its id has no
            geometry.
    """
    only = tuple(only)
    named = (*only, *also)
    classes = {plain_class(element.ifc_class) for element in model.elements.values()}
    for name in named:
        if name in model.elements:
            if not model.elements[name].bodies:
                raise BuildingError(model.file, f"element {name!r}", "no geometry", Sentence("expected.work.body"))
        elif plain_class(name) not in classes:
            expected = Sentence("expected.work.class")
            raise BuildingError(model.file, f"workpieces {name!r}", "nothing of that name", expected)
    wanted = {plain_class(name) if name not in model.elements else name for name in named}
    parents = {element.assembly for element in model.elements.values() if element.bodies}
    return tuple(
        element.id
        for element in model.elements.values()
        if element.bodies
        and not element.status
        and (
            (not only and is_workpiece(element, element.id in parents))
            or element.id in wanted
            or plain_class(element.ifc_class) in wanted
        )
    )

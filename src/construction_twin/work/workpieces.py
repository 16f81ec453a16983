"""Which elements the robot places: those that are delivered in one piece."""

from __future__ import annotations

import re

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
    """Return whether an element is a workpiece."""
    # what stands already is no workpiece
    kind = plain_class(element.ifc_class)
    if not element.bodies or element.status or kind not in CLASSES:
        return False
    # a wall of several bodies, or what is made of parts, is built and not placed
    return not (has_parts and kind in ("IfcWall", "IfcElementAssembly")) and (
        kind != "IfcWall" or len(element.bodies) == 1
    )


def workpieces(model: BuildingModel) -> tuple[str, ...]:
    """Return which elements the robot places: GlobalIds in the file's order."""
    parents = {element.assembly for element in model.elements.values() if element.bodies}
    return tuple(element.id for element in model.elements.values() if is_workpiece(element, element.id in parents))

"""Which representation of a product is its body, what it is made of, and how far that reaches.

Mapped items are followed here before the geometry kernel does: a loop, or a few lines that mean a million copies, is refused.
"""

from __future__ import annotations

from collections.abc import Iterator

import ifcopenshell
import numpy as np

from construction_twin.extensions.work.errors import BuildingError
from construction_twin.extensions.work.ifc.notes import Where, label

#: Identifiers of representations that are a body, the best first.
_BODIES = ("Body", "Body-FallBack", "Facetation", "Tessellation", "Mesh")
#: What a representation without one of those identifiers must be to be taken as the body.
_SOLID = {
    "SweptSolid", "AdvancedSweptSolid", "Brep", "AdvancedBrep", "CSG", "Clipping", "SolidModel", "SurfaceModel", "Surface3D",
    "Tessellation", "MappedRepresentation",
}  # fmt: skip
#: Identifiers of what has a surface and is no body.
_NO_BODIES = (
    *("Axis", "FootPrint", "Box", "Annotation", "Plan", "Clearance", "CoG", "Profile", "Reference", "Surface"),
    "Lighting",
)
#: Items that lie between their points.
_FLAT = ("IfcFacetedBrep", "IfcTessellatedFaceSet")
#: What reaches nowhere, or without an end and only cuts.
_NO_REACH = ("IfcHalfSpaceSolid", "IfcRepresentationContext", "IfcDirection", "IfcPresentationItem")
#: Copies by mapped items, and operands of booleans, of one element.
MOST_ITEMS = 100_000
DEEPEST = 200


def body_of(product: ifcopenshell.entity_instance) -> ifcopenshell.entity_instance | None:
    """Return a product's body representation; None: it has none."""
    definition = getattr(product, "Representation", None)
    representations = [] if definition is None else [r for r in definition.Representations if r.is_a("IfcShapeModel")]
    for identifier in _BODIES:
        for representation in representations:
            if representation.RepresentationIdentifier == identifier:
                return representation
    for representation in representations:
        if representation.RepresentationIdentifier not in _NO_BODIES and representation.RepresentationType in _SOLID:
            return representation
    return None


class Items:
    """Items of the representations of a file."""

    def __init__(self, name: str):
        self._name = name
        self._counts: dict[int, int] = {}

    def check(self, representation: ifcopenshell.entity_instance) -> None:
        """Check that a representation is no loop and of bounded size."""
        self._count(representation, ())

    def _count(self, node: ifcopenshell.entity_instance, path: tuple[int, ...]) -> int:
        if (known := self._counts.get(node.id())) is not None:
            return known
        if node.id() in path:
            raise BuildingError(self._name, label(node), "geometry that contains itself", "geometry without a loop")
        if len(path) >= DEEPEST:
            raise BuildingError(self._name, label(node), f"geometry nested {DEEPEST} deep", "less")
        count = 1
        with Where(self._name, node):
            parts = _parts(node)
        for part in parts:
            count += self._count(part, (*path, node.id()))
            if count > MOST_ITEMS:
                raise BuildingError(self._name, label(node), f"more than {MOST_ITEMS} items by mapping", "less")
        self._counts[node.id()] = count
        return count

    def resolved(self, representation: ifcopenshell.entity_instance) -> list[ifcopenshell.entity_instance]:
        """Return the items of a representation that was checked, those of mapped items in their place."""
        with Where(self._name, representation):
            return list(_resolved(representation))


def _parts(node: ifcopenshell.entity_instance) -> tuple[ifcopenshell.entity_instance, ...]:
    if node.is_a("IfcShapeModel"):
        return tuple(node.Items)
    if node.is_a("IfcMappedItem"):
        return (node.MappingSource.MappedRepresentation,)
    if node.is_a("IfcBooleanResult"):
        return (node.FirstOperand, node.SecondOperand)
    if node.is_a("IfcCsgSolid"):
        return (node.TreeRootExpression,)
    return ()


def _resolved(representation: ifcopenshell.entity_instance) -> Iterator[ifcopenshell.entity_instance]:
    for item in representation.Items:
        if item.is_a("IfcMappedItem"):
            yield from _resolved(item.MappingSource.MappedRepresentation)
        else:
            yield item


def bounds(node: ifcopenshell.entity_instance) -> np.ndarray:
    """Return the lowest and highest coordinates of a representation or one of its items [unit of the file], shape (2, 3).

    What flat faces bound is as large as its points; of other items see `reach`.
    """
    if node.is_a("IfcRepresentation"):
        boxes = [bounds(item) for item in node.Items]
        return np.array([np.min(boxes, axis=(0, 1)), np.max(boxes, axis=(0, 1))]) if boxes else np.zeros((2, 3))
    points = list(_points(node)) if any(node.is_a(kind) for kind in _FLAT) else []
    if not points:
        return reach(node) * np.array([[-1.0] * 3, [1.0] * 3])
    return np.array([np.min(points, axis=0), np.max(points, axis=0)])


def _points(value: object) -> Iterator[tuple[float, ...]]:
    if isinstance(value, tuple):
        for each in value:
            yield from _points(each)
    elif isinstance(value, ifcopenshell.entity_instance):
        if value.is_a("IfcCartesianPoint"):
            yield value.Coordinates
        elif value.is_a("IfcCartesianPointList3D"):
            yield from value.CoordList
        else:
            yield from _points(tuple(value))


def reach(node: ifcopenshell.entity_instance, known: dict[int, float] | None = None) -> float:
    """Return how far from its origin a representation or one of its items reaches at most, in the file's units.

    Points, lengths and axes of what is nested are added, of what is side by side the largest counts, a half space only cuts. Far
    too large for most, too small only for a line that is cut by its parameters.
    """
    known = {} if known is None else known
    if node.id() == 0 or any(node.is_a(kind) for kind in _NO_REACH):
        return 0.0
    if node.id() in known:
        return known[node.id()]
    found, scale = 0.0, 1.0
    for name, value in node.get_info(include_identifier=False).items():
        if isinstance(value, ifcopenshell.entity_instance):
            if value.is_a("IfcCartesianTransformationOperator"):
                scale = max(abs(getattr(value, each, None) or 1.0) for each in ("Scale", "Scale2", "Scale3"))
            # what is turned about an axis reaches beyond it
            found += reach(value, known) * (2.0 if value.is_a("IfcAxis1Placement") else 1.0)
        elif isinstance(value, tuple):
            found += max((_reach_of(each, name, known) for each in value), default=0.0)
        elif isinstance(value, float) and not any(word in name for word in ("Angle", "Param", "Scale")):
            found += abs(value)
    known[node.id()] = found * max(1.0, scale)
    return known[node.id()]


def _reach_of(value: object, name: str, known: dict[int, float]) -> float:
    if isinstance(value, ifcopenshell.entity_instance):
        return reach(value, known)
    if isinstance(value, tuple):
        return max((_reach_of(each, name, known) for each in value), default=0.0)
    # the largest coordinate of a point is within its distance
    return 2.0 * abs(value) if isinstance(value, float) and name.startswith("Coord") else 0.0

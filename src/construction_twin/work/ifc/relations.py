"""Which object is part of which: aggregation, nesting, storeys. Loops are refused here, before anything follows the relations."""

from __future__ import annotations

from dataclasses import dataclass

import ifcopenshell

from construction_twin.core.sentences import Sentence
from construction_twin.core.work_errors import BuildingError
from construction_twin.work.ifc.notes import Where, label


@dataclass(frozen=True)
class Relations:
    """Parents by the id of the part.

    Attributes:
        whole: What a part is aggregated or nested into.
        container: Spatial element that holds an element.
        openings: What is cut from an element.
    """

    whole: dict[int, ifcopenshell.entity_instance]
    container: dict[int, ifcopenshell.entity_instance]
    openings: dict[int, list[ifcopenshell.entity_instance]]

    def wholes(self, entity: ifcopenshell.entity_instance) -> list[ifcopenshell.entity_instance]:
        """Return what an entity is part of, the nearest first."""
        found: list[ifcopenshell.entity_instance] = []
        whole = self.whole.get(entity.id())
        while whole is not None:
            found.append(whole)
            whole = self.whole.get(whole.id())
        return found

    def storey(self, entity: ifcopenshell.entity_instance) -> str:
        """Return the name of the storey, or of the smallest other part of the site, that holds an element or what it is part of."""
        for each in (entity, *self.wholes(entity)):
            if (container := self.container.get(each.id())) is None:
                continue
            spaces = (container, *self.wholes(container))
            storeys = [space for space in spaces if space.is_a("IfcBuildingStorey")]
            return (storeys or spaces)[0].Name or ""
        return ""


def read_relations(file: ifcopenshell.file, name: str) -> Relations:
    """Read them.

    Raises:
        BuildingError: If something is part of itself.
    """
    whole: dict[int, ifcopenshell.entity_instance] = {}
    # in IFC2x3 both are subtypes of IfcRelDecomposes; nesting of tasks and resources is read with them, for its loops
    for relation in (*file.by_type("IfcRelAggregates"), *file.by_type("IfcRelNests")):
        with Where(name, relation):
            for part in relation.RelatedObjects:
                whole.setdefault(part.id(), relation.RelatingObject)
    container: dict[int, ifcopenshell.entity_instance] = {}
    for relation in file.by_type("IfcRelContainedInSpatialStructure"):
        with Where(name, relation):
            for part in relation.RelatedElements:
                container.setdefault(part.id(), relation.RelatingStructure)
    openings: dict[int, list[ifcopenshell.entity_instance]] = {}
    for relation in file.by_type("IfcRelVoidsElement"):
        with Where(name, relation):
            openings.setdefault(relation.RelatingBuildingElement.id(), []).append(relation.RelatedOpeningElement)
    _refuse_loops(file, name, whole)
    return Relations(whole, container, openings)


def _refuse_loops(file: ifcopenshell.file, name: str, whole: dict[int, ifcopenshell.entity_instance]) -> None:
    good: set[int] = set()
    for start in whole:
        seen: dict[int, None] = {}
        at: int | None = start
        while at is not None and at not in good:
            if at in seen:
                loop = list(seen)[list(seen).index(at) :]
                shown = " in ".join(label(file.by_id(each)) for each in loop[:4])
                raise BuildingError(
                    name,
                    label(file.by_id(at)),
                    Sentence("ifc.found.part_of_itself", loop=shown),
                    Sentence("ifc.no_part_loop"),
                )
            seen[at] = None
            parent = whole.get(at)
            at = None if parent is None else parent.id()
        good.update(seen)

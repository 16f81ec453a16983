"""Which object is part of, in or on which: aggregation, nesting, fillings. Loops are refused before anything follows."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter

import ifcopenshell

from construction_twin.extensions.work.errors import BuildingError
from construction_twin.extensions.work.ifc.notes import ReadingEntity, label

_Entity = ifcopenshell.entity_instance
_Entities = dict[int, list[_Entity]]
#: Relations of what is in or on elements: attributes of the elements, and of what is in or on them.
_ON = {
    "IfcRelFillsElement": (("RelatingOpeningElement",), "RelatedBuildingElement"),
    "IfcRelCoversBldgElements": (("RelatingBuildingElement",), "RelatedCoverings"),
    "IfcRelProjectsElement": (("RelatingElement",), "RelatedFeatureElement"),
    "IfcRelConnectsWithRealizingElements": (("RelatingElement", "RelatedElement"), "RealizingElements"),
}


@dataclass(frozen=True)
class Relations:
    """By id: the whole of a part, openings of an element, what something is on, and what a group or part of the site holds."""

    whole: dict[int, _Entity]
    openings: _Entities
    on: _Entities
    members: _Entities

    def within(self, group: _Entity) -> list[_Entity]:
        """Return what a group or a part of the site holds, what holds things itself replaced by these."""
        found: dict[int, _Entity] = {}
        left, visited = [group], set()
        while left:
            at = left.pop(0)
            if at.id() in visited:
                continue
            visited.add(at.id())
            if at.id() in self.members:
                left += self.members[at.id()]
            elif at is not group:
                found[at.id()] = at
        return [found[number] for number in sorted(found)]

    def wholes(self, entity: _Entity) -> list[_Entity]:
        """Return what an entity is part of, the nearest first."""
        found: list[_Entity] = []
        whole = self.whole.get(entity.id())
        while whole is not None:
            found.append(whole)
            whole = self.whole.get(whole.id())
        return found


def read_relations(file: ifcopenshell.file, name: str) -> Relations:
    """Read them."""
    whole: dict[int, _Entity] = {}
    members: _Entities = defaultdict(list)
    # in IFC2x3 both are subtypes of IfcRelDecomposes; nesting of tasks and resources is read with them, for its loops
    for relation in (*file.by_type("IfcRelAggregates"), *file.by_type("IfcRelNests")):
        with ReadingEntity(name, relation):
            for part in relation.RelatedObjects:
                whole.setdefault(part.id(), relation.RelatingObject)
                if relation.RelatingObject.is_a("IfcProduct") and not relation.RelatingObject.is_a("IfcElement"):
                    members[relation.RelatingObject.id()].append(part)
    for relation in file.by_type("IfcRelContainedInSpatialStructure"):
        with ReadingEntity(name, relation):
            for part in relation.RelatedElements:
                members[relation.RelatingStructure.id()].append(part)
    for relation in file.by_type("IfcRelAssignsToGroup"):
        with ReadingEntity(name, relation):
            members[relation.RelatingGroup.id()] += relation.RelatedObjects
    voided: dict[int, _Entity] = {}
    openings: _Entities = defaultdict(list)
    for relation in file.by_type("IfcRelVoidsElement"):
        with ReadingEntity(name, relation):
            openings[relation.RelatingBuildingElement.id()].append(relation.RelatedOpeningElement)
            voided[relation.RelatedOpeningElement.id()] = relation.RelatingBuildingElement
    refuse_loops(file, name, whole)
    return Relations(whole, dict(openings), _on(file, name, voided), dict(members))


def _on(file: ifcopenshell.file, name: str, voided: dict[int, _Entity]) -> _Entities:
    found: _Entities = defaultdict(list)
    for kind, (hosts, guests) in _ON.items():
        for relation in file.by_type(kind):
            with ReadingEntity(name, relation):
                given = getattr(relation, guests)
                for host in filter(None, (getattr(relation, attribute) for attribute in hosts)):
                    # what fills an opening is in the element that it is cut out of
                    element = voided.get(host.id(), host)
                    for guest in filter(None, given if isinstance(given, tuple) else (given,)):
                        found[guest.id()].append(element)
    return dict(found)


def refuse_loops(file: ifcopenshell.file, name: str, whole: dict[int, _Entity]) -> None:
    """Raise BuildingError where an entity is part of itself."""
    try:
        TopologicalSorter({part: (parent.id(),) for part, parent in whole.items()}).prepare()
    except CycleError as error:
        # from the part to its whole
        loop = [label(file.by_id(each)) for each in reversed(error.args[1])]
        found = f"part of itself ({' in '.join(loop[:4])} ...)"
        raise BuildingError(name, loop[0], found, "no loop of parts") from error

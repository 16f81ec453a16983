"""What a file says that nothing here reads, as notes: an answer that leaves it out must not look like one that knows it."""

from __future__ import annotations

import ifcopenshell

from construction_twin.core.sentences import Sentence
from construction_twin.work.building import Element
from construction_twin.work.ifc.notes import Notes, Where

#: Entities whose meaning the work would need, and what is not done with them.
_UNREAD = {
    "IfcWorkCalendar": "calendars: lags and durations count around the clock",
    "IfcTaskTimeRecurring": "times of tasks that are repeated: only the first is read",
    "IfcEvent": "events: no task waits for one",
    "IfcProcedure": "procedures: no task waits for one",
    "IfcOrderAction": "actions of an order (IFC2x3), of which only what every task has is read",
    "IfcRelConnectsElements": "connections of elements: what holds what is seen from the shapes only",
    "IfcRelConnectsStructuralActivity": "loads",
    "IfcRelProjectsElement": "projections from elements, which stand as elements of their own",
    "IfcRelInterferesElements": "interferences that their author knows of",
    "IfcConstraint": "constraints",
}


def note_unread(file: ifcopenshell.file, name: str, elements: dict[str, Element], notes: Notes) -> None:
    """Note what is in a file and not read, and what has no body and so is no obstacle.

    Args:
        name: For messages.
    """
    with Where(name, Sentence("ifc.file")):
        for kind, meaning in _UNREAD.items():
            try:
                count = len(file.by_type(kind))
            except RuntimeError:
                # not of this schema
                continue
            if count:
                notes.add(f"Not read: {count} {kind}, {meaning}")
    wholes = {element.assembly for element in elements.values()}
    for element in elements.values():
        if not element.bodies and element.id not in wholes:
            notes.add("Elements without a body are no obstacle", element.name or element.id, element.id)

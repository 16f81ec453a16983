"""What a file says that nothing here reads, as notes: an answer that leaves it out must not look like one that knows it."""

from __future__ import annotations

import ifcopenshell

from construction_twin.core.sentences import Sentence
from construction_twin.work.building import Element
from construction_twin.work.ifc.notes import Notes, Where

#: Entities whose meaning the work would need, and what is not done with them.
_UNREAD = {
    "IfcWorkCalendar": Sentence("ifc.unread.calendars"),
    "IfcTaskTimeRecurring": Sentence("ifc.unread.recurring"),
    "IfcEvent": Sentence("ifc.unread.events"),
    "IfcProcedure": Sentence("ifc.unread.procedures"),
    "IfcOrderAction": Sentence("ifc.unread.orders"),
    "IfcRelConnectsElements": Sentence("ifc.unread.connections"),
    "IfcRelConnectsStructuralActivity": Sentence("ifc.unread.loads"),
    "IfcRelInterferesElements": Sentence("ifc.unread.interferences"),
    "IfcConstraint": Sentence("ifc.unread.constraints"),
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
                notes.add(Sentence("ifc.note.unread", count=count, kind=kind, meaning=meaning))
    wholes = {element.assembly for element in elements.values()}
    for element in elements.values():
        if not element.bodies and element.id not in wholes:
            notes.add(Sentence("ifc.note.no_body"), element.name or element.id, element.id)

"""What comes together, and what is there only when other elements stand: parts, fillings, coverings, projections, fasteners.

In: elements with what each is a part of, in or on. A part comes with its whole, in one piece; what joins, fills or covers comes
after what it is on. Metres, kilograms.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace

from construction_twin.extensions.work.building import Body, BuildingModel, Element, Task
from construction_twin.scene.objects import relative

#: Classes of elements that are delivered in one piece.
CLASSES = (
    *("IfcMember", "IfcBeam", "IfcColumn", "IfcPlate", "IfcCovering", "IfcBuildingElementPart", "IfcSlab"),
    *("IfcBuildingElementProxy", "IfcProxy", "IfcWall", "IfcElementAssembly"),
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
    built = has_parts and kind in ("IfcWall", "IfcElementAssembly")
    return not built and (kind != "IfcWall" or len(element.bodies) == 1)


def workpieces(model: BuildingModel) -> tuple[str, ...]:
    """Return which elements the robot places: GlobalIds in the file's order."""
    parents = {element.assembly for element in model.elements.values() if element.bodies}
    return tuple(element.id for element in model.elements.values() if is_workpiece(element, element.id in parents))


#: Parts that join their whole to others: they come after it, but for those of a whole that comes from a factory.
_JOINS = ("IfcFastener", "IfcMechanicalFastener")
#: What is on an element and made of it.
_PROJECTS = "IfcProjectionElement"


def parts_of(elements: Mapping[str, Element], whole: str) -> list[str]:
    """Return what is a part of an element, or of a part of it, or what a group holds; nearest first."""
    return _below(_dependents(elements)[0], whole)


def in_one_piece(
    elements: Mapping[str, Element], tasks: Mapping[str, Task], factory: Collection[str]
) -> dict[str, Element]:
    """Return the wholes that come in one piece, with bodies and mass of all that comes with them, and that without bodies.

    `factory`: Assemblies that are made elsewhere: in one piece unless a task names a part of them. Any other whole is so if it has
    a body of its own and a task places it; parts that a task names, or that stand already, are not of it.
    """
    placed = {one for task in tasks.values() if task.kind == "makes" for one in task.products}
    named = {one for task in tasks.values() for one in (*task.products, *task.inputs)}
    parts, guests = _dependents(elements)
    found: dict[str, Element] = {}
    for name in sorted(elements, key=lambda one: len(wholes(elements, one))):
        whole, below = found.get(name, elements[name]), _below(parts, name)
        prefabricated = name in factory and named.isdisjoint(below)
        if whole.status or not (prefabricated or (whole.bodies and name in placed)):
            continue
        with_it: dict[str, None] = {}
        left = [*parts[name], *guests[name]]
        while left:
            one = left.pop(0)
            part = found.get(one, elements[one])
            of_it = part.assembly in (name, *with_it) and part.ifc_class not in _JOINS
            comes = of_it or part.ifc_class == _PROJECTS or (prefabricated and {*part.on} <= {name, *below})
            if one not in with_it and one not in named and not part.status and comes:
                with_it[one] = None
                left += [*parts[one], *guests[one]]
        joined = [part for part in (found.get(one, elements[one]) for one in with_it) if part.bodies]
        if joined:
            found[name] = _joined(whole, joined, prefabricated)
            found |= {part.id: replace(part, bodies=()) for part in joined}
    return found


def comes_after(elements: Mapping[str, Element], placed: Collection[str]) -> dict[str, frozenset[str]]:
    """Return the elements that must have been placed before what no task makes is there, of that which waits for any.

    It waits for what it is on or a part of; where that is not placed itself, for all of its parts that are. A workpiece that is a
    part of what is built of parts waits for none of them: people place it when they like.
    """
    of_whole: dict[str, set[str]] = defaultdict(set)
    for one in placed:
        for whole in (one, *wholes(elements, one)):
            of_whole[whole].add(one)
    with_parts = {element.assembly for element in elements.values()}

    def before(hosts: Iterable[str], visited: tuple[str, ...]) -> set[str]:
        found: set[str] = set()
        for host in hosts:
            element = elements.get(host)
            # what stands has what is on it
            if element is None or element.status or host in visited:
                continue
            found |= of_whole.get(host) or before((element.assembly, *element.on), (*visited, host))
        return found

    found = {}
    for name, element in elements.items():
        if not element.bodies or element.status or name in of_whole:
            continue
        as_part = before((element.assembly,), (name,))
        if is_workpiece(element, name in with_parts):
            as_part &= {*wholes(elements, name)}
        if first := as_part | before(element.on, (name,)):
            found[name] = frozenset(first)
    return found


def _dependents(elements: Mapping[str, Element]) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Return the parts or members of elements, and what is on them."""
    parts: dict[str, list[str]] = defaultdict(list)
    guests: dict[str, list[str]] = defaultdict(list)
    for name, element in elements.items():
        parts[name] += element.members
        parts[element.assembly].append(name)
        for host in element.on:
            guests[host].append(name)
    return parts, guests


def _below(parts: Mapping[str, list[str]], whole: str) -> list[str]:
    found: dict[str, None] = {}
    left = [*parts[whole]]
    while left:
        at = left.pop(0)
        if at not in found:
            found[at] = None
            left += parts[at]
    return list(found)


def wholes(elements: Mapping[str, Element], name: str) -> tuple[str, ...]:
    """Return what an element is a part of, the nearest first."""
    found: dict[str, None] = {}
    at = elements[name].assembly
    while at in elements and at not in found:
        found[at] = None
        at = elements[at].assembly
    return tuple(found)


def _joined(whole: Element, parts: list[Element], prefabricated: bool) -> Element:
    masses = [element.mass for element in (whole, *parts) if element.bodies]
    mass = None if None in masses else sum(mass for mass in masses if mass is not None)
    # what a whole from a factory weighs is said of all of it
    mass = whole.mass if prefabricated and whole.mass is not None else mass
    bodies = [*whole.bodies]
    for part in parts:
        at = relative(whole.model_T_element, part.model_T_element)
        bodies += [Body(body.vertices @ at.rotation.T + at.position, body.triangles) for body in part.bodies]
    doubt = next((one.doubt for one in (whole, *parts) if one.doubt), "")
    return replace(whole, bodies=tuple(bodies), mass=mass, doubt=doubt)

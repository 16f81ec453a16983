"""A building model as read by `ifc`: elements with bodies, tasks, their order, and what comes in one piece.

Metres, kilograms, seconds. Frames: `model` is the model's own coordinate system, without map conversion; `element` is the product's
placement. An id is a GlobalId, or ``#123``, a number in the file, where that is missing, wrong or another one's. A part comes with
its whole, in one piece; what joins, fills or covers comes after what it is on.
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from construction_twin.core.errors import ConfigurationError, ConstructionTwinError
from construction_twin.core.sentences import Sentence
from construction_twin.kinematics.chain import Pose
from construction_twin.scene.objects import relative


class WorkError(ConstructionTwinError):
    """Root of the errors of work from a building model."""


class BuildingError(WorkError):
    """A building model cannot be used."""

    def __init__(self, file: str, what: str, found: str, expected: str):
        self.file, self.what, self.found, self.expected = file, what, found, expected
        super().__init__(f"{file}: {what}: found {found}, expected {expected}")


class ScheduleError(WorkError):
    """The order of the tasks makes no sense."""


class PlacementError(WorkError):
    """The model does not stand where the robot is."""


#: An id, in quotes or not, with the number or word of a body or job.
_ID = re.compile(r"""(?<![\w$#/])(['"]?)(([\w$#]{1,64})(?:/\w+)?)\1(?![\w$/])""")


def labels(names: Mapping[str, str]) -> dict[str, str]:
    """Return the name of each id in quotes, with the id where others have it."""
    count = Counter(names.values())
    return {key: repr(name) if count[name] == 1 else f"{name!r} ({key})" for key, name in names.items() if name}


def with_names(text: str, known: Mapping[str, str]) -> str:
    """Return a sentence with names for ids, in the values of a `Sentence` too."""
    named = _ID.sub(lambda found: known.get(found[2]) or known.get(found[3]) or found[0], text)
    if not isinstance(text, Sentence):
        return named
    values = {key: with_names(value, known) if isinstance(value, str) else value for key, value in text.values.items()}
    return Sentence.of(named, text.template, values)


def first_few(names: Iterable[str], most: int = 10) -> str:
    """Return the first `most` names with commas between them, and how many more there are."""
    every = tuple(names)
    first = ", ".join(every[:most])
    return f"{first} and {len(every) - most} more" if len(every) > most else first


#: Values of properties and quantities, as IFC has them.
Value = str | float | int | bool | None


@dataclass(frozen=True, eq=False)
class Body:
    """Vertices, shape (n, 3), in the element's frame [m], and triangles, shape (m, 3), outward by the right hand."""

    vertices: np.ndarray
    triangles: np.ndarray

    @cached_property
    def is_closed(self) -> bool:
        """Whether each edge of each triangle is met exactly once in the other direction."""
        if len(self.triangles) == 0:
            return False
        ends = [self.triangles[:, [0, 1]], self.triangles[:, [1, 2]], self.triangles[:, [2, 0]]]
        edges = np.concatenate(ends).astype(np.int64)
        count = int(self.triangles.max()) + 1
        forward = np.sort(edges[:, 0] * count + edges[:, 1])
        backward = np.sort(edges[:, 1] * count + edges[:, 0])
        return bool((forward[1:] != forward[:-1]).all() and np.array_equal(forward, backward))

    @property
    def volume(self) -> float:
        """The enclosed volume [m³]; negative when the normals of a closed surface point inwards."""
        if len(self.triangles) == 0:
            return 0.0
        # around a vertex of its own: far from the origin the products would cancel out
        a, b, c = (self.vertices[self.triangles[:, k]] - self.vertices[self.triangles[0, 0]] for k in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@dataclass(frozen=True, eq=False)
class Element:
    """One product of the model.

    Attributes:
        assembly: Id of the element it is a part of.
        properties: By property or quantity set and name, in SI.
        status: ``existing``: it stands already; ``demolish``: it stands and is to be taken down.
        doubt: Why its bodies are an obstacle at most.
        on: Ids of the elements that it fills, covers, projects from or fastens.
        members: Of a group or a part of the site that a task is assigned to: ids of what it holds, in place of bodies.
    """

    id: str
    ifc_class: str
    name: str
    type_name: str
    tag: str
    assembly: str
    model_T_element: Pose
    bodies: tuple[Body, ...]
    properties: Mapping[str, Mapping[str, Value]]
    mass: float | None
    status: str = ""
    doubt: str = ""
    on: tuple[str, ...] = ()
    members: tuple[str, ...] = ()

    @property
    def box(self) -> np.ndarray:
        """Lowest and highest coordinates of its bodies in the model, shape (2, 3) [m]."""
        pose, corners = self.model_T_element, np.concatenate([body.vertices for body in self.bodies])
        points = corners @ pose.rotation.T + pose.position
        return np.array([points.min(axis=0), points.max(axis=0)])


@dataclass(frozen=True)
class Task:
    """One task of the schedule.

    Attributes:
        parent: Id of the task it nests in.
        products: Ids of the elements it makes.
        robots: Names of the resources assigned to it; empty: any robot.
        start: ISO 8601
        kind: ``makes``: places its products, or works on them; ``takes_down``: removes products and inputs; ``other``.
        properties: Of its own `process.PROPERTY_SET`, which come before its elements'.
    """

    id: str
    name: str
    parent: str = ""
    products: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()
    robots: tuple[str, ...] = ()
    milestone: bool = False
    start: str = ""
    duration: float | None = None
    kind: str = "makes"
    completed: bool = False
    properties: Mapping[str, Value] = field(default_factory=dict)


@dataclass(frozen=True)
class Sequence:
    """One task waits for another; of nesting tasks, all that they nest. `lag`: [s]; negative: a lead."""

    before: str
    after: str
    kind: Literal["FINISH_START", "START_START", "FINISH_FINISH", "START_FINISH"] = "FINISH_START"
    lag: float = 0.0


@dataclass(frozen=True, eq=False)
class BuildingModel:
    """One IFC file; elements and tasks by id, in its order; notes on what was left out or may be misunderstood."""

    file: str
    digest: str
    project: str
    elements: Mapping[str, Element] = field(repr=False)
    tasks: Mapping[str, Task] = field(default_factory=dict, repr=False)
    sequences: tuple[Sequence, ...] = field(default=(), repr=False)
    notes: tuple[str, ...] = ()

    def element(self, global_id: str) -> Element:
        """Return the element of that GlobalId."""
        return self.elements[global_id]

    def named(self, name: str, where: str) -> Element:
        """Return the element of that GlobalId or name; `where`: the file or option that names it."""
        if name in self.elements:
            return self.elements[name]
        found = [element for element in self.elements.values() if element.name == name]
        if len(found) != 1:
            expected = f"GlobalId or name of one element of {self.file}; {len(found)} have this name"
            raise ConfigurationError(where, name, expected)
        return found[0]

    def with_names(self, sentence: str) -> str:
        """Return a sentence with names in place of ids."""
        return with_names(sentence, self.labels)

    @cached_property
    def labels(self) -> dict[str, str]:
        """The name of each element and task in sentences."""
        tasks = {task.id: task.name for task in self.tasks.values()}
        return {**labels(tasks), **labels({one.id: one.name for one in self.elements.values()})}


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
    """Return the parts of an element, or the members of a group, nested ones included, nearest first."""
    return _below(_dependents(elements)[0], whole)


def in_one_piece(
    elements: Mapping[str, Element], tasks: Mapping[str, Task], factory: Collection[str]
) -> dict[str, Element]:
    """Return the wholes that come in one piece, with bodies and mass of all that comes with them, and that without bodies.

    An assembly of a `factory` is so unless a task names a part of it, any other if it has a body and a task places it.
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
    """Return the elements that must have been placed before what no task makes is there.

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

"""Records of a building model: elements with their bodies, tasks, and their order; read by `ifc`.

Metres, kilograms, seconds. Frames: `model` is the model's own coordinate system, without map conversion; `element` is the product's
placement. An id is a GlobalId, or ``#123``, a number in the file, where that is missing, wrong or another one's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np

from construction_twin.core.errors import ConfigurationError
from construction_twin.extensions.work.errors import BuildingError
from construction_twin.extensions.work.names import labels, with_names
from construction_twin.kinematics.chain import Pose

#: Values of properties and quantities, as IFC has them.
Value = str | float | int | bool | None


@dataclass(frozen=True, eq=False)
class Body:
    """Triangles: vertices, shape (n, 3), in the element's frame [m], and indices, shape (m, 3), outward by the right hand."""

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
    """One product of the model. An empty text: the model says nothing.

    Attributes:
        ifc_class: ``IfcMember``.
        assembly: Id of the element it is a part of.
        properties: Values by property set (or quantity set) and name, the type's own included. Measures in SI.
        mass: [kg]; None: unknown.
        status: ``existing``: it stands already; ``demolish``: it stands and is to be taken down.
        doubt: Why its bodies are not what the model says, so that they are an obstacle at most.
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
        parent: Id of the task it nests in; empty: none.
        products: Ids of the elements it makes, in the file's order.
        robots: Names of the resources assigned to it; empty: any robot.
        start: ISO 8601; empty: unknown.
        duration: [s]
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
    """One task waits for another; of nesting tasks, all that they nest.

    Attributes:
        kind: What of `before`, then what of `after`.
        lag: [s]; negative: a lead.
    """

    before: str
    after: str
    kind: Literal["FINISH_START", "START_START", "FINISH_FINISH", "START_FINISH"] = "FINISH_START"
    lag: float = 0.0


@dataclass(frozen=True, eq=False)
class BuildingModel:
    """One IFC file.

    Attributes:
        tasks: By id, in the file's order; empty: it has no schedule.
        notes: One sentence for each thing that was left out or understood in a way that the user should know.
    """

    file: str
    digest: str
    project: str
    elements: Mapping[str, Element] = field(repr=False)
    tasks: Mapping[str, Task] = field(default_factory=dict, repr=False)
    sequences: tuple[Sequence, ...] = field(default=(), repr=False)
    notes: tuple[str, ...] = ()

    def element(self, global_id: str) -> Element:
        """Return the element of that GlobalId."""
        if global_id not in self.elements:
            raise BuildingError(
                self.file, f"element {global_id!r}", "none of that GlobalId", "one of the model's elements"
            )
        return self.elements[global_id]

    def named(self, name: str, where: str) -> Element:
        """Return the one element of that GlobalId or name; `where`: the file or option that names it."""
        if name in self.elements:
            return self.elements[name]
        found = [element for element in self.elements.values() if element.name == name]
        if len(found) != 1:
            expected = f"GlobalId or name of one element of {self.file}; {len(found)} have this name"
            raise ConfigurationError(where, name, expected)
        return found[0]

    def with_names(self, sentence: str, own: str = "") -> str:
        """Return a sentence with names in place of ids; `own`: id of the element that is called "the element"."""
        return with_names(sentence, {**self.labels, **({own: "the element"} if own else {})})

    @cached_property
    def labels(self) -> dict[str, str]:
        """What a sentence has for each id of element and task that has a name, see `names.with_names`."""
        tasks = {task.id: task.name for task in self.tasks.values()}
        return {**labels(tasks), **labels({one.id: one.name for one in self.elements.values()})}

"""What a building model says, as far as a robot needs it: elements with their geometry, tasks, and their order.

Metres, kilograms, seconds; rotations as matrices. Frames: `model` is the model's own coordinate system in metres (its project's
placement, without map conversion), `element` is the product's placement. Records only; read by `work.ifc`, used by everything else.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from construction_twin.extensions.work.errors import BuildingError
from construction_twin.extensions.work.names import labels, named
from construction_twin.kinematics.chain import Pose

#: Values of properties and quantities, as IFC has them.
Value = str | float | int | bool | None


@dataclass(frozen=True, eq=False)
class Body:
    """One body of an element.

    Attributes:
        vertices: Shape (n, 3). In the element's frame, those at the same place are one [m].
        triangles: Shape (m, 3). Indices of vertices; outward normals by the right hand.
    """

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
        id: GlobalId; ``#123``, its number in the file, where that is missing, wrong or another one's.
        ifc_class: ``IfcMember``.
        name, type_name, tag: Empty: the model has none.
        assembly: GlobalId of the element it is a part of: an IfcElementAssembly, or another (a wall of layers); empty: none.
        bodies: Empty: the element has no geometry.
        properties: Values by property set (or quantity set) and name, the type's own included; the element's win. Measures in SI.
        mass: [kg], from quantities, or density times volume; None: not known.
        status: ``existing``: it stands already; ``demolish``: it stands and is to be taken down; empty: neither is said.
        doubt: Why its bodies are not what the model says, so that they are an obstacle at most; empty: they are.
        on: GlobalIds of the elements that it is in or on: what it fills, covers, projects from or fastens.
        members: Of a group or a part of the site that a task is assigned to: GlobalIds of what it holds; it has no bodies then.
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


@dataclass(frozen=True)
class Task:
    """One task of the schedule.

    Attributes:
        parent: GlobalId of the task it nests in; empty: none.
        products: GlobalIds of the elements it makes (outputs), in the file's order.
        robots: Names of the resources assigned to it; empty: any robot.
        start: Scheduled, ISO 8601; empty: not said.
        duration: [s]
        kind: ``makes``: places its products, or works on them; ``takes_down``: removes its products and inputs; ``other``: neither
            (maintenance, moving).
        properties: Of its own property set `recipe.PROPERTY_SET`: how the arm does it, before what its elements say.
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
    """One task waits for another.

    Attributes:
        before, after: GlobalIds of tasks; of nesting tasks it holds for all that they nest.
        kind: ``FINISH_START``, ``START_START``, ``FINISH_FINISH`` or ``START_FINISH``: what of `before`, then what of `after`.
        lag: [s]; negative: a lead.
    """

    before: str
    after: str
    kind: str = "FINISH_START"
    lag: float = 0.0


@dataclass(frozen=True, eq=False)
class BuildingModel:
    """One IFC file.

    Attributes:
        tasks: By GlobalId, in the file's order; empty: it has no schedule.
        notes: One sentence for each thing that was left out or understood in a way that the user should know.
        remarks: The same by the id of the element or task that they are about, of those that there are any of.
    """

    file: str
    digest: str
    project: str
    elements: Mapping[str, Element] = field(repr=False)
    tasks: Mapping[str, Task] = field(default_factory=dict, repr=False)
    sequences: tuple[Sequence, ...] = field(default=(), repr=False)
    notes: tuple[str, ...] = ()
    remarks: Mapping[str, tuple[str, ...]] = field(default_factory=dict, repr=False)

    def element(self, global_id: str) -> Element:
        """Return the element of that GlobalId."""
        if global_id not in self.elements:
            raise BuildingError(
                self.file, f"element {global_id!r}", "none of that GlobalId", "one of the model's elements"
            )
        return self.elements[global_id]

    def called(self, sentence: str, own: str = "") -> str:
        """Return a sentence with elements and tasks by their names where it has ids, or bodies ``<GlobalId>/<number>``.

        `own`: GlobalId of the element that the sentence is about, which is called "the element".
        """
        return named(sentence, {**self.labels, **({own: "the element"} if own else {})})

    @cached_property
    def labels(self) -> dict[str, str]:
        """What a sentence has for each id of element and task that has a name, see `names.named`."""
        tasks = {task.id: task.name for task in self.tasks.values()}
        return {**labels(tasks), **labels({one.id: one.name for one in self.elements.values()})}

"""The scene of a cell at one state of the work, the stock, and the job of each element. Poses in the base_link [m]."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from construction_twin.core.errors import ConfigurationError
from construction_twin.extensions.work.building import BuildingModel, Element, comes_after
from construction_twin.extensions.work.contacts import ShapeDistances
from construction_twin.extensions.work.element_bodies import ElementPieces
from construction_twin.extensions.work.process import WorkJob
from construction_twin.extensions.work.schedule import Job
from construction_twin.extensions.work.work_cell import Rack, StackRack, WorkCell, inverse, pose_of
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import rpy_to_rotation
from construction_twin.scene.objects import Scene, SceneObject, product, tool_objects


@dataclass(frozen=True, eq=False)
class Slot:
    """Where one element lies in stock; `surface`: the scene's object below it."""

    element: str
    rack: str
    number: int
    load: int
    base_T_element: Pose
    surface: str


@dataclass(frozen=True, eq=False)
class StockPlan:
    """All elements in their slots, in the order in which they are needed; `stacks`: racks that are filled as a whole."""

    slots: Mapping[str, Slot]
    stacks: frozenset[str] = frozenset()

    def in_stock(self, out_of_stock: Collection[str]) -> tuple[str, ...]:
        """Return what lies in stock: of a later load only what has an empty slot, or stack."""
        gone = set(out_of_stock)
        left: dict[tuple[str, int], int] = {}
        for element, slot in self.slots.items():
            if element not in gone:
                key = self._unit(slot)
                left[key] = min(left.get(key, slot.load), slot.load)
        return tuple(
            element
            for element, slot in self.slots.items()
            if element not in gone and slot.load == left[self._unit(slot)]
        )

    def later_element_in_slot(self, element: str, out_of_stock: Collection[str]) -> str:
        """Return the element of a later load that counts as delivered in an element's slot, if any."""
        slot = self.slots.get(element)
        if slot is None:
            return ""
        for other in self.in_stock({*out_of_stock, element}):
            own = self.slots[other]
            if self._unit(own) == self._unit(slot) and own.load > slot.load:
                return other
        return ""

    def _unit(self, slot: Slot) -> tuple[str, int]:
        """Return the rack and slot that are refilled together; -1: the whole stack."""
        return slot.rack, -1 if slot.rack in self.stacks else slot.number


def plan_stock(
    work_cell: WorkCell, building: BuildingModel, order: Sequence[str], corners: Mapping[str, np.ndarray]
) -> StockPlan:
    """Give every element a slot; `corners`: shape (n, 3), points that enclose it, in its frame [m]."""
    members: dict[str, list[Element]] = {name: [] for name in work_cell.file.racks}
    for element in map(building.element, order):
        members[_rack_of(work_cell, element)].append(element)
    stacks = frozenset(name for name, rack in work_cell.file.racks.items() if isinstance(rack, StackRack))
    slots: dict[str, Slot] = {}
    for name, elements in members.items():
        rack, where = work_cell.file.racks[name], f"{work_cell.path}/racks/{name}"
        poses, base_T_rack = rack.poses, pose_of(rack.at)
        for number, element in enumerate(elements):
            load, at = divmod(number, len(poses))
            if load and not rack.refill:
                found = f"{len(poses)} slots for {len(elements)} elements, none for {element.name!r} ({element.id})"
                raise ConfigurationError(where, found, "a slot for each, or `refill: true`")
            # of a stack what is needed first lies on top
            top = min(len(poses), len(elements) - load * len(poses)) - 1
            rack_T_slot = poses[top - at if name in stacks else at]
            pose = _lying(rack, element, product(base_T_rack, rack_T_slot), corners[element.id])
            slots[element.id] = Slot(element.id, name, at, load, pose, rack.surface)
    return StockPlan({element: slots[element] for element in order}, stacks)


def _rack_of(work_cell: WorkCell, element: Element) -> str:
    for name, rack in work_cell.file.racks.items():
        if rack.holds.fits(element):
            return name
    where = f"{work_cell.path}/racks for element {element.name!r} ({element.id}), {element.ifc_class}"
    raise ConfigurationError(where, None, "a rack that holds it")


def _lying(rack: Rack, element: Element, base_T_slot: Pose, corners: np.ndarray) -> Pose:
    """Return the element's pose with the middle of the underside of its box in the slot."""
    turn = rpy_to_rotation(rack.rpy_deg)
    slot_R_element = turn @ element.model_T_element.rotation if rack.lies == "as_built" else turn
    corners = corners @ slot_R_element.T
    low, high = corners.min(axis=0), corners.max(axis=0)
    foot = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
    return product(base_T_slot, Pose(-foot, slot_R_element))


class Layout:
    """Where every element of a work is before and after.

    `pieces`, `standing`: convex pieces ``<GlobalId>/<number>`` by element, in its frame, of `order` and of what no task makes.
    `jobs`: by default one for each element, called as it. `stays`: the elements that no job moves.
    """

    def __init__(
        self,
        work_cell: WorkCell,
        building: BuildingModel,
        pieces: Mapping[str, Sequence[SceneObject]],
        order: Sequence[str],
        link: str,
        standing: Mapping[str, Sequence[SceneObject]] = MappingProxyType({}),
        jobs: Sequence[Job] = (),
    ):
        self.work_cell, self.building, self.order = work_cell, building, tuple(order)
        self.pieces = {element: tuple(pieces[element]) for element in order}
        self._base_T_model = inverse(work_cell.model_T_base)
        self._tool = tool_objects(work_cell.tool, link)
        corners = {element: ElementPieces(items).points for element, items in self.pieces.items()}
        own = (Job(one, "", "", one, (), (), work_cell.recipes.process(building.element(one))) for one in order)
        self._jobs = {job.id: job for job in jobs or own}
        placed = {job.element for job in self._jobs.values() if job.moves}
        self.stays = tuple(element for element in order if element not in placed)
        moved = [element for element in order if element in placed]
        self.stock: StockPlan = plan_stock(work_cell, building, moved, corners)
        self.standing = tuple(
            replace(item.moved(product(self.base_T_goal(element), item.pose)), fixed=True)
            for element, items in standing.items()
            for item in items
        )
        self.comes_after = comes_after(building.elements, moved)
        self._shapes = ShapeDistances()

    def base_T_goal(self, element: str) -> Pose:
        """Return where an element is to stand, as designed."""
        return product(self._base_T_model, self.building.element(element).model_T_element)

    def scene(self, placed: Mapping[str, Pose] = MappingProxyType({}), gone: Collection[str] = ()) -> Scene:
        """Return the scene with elements `placed` at ``base_T_element``, and others `gone` from their stock."""
        objects = [*self.work_cell.scene.objects]
        for item in self.standing:
            element = item.name.split("/", 1)[0]
            if element not in gone and placed.keys() >= self.comes_after.get(element, frozenset()):
                objects.append(item)
        objects += self._tool
        for element in self.stock.in_stock({*placed, *gone}):
            objects += self._objects_at(element, self.stock.slots[element].base_T_element)
        for element in self.stays:
            if element not in placed and element not in gone:
                objects += self._objects_at(element, self.base_T_goal(element))
        for element, pose in placed.items():
            if element in self.pieces:
                objects += self._objects_at(element, pose)
        return Scene(tuple(objects), self.work_cell.scene.padding)

    def job_for(self, element: str, scene: Scene, task: str = "") -> WorkJob:
        """Return the job of an element; `task`: its id, by default the element's first."""
        asked = self._jobs.get(task) or next(job for job in self._jobs.values() if job.element == element)
        built, slot = self.building.element(element), self.stock.slots.get(element) if asked.moves else None
        goal = self.base_T_goal(element) if asked.moves else self._standing_pose(element, scene)
        of_task = self.building.tasks.get(asked.task)
        of_work = {item.name for items in self.pieces.values() for item in items}
        of_work |= {item.name for item in self.standing}
        own = {item.name for item in self.pieces[element]}
        others = [item for item in scene.objects if item.name in of_work - own and not item.link]
        beside = {
            name
            for pose in ([goal] if slot is None else [slot.base_T_element, goal])
            for name in self._shapes.near(self.pieces[element], [pose], others, scene.padding)
        }
        x, y, z = map(float, self._base_T_model.rotation[:, 2])
        fixed = {*self.work_cell.file.supports, *([] if slot is None else [slot.surface])} & set(scene.names)
        return WorkJob(
            task or element,
            built,
            bodies=self.pieces[element],
            base_T_stock=None if slot is None else slot.base_T_element,
            base_T_goal=goal,
            supports=tuple(sorted(beside | fixed)),
            up=(x, y, z),
            task_properties={} if of_task is None else of_task.properties,
        )

    def _standing_pose(self, element: str, scene: Scene) -> Pose:
        first = self.pieces[element][0]
        if first.name not in scene.names or scene.get(first.name).link:
            return self.base_T_goal(element)
        return product(scene.get(first.name).pose, inverse(first.pose))

    def _objects_at(self, element: str, base_T_element: Pose) -> tuple[SceneObject, ...]:
        return tuple(item.moved(product(base_T_element, item.pose)) for item in self.pieces[element])

"""Which element of the stock is in which slot of which rack, where that is, and what is there when some have been taken.

Poses are ``base_T_element``, metres. Elements are named by GlobalId. Nothing here knows a file or a scene.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.work_errors import BuildingError
from construction_twin.kinematics.chain import Pose
from construction_twin.robot.frames import rpy_to_rotation
from construction_twin.scene.objects import product
from construction_twin.work.building import BuildingModel, Element
from construction_twin.work.site import DeliveredRack, GridRack, ListRack, Site, StackRack, inverse, pose_of


@dataclass(frozen=True, eq=False)
class Slot:
    """Where one element lies in stock.

    Attributes:
        surface: The scene's object that it lies on; empty: none.
    """

    element: str
    rack: str
    number: int
    load: int
    base_T_element: Pose
    surface: str


@dataclass(frozen=True, eq=False)
class StockPlan:
    """All elements in their slots.

    Attributes:
        slots: By element, in the order in which they are needed.
        stacks: Names of the racks that are filled as a whole.
    """

    slots: Mapping[str, Slot]
    stacks: frozenset[str] = frozenset()

    def present(self, taken: Collection[str]) -> tuple[str, ...]:
        """Return the elements that lie in their slots when some have been taken.

        An element of a later load is delivered when its slot is empty; that of a stack when the whole stack is.
        """
        gone = set(taken)
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

    def instead_of(self, element: str, taken: Collection[str]) -> str:
        """Return the element of a later load that counts as delivered where this one is to lie again; empty: there is none."""
        slot = self.slots.get(element)
        if slot is None:
            return ""
        for other in self.present({*taken, element}):
            own = self.slots[other]
            if self._unit(own) == self._unit(slot) and own.load > slot.load:
                return other
        return ""

    def _unit(self, slot: Slot) -> tuple[str, int]:
        """Return what is filled at once: a slot, or a whole stack."""
        return slot.rack, -1 if slot.rack in self.stacks else slot.number


def plan_stock(
    site: Site, building: BuildingModel, order: Sequence[str], corners: Mapping[str, np.ndarray]
) -> StockPlan:
    """Give every element a slot.

    Args:
        corners: Mapping of str to array, shape (n, 3). Points of each element that enclose it, in its own frame [m].
    """
    base_T_model = inverse(site.model_T_base(building))
    members: dict[str, list[Element]] = {name: [] for name in site.file.racks}
    for element in map(building.element, order):
        members[_rack_of(site, element)].append(element)
    slots: dict[str, Slot] = {}
    for name, elements in members.items():
        rack = site.file.racks[name]
        if rack.order == "file":
            place = {element: number for number, element in enumerate(building.elements)}
            elements = sorted(elements, key=lambda element: place[element.id])
        filling = _Filling(site, name, base_T_model, corners, building.file)
        slots |= {element.id: filling.slot(element, number, len(elements)) for number, element in enumerate(elements)}
    stacks = frozenset(name for name, rack in site.file.racks.items() if isinstance(rack, StackRack))
    return StockPlan({element: slots[element] for element in order}, stacks)


def _rack_of(site: Site, element: Element) -> str:
    for name, rack in site.file.racks.items():
        if rack.holds.fits(element):
            return name
    raise ConfigurationError(
        f"{site.path}/racks for element {element.name!r} ({element.id}), {element.ifc_class}",
        None,
        "a rack that holds it",
    )


class _Filling:
    """The slots of one rack."""

    def __init__(self, site: Site, name: str, base_T_model: Pose, corners: Mapping[str, np.ndarray], model_file: str):
        self._where = f"{site.path}/racks/{name}"
        self._name, self._rack, self._base_T_model = name, site.file.racks[name], base_T_model
        self._corners, self._model_file = corners, model_file

    def slot(self, element: Element, number: int, count: int) -> Slot:
        """Return the slot of the `number`-th of `count` elements."""
        if isinstance(self._rack, DeliveredRack):
            return Slot(element.id, self._name, number, 0, self._delivered(element), self._rack.surface)
        slots = self._slots()
        load, at = divmod(number, slots)
        if load and not self._rack.refill:
            raise ConfigurationError(
                self._where,
                f"{slots} slots for {count} elements, none for {element.name!r} ({element.id})",
                "a slot for each, or `refill: true`",
            )
        base_T_slot = product(self._frame(), self._rack_T_slot(at, min(slots, count - load * slots)))
        return Slot(element.id, self._name, at, load, self._standing(element, base_T_slot), self._rack.surface)

    def _slots(self) -> int:
        rack = self._rack
        if isinstance(rack, GridRack):
            return rack.rows * rack.columns
        if isinstance(rack, StackRack):
            return rack.levels
        assert isinstance(rack, ListRack)
        return len(rack.slots)

    def _frame(self) -> Pose:
        assert not isinstance(self._rack, DeliveredRack)
        at = pose_of(self._rack.at)
        return product(self._base_T_model, at) if self._rack.frame == "model" else at

    def _rack_T_slot(self, at: int, filled: int) -> Pose:
        rack = self._rack
        if isinstance(rack, GridRack):
            row, column = divmod(at, rack.columns)
            return Pose(np.array([column * rack.pitch[0], row * rack.pitch[1], 0.0]), np.eye(3))
        if isinstance(rack, StackRack):
            return Pose(np.array([0.0, 0.0, (filled - 1 - at) * rack.step]), np.eye(3))
        assert isinstance(rack, ListRack)
        return pose_of(rack.slots[at])

    def _standing(self, element: Element, base_T_slot: Pose) -> Pose:
        """Return the element's pose with the middle of the underside of its box in the slot."""
        rack = self._rack
        assert not isinstance(rack, DeliveredRack)
        turn = rpy_to_rotation(rack.rpy_deg)
        slot_R_element = turn @ element.model_T_element.rotation if rack.lies == "as_built" else turn
        corners = self._corners[element.id] @ slot_R_element.T
        low, high = corners.min(axis=0), corners.max(axis=0)
        foot = np.array([0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), low[2]])
        return product(base_T_slot, Pose(-foot, slot_R_element))

    def _delivered(self, element: Element) -> Pose:
        rack = self._rack
        assert isinstance(rack, DeliveredRack)
        group, _, name = rack.property.partition(".")
        value = element.properties.get(group, {}).get(name)
        if value is not None:
            pose = self._said(element, rack.property, value)
            return product(self._base_T_model, pose) if rack.frame == "model" else pose
        if rack.offset is None:
            raise BuildingError(
                self._model_file,
                f"element {element.name!r} ({element.id})",
                f"no {rack.property}",
                f"where it is delivered, as {self._where} asks; or give that rack an offset",
            )
        offset, built = pose_of(rack.offset), element.model_T_element
        moved = Pose(built.position + offset.position, offset.rotation @ built.rotation)
        return product(self._base_T_model, moved)

    def _said(self, element: Element, path: str, value: object) -> Pose:
        try:
            numbers = [float(word) for word in str(value).split()]
        except ValueError:
            numbers = []
        if len(numbers) not in (3, 6) or not np.isfinite(numbers).all():
            raise BuildingError(
                self._model_file,
                f"element {element.name!r} ({element.id}), {path}",
                repr(value),
                "the text `x y z` or `x y z roll pitch yaw` in m and deg",
            )
        turn = numbers[3:] or [0.0, 0.0, 0.0]
        return Pose(np.array(numbers[:3]), rpy_to_rotation(turn))

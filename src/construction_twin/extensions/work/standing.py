"""The elements of a building model that stand without a task making them: obstacles where the model has them. Metres."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from construction_twin.extensions.work.building import BuildingModel, Element
from construction_twin.extensions.work.element_bodies import box_of, element_shapes
from construction_twin.extensions.work.errors import PlacementError
from construction_twin.extensions.work.names import first_few
from construction_twin.extensions.work.site import Site, inverse
from construction_twin.kinematics.chain import Pose
from construction_twin.scene.objects import SceneObject, product


def check_placement(model: BuildingModel, model_T_base: Pose, reach: float, base: str = "") -> tuple[str, ...]:
    """Return what is out of reach while others are not, as one sentence, or nothing.

    Args:
        reach: Largest distance of the tool's centre point from the base's origin, along a track and with the tool [m], above 0.
        base: GlobalId of the element that stands for the robot's base, which is not compared; empty: none.
    """
    boxes = {one.id: _box(one) for one in model.elements.values() if one.bodies and one.id != base}
    if not boxes:
        raise PlacementError(f"{model.file}: no element has geometry, so nothing can be placed")
    at = model_T_base.position
    distances = {
        identifier: float(np.linalg.norm(np.maximum(np.maximum(low - at, at - high), 0.0)))
        for identifier, (low, high) in boxes.items()
    }
    far = tuple(one for one, distance in distances.items() if distance > reach)
    if len(far) == len(boxes):
        nearest = min(distances, key=lambda one: distances[one])
        low = np.min([box[0] for box in boxes.values()], axis=0)
        high = np.max([box[1] for box in boxes.values()], axis=0)
        said = f"all {len(boxes)} elements are out of the robot's reach of {reach:.2f} m: the nearest"
        away = f"{distances[nearest]:.2f} m from its base at {_figures(at)}"
        stand = f"The elements stand at {_figures(low)} to {_figures(high)}."
        raise PlacementError(f"{said}, {_named(model, (nearest,))}, is {away}. {stand}")
    if not far:
        return ()
    most = max(distances[one] for one in far)
    limits = f"up to {most:.2f} m from the base, reach {reach:.2f} m"
    return (f"{_named(model, far)} out of reach whatever the arm does: {limits}.",)


def _box(element: Element) -> np.ndarray:
    """Return the lowest and highest coordinates in the model, shape (2, 3)."""
    vertices = np.concatenate([body.vertices for body in element.bodies])
    pose = element.model_T_element
    points = vertices @ pose.rotation.T + pose.position
    return np.array([points.min(axis=0), points.max(axis=0)])


def _figures(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in values) + ") m"


def _named(model: BuildingModel, ids: tuple[str, ...]) -> str:
    if len(ids) == 1:
        return f"element {model.labels.get(ids[0], ids[0])}"
    return f"{len(ids)} elements ({first_few(model.labels.get(one, one) for one in ids)})"


#: What is carried reaches further than the tool: half of the longest element that an arm carries, and something [m].
_CARRIED = 5.0


@dataclass(frozen=True, eq=False)
class Standing:
    """What stands.

    Attributes:
        pieces: Convex pieces of each element in its own frame, ``<GlobalId>/<number>``; for `site_scene.Layout`.
        notes: One sentence for each element whose geometry is unusable: its box stands for it.
    """

    pieces: dict[str, tuple[SceneObject, ...]]
    notes: tuple[str, ...]


def standing(building: BuildingModel, made: Collection[str], site: Site, reach: float, folder: Path) -> Standing:
    """Return what stands of a model within reach of the arm and what it carries.

    Args:
        reach: As of `check_placement`.
        made: GlobalIds of the elements that tasks make; these, what they are parts of, and the element that stands for the base are
            not among what stands.
        folder: For mesh files, see `element_bodies.element_shapes`.
    """
    base_T_model = inverse(site.model_T_base(building))
    near = []
    for element in standing_elements(building, made, site):
        pose = product(base_T_model, element.model_T_element)
        points = np.concatenate([body.vertices for body in element.bodies]) @ pose.rotation.T + pose.position
        nearest = np.maximum(np.maximum(points.min(axis=0), -points.max(axis=0)), 0.0)
        if not np.linalg.norm(nearest) > reach + _CARRIED:
            near.append(element)
    shapes, failures = element_shapes(near, folder)
    said = "cannot be divided into bodies, its box is the obstacle, and the arm does not place it"
    notes = tuple(f"{name} {said}: {failure}" for name, failure in failures.items())
    boxes = {name: (box_of(building.element(name)),) for name in failures}
    return Standing({name: shape.objects for name, shape in shapes.items()} | boxes, notes)


def standing_elements(building: BuildingModel, made: Collection[str], site: Site) -> tuple[Element, ...]:
    """Return the elements with bodies that no task makes, wherever they are; see `standing`."""
    left_out = set(made)
    for identifier in made:
        above: list[str] = []
        parent = building.element(identifier).assembly
        while parent in building.elements and parent not in above:
            above.append(parent)
            parent = building.elements[parent].assembly
        # what exists stands, whatever new is a part of it
        left_out |= {one for one in above if not building.elements[one].status}
    if site.file.base_element:
        left_out.add(site.base(building).id)
    return tuple(one for one in building.elements.values() if one.bodies and one.id not in left_out)

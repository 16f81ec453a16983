"""Whether the arm reaches anything of a model from where it stands. Metres.

Boxes about elements, not their shapes, are compared with the reach, an upper bound: what is called too far is too far, but not the
other way round.
"""

from __future__ import annotations

import numpy as np

from construction_twin.core.sentences import Sentence
from construction_twin.core.work_errors import PlacementError
from construction_twin.kinematics.chain import Pose
from construction_twin.work.building import BuildingModel, Element
from construction_twin.work.first_few import first_few


def check_placement(model: BuildingModel, model_T_base: Pose, reach: float, base: str = "") -> tuple[str, ...]:
    """Return what is out of reach while others are not, as one sentence, or nothing.

    Args:
        reach: Largest distance of the tool's centre point from the base's origin, along a track and with the tool [m], above 0.
        base: GlobalId of the element that stands for the robot's base, which is not compared; empty: none.

    Raises:
        PlacementError: If no element has geometry, or all of them are out of reach.
    """
    boxes = {one.id: _box(one) for one in model.elements.values() if one.bodies and one.id != base}
    if not boxes:
        raise PlacementError(Sentence("work.place.no_geometry", file=model.file))
    at = model_T_base.position
    distances = {
        identifier: float(np.linalg.norm(np.maximum(np.maximum(low - at, at - high), 0.0)))
        for identifier, (low, high) in boxes.items()
    }
    far = tuple(one for one, distance in distances.items() if distance > reach)
    if len(far) == len(boxes):
        nearest = min(distances, key=lambda one: distances[one])
        raise PlacementError(
            Sentence(
                "work.place.far",
                count=len(boxes),
                reach=reach,
                nearest=_named(model, (nearest,)),
                distance=distances[nearest],
                base=_figures(model_T_base.position),
                low=_figures(np.min([box[0] for box in boxes.values()], axis=0)),
                high=_figures(np.max([box[1] for box in boxes.values()], axis=0)),
            ),
            tuple(distances),
        )
    if not far:
        return ()
    most = max(distances[one] for one in far)
    return (Sentence("work.place.some_far", elements=_named(model, far), distance=most, reach=reach),)


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
        return Sentence("ifc.element", id=model.labels.get(ids[0], ids[0]))
    return Sentence("work.place.elements", count=len(ids), listed=first_few(model.labels.get(one, one) for one in ids))

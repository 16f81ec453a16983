"""Where the model stands relative to the robot, and whether that can be true.

In: a `BuildingModel`, ``model_T_base`` or the element that stands for the base, and how far the tool reaches. Out: sentences with
figures and what to do, or a `PlacementError` where nothing would be planned that makes sense. Metres; ``model_T_base`` is the pose
of the robot's base link in the model's frame. Boxes about elements, not their shapes, are compared with the reach, an upper bound:
what is called too far is too far, but not the other way round. Knows no joint and no cell file.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from construction_twin.core.sentences import Sentence
from construction_twin.core.work_errors import PlacementError
from construction_twin.kinematics.chain import Pose
from construction_twin.work.building import BuildingModel, Element
from construction_twin.work.first_few import first_few

#: How far outside of the robot's reach an element is misplaced rather than unreachable, as a multiple of the reach.
MISPLACED = 10.0

#: Largest deviation of a rotation's columns from unit length and right angles.
_ORTHONORMAL = 1e-6

#: The robot's foot that must be free: radius and heights above the base's origin [m].
_FOOT_RADIUS, _FOOT_LOW, _FOOT_HIGH = 0.3, 0.05, 0.6

#: From here on a coordinate is one of a map, not of a building [m].
_MAP = 1e4

#: From here on a coordinate of a base that should be in metres is taken for millimetres, if that explains it.
_MILLIMETRES = 300.0

#: A base whose z axis leans more than this from the model's is reported [deg].
_LEANING_DEG = 2.0


@dataclass(frozen=True)
class Remark:
    """One thing to know about the placement.

    Attributes:
        ids: GlobalIds of the elements concerned.
    """

    text: str
    ids: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Placement:
    """A placement that may be true.

    Attributes:
        far: GlobalIds of elements that are out of reach whatever the arm does.
    """

    model_T_base: Pose
    remarks: tuple[Remark, ...]
    far: tuple[str, ...]


def base_element(model: BuildingModel, name: str) -> Element:
    """Return the element that stands for the robot's base; its placement is ``model_T_base``.

    Args:
        name: Its GlobalId, or its name if only one element has that.

    Raises:
        PlacementError: If there is none, or several have the name.
    """
    if name in model.elements:
        return model.elements[name]
    found = [element for element in model.elements.values() if element.name == name]
    if len(found) == 1:
        return found[0]
    ids = tuple(element.id for element in found)
    if found:
        raise PlacementError(
            Sentence("work.place.several", name=repr(name), count=len(found), file=model.file, listed=first_few(ids)),
            ids,
        )
    raise PlacementError(Sentence("work.place.no_element", name=repr(name), file=model.file))


def check_placement(model: BuildingModel, model_T_base: Pose, reach: float, base: str = "") -> Placement:
    """Check where a model stands.

    Args:
        reach: Largest distance of the tool's centre point from the base's origin, along a track and with the tool [m], above 0.
        base: GlobalId of the element that stands for the robot's base, which is not compared; empty: none.

    Raises:
        PlacementError: If the pose is no pose, no element has geometry, all of them are out of reach (with what would bring them
            there, where trying found something), or the base stands inside of elements.
    """
    _check_pose(model_T_base)
    boxes = {one.id: _box(one) for one in model.elements.values() if one.bodies and one.id != base}
    if not boxes:
        raise PlacementError(Sentence("work.place.no_geometry", file=model.file))
    distances = _distances(boxes, model_T_base)
    near = [identifier for identifier, distance in distances.items() if distance <= reach]
    if not near:
        raise PlacementError(_all_far(model, boxes, model_T_base, reach, distances), tuple(distances))
    buried = _buried(model, boxes, model_T_base)
    if buried:
        raise PlacementError(
            Sentence("work.place.buried", base=_figures(model_T_base.position), elements=_named(model, buried)), buried
        )
    remarks = [*_far_remarks(model, distances, reach), *_leaning(model_T_base)]
    return Placement(model_T_base, tuple(remarks), tuple(one for one, value in distances.items() if value > reach))


def _check_pose(pose: Pose) -> None:
    position, rotation = np.asarray(pose.position, dtype=float), np.asarray(pose.rotation, dtype=float)
    if not (np.isfinite(position).all() and np.isfinite(rotation).all()):
        raise PlacementError(Sentence("work.place.finite", position=_figures(position)))
    error = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    if error > _ORTHONORMAL:
        raise PlacementError(Sentence("work.place.sheared", error=error))
    if np.linalg.det(rotation) < 0.0:
        raise PlacementError(Sentence("work.place.left_handed"))


def _box(element: Element) -> np.ndarray:
    """Return the lowest and highest coordinates in the model, shape (2, 3)."""
    vertices = np.concatenate([body.vertices for body in element.bodies])
    pose = element.model_T_element
    points = vertices @ pose.rotation.T + pose.position
    return np.array([points.min(axis=0), points.max(axis=0)])


def _distances(boxes: dict[str, np.ndarray], model_T_base: Pose, scale: float = 1.0) -> dict[str, float]:
    """Return the distance of each box from the base's origin [m]; `scale`: the model is that much larger."""
    found = {}
    for identifier, (low, high) in boxes.items():
        outside = np.maximum(np.maximum(low * scale - model_T_base.position, model_T_base.position - high * scale), 0.0)
        found[identifier] = float(np.linalg.norm(outside))
    return found


def _all_far(
    model: BuildingModel, boxes: dict[str, np.ndarray], base: Pose, reach: float, distances: dict[str, float]
) -> str:
    """Return why every element is out of reach, with what was found by trying other readings of the same figures."""
    nearest = min(distances, key=lambda one: distances[one])
    inverse = Pose(-base.rotation.T @ base.position, base.rotation.T)
    size = float(np.abs(base.position).max())
    readings = [(Sentence("work.place.inverse"), inverse, 1.0)]
    if size >= _MILLIMETRES:
        readings.insert(0, (Sentence("work.place.millimetres"), _moved(base, 1e-3), 1.0))
    elif 0.0 < size <= _MILLIMETRES / 1e4:
        readings.insert(0, (Sentence("work.place.thousand"), _moved(base, 1e3), 1.0))
    readings += [
        (Sentence("work.place.unit", found=found, meant=meant), base, scale)
        for found, meant, scale in (
            ("metres", "millimetres", 1e-3),
            ("millimetres", "metres", 1e3),
            ("inches", "metres", 0.0254),
            ("feet", "metres", 0.3048),
        )
    ]
    low = np.min([box[0] for box in boxes.values()], axis=0)
    high = np.max([box[1] for box in boxes.values()], axis=0)
    return Sentence(
        "work.place.far",
        count=len(boxes),
        reach=reach,
        nearest=_named(model, (nearest,)),
        distance=distances[nearest],
        base=_figures(base.position),
        why=_better_reading(boxes, readings, reach, float(np.linalg.norm(high - low)))
        or _why_far(low, high, base, distances[nearest] <= MISPLACED * reach),
    )


def _better_reading(
    boxes: dict[str, np.ndarray], readings: Iterable[tuple[Sentence, Pose, float]], reach: float, extent: float
) -> str:
    """Return the first reading of the figures, pose and scale, that brings a tenth of the elements within reach; "": none."""
    for reading, pose, scale in readings:
        tried = _distances(boxes, pose, scale)
        within = sum(distance <= reach for distance in tried.values())
        if within >= max(1.0, len(boxes) / 10) and 0.05 <= extent * scale <= 500.0:
            return Sentence("work.place.read_so", within=within, count=len(boxes), reading=reading)
    return ""


def _why_far(low: np.ndarray, high: np.ndarray, base: Pose, in_between: bool) -> str:
    """Return what is wrong with figures that no other reading explains; `in_between`: the nearest element is not far from reach."""
    on_map = np.abs(base.position).max() > _MAP
    if np.abs(np.concatenate((low, high))).max() > _MAP and not on_map:
        why = "map_elements"
    elif on_map:
        why = "map_base"
    elif not np.any(base.position):
        why = "origin"
    else:
        why = "move" if in_between else "wrong"
    return Sentence(f"work.place.{why}", low=_figures(low), high=_figures(high))


def _moved(base: Pose, scale: float) -> Pose:
    return Pose(base.position * scale, base.rotation)


def _far_remarks(model: BuildingModel, distances: dict[str, float], reach: float) -> Iterable[Remark]:
    """Yield what is out of reach while others are not: a little, or so far that its own placement must be wrong."""
    misplaced = tuple(one for one, distance in distances.items() if distance > MISPLACED * reach)
    far = tuple(one for one, distance in distances.items() if reach < distance <= MISPLACED * reach)
    if misplaced:
        largest = max(distances[one] for one in misplaced)
        elements = _named(model, misplaced)
        yield Remark(Sentence("work.place.misplaced", elements=elements, distance=largest, reach=reach), misplaced)
    if far:
        largest = max(distances[one] for one in far)
        elements = _named(model, far)
        yield Remark(Sentence("work.place.some_far", elements=elements, distance=largest, reach=reach), far)


def _leaning(base: Pose) -> Iterable[Remark]:
    """Yield that the base does not stand upright."""
    degrees = float(np.degrees(np.arccos(np.clip(base.rotation[2, 2], -1.0, 1.0))))
    if degrees > _LEANING_DEG:
        yield Remark(Sentence("work.place.leans", degrees=degrees))


def _buried(model: BuildingModel, boxes: dict[str, np.ndarray], base: Pose) -> tuple[str, ...]:
    """Return the elements that the robot's foot would stand in."""
    angles = np.radians(np.arange(0.0, 360.0, 45.0))
    rings = [(0.0, 0.0), *((_FOOT_RADIUS * np.cos(a), _FOOT_RADIUS * np.sin(a)) for a in angles)]
    local = [(x, y, z) for z in np.linspace(_FOOT_LOW, _FOOT_HIGH, 6) for x, y in rings]
    points = np.array(local) @ base.rotation.T + base.position
    found = []
    for identifier, (low, high) in boxes.items():
        inside = points[np.all((points > low) & (points < high), axis=1)]
        element = model.elements[identifier]
        # the box of a doubtful one is larger than it: it says nothing of where the base is
        if not element.doubt and any(
            _contains(body.vertices[body.triangles], element, inside) for body in element.bodies
        ):
            found.append(identifier)
    return tuple(found)


def _contains(triangles: np.ndarray, element: Element, points: np.ndarray) -> bool:
    """Return whether a closed body contains one of the points: the sum of the solid angles of its triangles is that of a sphere."""
    pose = element.model_T_element
    for point in (points - pose.position) @ pose.rotation:
        a, b, c = (triangles[:, i] - point for i in range(3))
        la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
        volume = np.einsum("ij,ij->i", a, np.cross(b, c))
        below = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        if abs(float(np.arctan2(volume, below).sum())) > np.pi:  # half the solid angle: 2 pi inside, 0 outside
            return True
    return False


def _figures(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.2f}" for value in values) + ") m"


def _named(model: BuildingModel, ids: tuple[str, ...]) -> str:
    if len(ids) == 1:
        return Sentence("ifc.element", id=model.labels.get(ids[0], ids[0]))
    return Sentence("work.place.elements", count=len(ids), listed=first_few(model.labels.get(one, one) for one in ids))

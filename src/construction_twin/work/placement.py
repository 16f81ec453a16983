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

from construction_twin.core.work_errors import PlacementError
from construction_twin.kinematics.chain import Pose
from construction_twin.work.building import BuildingModel, Element

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

_LISTED = 10


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
            f"base_element {name!r}: {len(found)} elements of {model.file} have that name ({_listed(ids)}); give one GlobalId",
            ids,
        )
    raise PlacementError(
        f"base_element {name!r}: {model.file} has no element of that GlobalId or name; give model_T_base, or one of the elements"
    )


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
        raise PlacementError(f"{model.file}: no element has geometry, so nothing can be placed")
    distances = _distances(boxes, model_T_base)
    near = [identifier for identifier, distance in distances.items() if distance <= reach]
    if not near:
        raise PlacementError(_all_far(model, boxes, model_T_base, reach, distances), tuple(distances))
    buried = _buried(model, boxes, model_T_base)
    if buried:
        raise PlacementError(
            f"the robot's base at {_figures(model_T_base.position)} stands inside of {_named(model, buried)}; "
            "correct model_T_base, or take the element out of the work if it is the robot's own foundation",
            buried,
        )
    remarks = [*_far_remarks(model, distances, reach), *_leaning(model_T_base)]
    return Placement(model_T_base, tuple(remarks), tuple(one for one, value in distances.items() if value > reach))


def _check_pose(pose: Pose) -> None:
    position, rotation = np.asarray(pose.position, dtype=float), np.asarray(pose.rotation, dtype=float)
    if position.shape != (3,) or rotation.shape != (3, 3):
        raise PlacementError(f"model_T_base has shapes {position.shape} and {rotation.shape}; expected (3,) and (3, 3)")
    if not (np.isfinite(position).all() and np.isfinite(rotation).all()):
        raise PlacementError(f"model_T_base is not finite: {_figures(position)}; give numbers in metres and degrees")
    error = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    if error > _ORTHONORMAL:
        raise PlacementError(
            f"the axes of model_T_base are not unit vectors at right angles (off by {error:.2g}); "
            "a scaled or sheared placement cannot be a robot's"
        )
    if np.linalg.det(rotation) < 0.0:
        raise PlacementError(
            "model_T_base is left-handed: one axis is mirrored; swap two axes or give it as xyz and rpy_deg"
        )


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
    text = (
        f"all {len(boxes)} elements are out of the robot's reach of {reach:.2f} m: the nearest, {_named(model, (nearest,))}, is "
        f"{distances[nearest]:.2f} m from its base at {_figures(base.position)}. "
    )
    low = np.min([box[0] for box in boxes.values()], axis=0)
    high = np.max([box[1] for box in boxes.values()], axis=0)
    if distances[nearest] <= MISPLACED * reach:
        tail = "Move the base, or place the robot on a track; only if that is where it stands, nothing can be built from there."
    else:
        tail = "This is a wrong placement, not a matter of reach."
    inverse = Pose(-base.rotation.T @ base.position, base.rotation.T)
    size = float(np.abs(base.position).max())
    readings = [("it looks like base_T_model: give the base's pose in the model, the inverse of it", inverse, 1.0)]
    if size >= _MILLIMETRES:
        readings.insert(0, ("xyz of model_T_base looks like millimetres: give metres", _moved(base, 1e-3), 1.0))
    elif 0.0 < size <= _MILLIMETRES / 1e4:
        readings.insert(0, ("xyz of model_T_base looks divided by 1000 once too often", _moved(base, 1e3), 1.0))
    readings += [
        ("the file's length unit looks like metres where millimetres are meant: correct it", base, 1e-3),
        ("the file's length unit looks like millimetres where metres are meant: correct it", base, 1e3),
        ("the file's length unit looks like inches where metres are meant: correct it", base, 0.0254),
        ("the file's length unit looks like feet where metres are meant: correct it", base, 0.3048),
    ]
    for reading, pose, scale in readings:
        tried = _distances(boxes, pose, scale)
        within = sum(distance <= reach for distance in tried.values())
        extent = float(np.linalg.norm(high - low)) * scale
        if within >= max(1.0, len(boxes) / 10) and 0.05 <= extent <= 500.0:
            return f"{text}Read so, {within} of {len(boxes)} would be within reach: {reading}."
    if np.abs(np.concatenate((low, high))).max() > _MAP and np.abs(base.position).max() <= _MAP:
        return (
            f"{text}The elements stand at {_figures(low)} to {_figures(high)}: these are coordinates of a map. "
            "Name the element that stands where the robot's base_link is in base_element, or write the file with its map "
            "conversion."
        )
    if np.abs(base.position).max() > _MAP:
        return (
            f"{text}The elements stand at {_figures(low)} to {_figures(high)}: model_T_base looks like coordinates of a map. "
            "Give it in the model's own."
        )
    if not np.any(base.position):
        return (
            f"{text}The base stands at the model's origin, which is the value before one was measured: "
            f"measure it; the elements stand at {_figures(low)} to {_figures(high)}."
        )
    return f"{text}{tail} The elements stand at {_figures(low)} to {_figures(high)}."


def _moved(base: Pose, scale: float) -> Pose:
    return Pose(base.position * scale, base.rotation)


def _far_remarks(model: BuildingModel, distances: dict[str, float], reach: float) -> Iterable[Remark]:
    """Yield what is out of reach while others are not: a little, or so far that its own placement must be wrong."""
    misplaced = tuple(one for one, distance in distances.items() if distance > MISPLACED * reach)
    far = tuple(one for one, distance in distances.items() if reach < distance <= MISPLACED * reach)
    if misplaced:
        largest = max(distances[one] for one in misplaced)
        yield Remark(
            f"{_named(model, misplaced)} up to {largest:.1f} m from the robot's base while others are within its reach of "
            f"{reach:.2f} m: a wrong placement in the model, or another part of the site, not a matter of reach.",
            misplaced,
        )
    if far:
        largest = max(distances[one] for one in far)
        yield Remark(
            f"{_named(model, far)} out of reach whatever the arm does: up to {largest:.2f} m from the base, reach {reach:.2f} m.",
            far,
        )


def _leaning(base: Pose) -> Iterable[Remark]:
    """Yield that the base does not stand upright."""
    degrees = float(np.degrees(np.arccos(np.clip(base.rotation[2, 2], -1.0, 1.0))))
    if degrees > _LEANING_DEG:
        yield Remark(
            f"The robot's base leans {degrees:.1f} deg from the model's vertical; right only for one on a slope, a wall or "
            "a ceiling."
        )


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
        if any(_contains(body.vertices[body.triangles], element, inside) for body in element.bodies):
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
        return f"element {ids[0]} ({model.elements[ids[0]].name!r})"
    return f"{len(ids)} elements ({_listed(ids)})"


def _listed(ids: tuple[str, ...]) -> str:
    more = f" and {len(ids) - _LISTED} more" if len(ids) > _LISTED else ""
    return ", ".join(ids[:_LISTED]) + more

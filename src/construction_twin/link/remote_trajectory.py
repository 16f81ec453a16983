"""`trajectory` on MQTT: a motion that was planned elsewhere, as JSON; read strictly. Pure; standard library only.

Units are said by the sender and converted here to SI: m, rad, s. Two forms are read, see docs/reference/mqtt.md: our own, and what
`compas_fab.robots.JointTrajectory` serialises to, alone or as `trajectory` of an envelope. What is not exactly one of them is
refused (PayloadError). Ranges, limits and the start are the planner's to check.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from construction_twin.core.errors import PayloadError
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS
from construction_twin.mqtt.json_fields import (
    LARGEST,
    fraction,
    keys,
    list_of,
    number,
    own_id,
    read_fields,
    shown,
    text,
)

#: What COMPAS calls the type of compas_fab's trajectory; its values are rad and m by definition.
COMPAS_TYPE = "compas_fab.robots/JointTrajectory"
#: `joint_types` of COMPAS: revolute and continuous, prismatic.
_COMPAS_LINEAR = {0: False, 1: False, 2: True}
_FACTORS = {"angle": {"rad": 1.0, "deg": math.pi / 180.0}, "length": {"m": 1.0, "mm": 1e-3}, "time": {"s": 1.0}}
_UNITS = '{"angle": "rad" or "deg", "length": "m" or "mm", "time": "s"}'
_SCALES = ("speed_scale", "acceleration_scale")
_ENVELOPE = ("id", "source", *_SCALES)
#: What reads each key of an envelope.
_READERS = {"id": own_id, **dict.fromkeys(_SCALES, fraction), "source": text}
_PLAIN = (*_ENVELOPE, "units", "joint_names", "points")
_POINT = ("positions", "velocities", "accelerations", "time_from_start")
#: The keys of our own form, at every level.
KEYS = (*_PLAIN, *_POINT, *_FACTORS)
_COMPAS = ("dtype", "data", "guid", "name", "inheritance")
#: Of compas_fab's trajectory; the last three describe how it was made, and are not read.
_COMPAS_DATA = (
    "points",
    "joint_names",
    "fraction",
    "start_configuration",
    "start_state",
    "planning_time",
    "attributes",
)
_COMPAS_POINT = (
    "joint_values", "joint_types", "joint_names", "velocities", "accelerations", "effort", "time_from_start",
)  # fmt: skip

Values = tuple[float, ...]


@dataclass(frozen=True)
class Joints:
    """The robot's joints, base to tip: `names`, and which of them are prismatic."""

    names: tuple[str, ...]
    linear: tuple[bool, ...]


@dataclass(frozen=True)
class TrajectoryPoint:
    """A point in the robot's joint order, SI.

    Attributes:
        positions, velocities, accelerations: [rad] or [m], and per s and s²; of the last two every point has values, or none.
        time_ns: From the start [ns]; 0 in all points: not timed.
    """

    positions: Values
    velocities: Values
    accelerations: Values
    time_ns: int


@dataclass(frozen=True)
class TrajectoryRequest:
    """A motion from elsewhere.

    Attributes:
        id: The sender's own, echoed in the answer; empty where COMPAS gave none.
        source: What the sender says of itself; proves nothing.
        speed_scale, acceleration_scale: Fractions of the limits, 0 for the planner's default.
        notes: What was understood in a way that the sender should know.
    """

    id: str
    points: tuple[TrajectoryPoint, ...]
    source: str = ""
    speed_scale: float = 0.0
    acceleration_scale: float = 0.0
    notes: tuple[str, ...] = ()


def request_id(document: Mapping[str, Any]) -> str:
    """Return what the answer echoes: the document's `id`, else the guid of a COMPAS object; "" without one.

    Raises:
        PayloadError: ``format``
    """
    value = document.get("id", document.get("guid", "") if "dtype" in document else "")
    return text(value, "id")


def parse_trajectory(document: Mapping[str, Any], joints: Joints) -> TrajectoryRequest:
    """Return the motion in a document.

    Args:
        document: See `read_document`.
        joints: Of the robot; the sender may name them in any order.

    Raises:
        PayloadError: ``format`` (keys and their kinds), ``units``, ``joints``, ``values``.
    """
    if "dtype" in document:
        return _compas_request(document, document, joints)
    if "trajectory" in document:
        keys(document, "trajectory message", ("id", "trajectory"), (*_ENVELOPE, "trajectory"))
        inner = document["trajectory"]
        if not isinstance(inner, dict) or "dtype" not in inner:
            raise PayloadError("format", Sentence("link.payload.trajectory", found=shown(inner), dtype=COMPAS_TYPE))
        return _compas_request(document, inner, joints)
    return _plain_request(document, joints)


# -- our own form


def _plain_request(document: Mapping[str, Any], joints: Joints) -> TrajectoryRequest:
    keys(document, "trajectory message", ("id", "units", "joint_names", "points"), _PLAIN)
    factors = _factors(document["units"])
    order = _order(document["joint_names"], joints)
    scales = tuple(factors["length" if linear else "angle"] for linear in joints.linear)
    points = []
    for index, point in enumerate(list_of(document["points"], "points")):
        keys(point, f"point {index}", ("positions",), _POINT)
        values = [_values(point.get(name, []), f"point {index}: {name}", order, scales) for name in _POINT[:3]]
        if not values[0]:
            raise PayloadError("values", Sentence("link.payload.no_values", index=index, what="positions"))
        time_ns = _seconds(point.get("time_from_start", 0.0), index)
        points.append(TrajectoryPoint(values[0], values[1], values[2], time_ns))
    _check_points(points)
    _check_timed(points)
    return _request(document, tuple(points))


def _factors(units: object) -> dict[str, float]:
    if not isinstance(units, dict) or set(units) != set(_FACTORS):
        raise PayloadError("units", Sentence("link.payload.units", found=shown(units), expected=_UNITS))
    for kind, unit in units.items():
        if not isinstance(unit, str) or unit not in _FACTORS[kind]:
            raise PayloadError("units", Sentence("link.payload.unit", kind=kind, found=shown(unit), expected=_UNITS))
    return {kind: _FACTORS[kind][unit] for kind, unit in units.items()}


def _seconds(value: object, index: int) -> int:
    seconds = number(value, f"point {index}: time_from_start")
    if seconds < 0.0:
        raise PayloadError("values", Sentence("link.payload.time", index=index, seconds=seconds))
    return round(seconds * NANOSECONDS)


def _all_or_none(points: Sequence[TrajectoryPoint]) -> None:
    for name in ("velocities", "accelerations"):
        given = [bool(getattr(point, name)) for point in points]
        if any(given) and not all(given):
            raise PayloadError("values", Sentence("link.payload.some", index=given.index(False), what=name))


def _check_points(points: Sequence[TrajectoryPoint]) -> None:
    if len(points) < 2:
        raise PayloadError("values", Sentence("link.payload.too_few", count=len(points)))
    _all_or_none(points)


def _is_timed(points: Sequence[TrajectoryPoint]) -> bool:
    return any(point.time_ns for point in points)


def _check_timed(points: Sequence[TrajectoryPoint]) -> None:
    """Refuse velocities of a motion without times: it is timed here, and they would be dropped."""
    if not _is_timed(points) and any(point.velocities or point.accelerations for point in points):
        raise PayloadError("values", Sentence("link.payload.untimed"))


# -- compas_fab's form


def _compas_request(envelope: Mapping[str, Any], document: Mapping[str, Any], joints: Joints) -> TrajectoryRequest:
    keys(document, "COMPAS object", ("dtype", "data"), _COMPAS)
    if document["dtype"] != COMPAS_TYPE:
        raise PayloadError("format", Sentence("link.payload.dtype", found=shown(document["dtype"]), dtype=COMPAS_TYPE))
    data = document["data"]
    keys(data, "compas_fab trajectory", ("points", "joint_names"), _COMPAS_DATA)
    _check_fraction(data.get("fraction"))
    rows = list_of(data["points"], "points")
    names = _compas_names(data["joint_names"], rows)
    order = _order(names, joints)
    points = tuple(_compas_point(point, index, names, order, joints) for index, point in enumerate(rows))
    _check_points(points)
    notes = []
    for name in ("velocities", "accelerations"):
        # compas_fab cannot say "none": it fills in zeros
        if not any(any(getattr(point, name)) for point in points):
            if _is_timed(points) and getattr(points[0], name):
                notes.append(Sentence("link.payload.zeros", what=name))
            points = tuple(_without(point, name) for point in points)
    _check_timed(points)
    if envelope is document:
        name = text(document.get("name", ""), "name")
        return TrajectoryRequest(request_id(document), points, name, notes=tuple(notes))
    return _request(envelope, points, tuple(notes))


def _check_fraction(fraction: object) -> None:
    if fraction is not None and (followed := number(fraction, "fraction")) != 1.0:
        raise PayloadError("values", Sentence("link.payload.followed", fraction=followed))


def _compas_names(names: object, rows: Sequence[Any]) -> Sequence[object]:
    """Return the joints of all points: the trajectory's, else those that every point names alike."""
    names = list_of(names, "joint_names")
    for index, point in enumerate(rows):
        keys(point, f"point {index}", _COMPAS_POINT[:2], _COMPAS_POINT)
        own = list_of(point.get("joint_names", []), f"point {index}: joint_names")
        names = names or own
        if own and own != names:
            found = Sentence("link.payload.other_names", index=index, found=shown(own), names=shown(names))
            raise PayloadError("joints", found)
    return names


def _compas_point(
    point: Mapping[str, Any], index: int, names: Sequence[object], order: Sequence[int], joints: Joints
) -> TrajectoryPoint:
    kinds = list_of(point["joint_types"], f"point {index}: joint_types")
    if len(kinds) != len(names):
        found = Sentence("link.payload.types", index=index, found=len(kinds), count=len(names))
        raise PayloadError("joints", found)
    for robots, place in enumerate(order):
        linear = _COMPAS_LINEAR.get(kinds[place]) if type(kinds[place]) is int else None
        if linear is not joints.linear[robots]:
            key = f"link.payload.{'prismatic' if joints.linear[robots] else 'revolute'}"
            found = Sentence(key, index=index, found=shown(kinds[place]), joint=joints.names[robots])
            raise PayloadError("joints", found)
    scales = (1.0,) * len(order)
    values = [
        _values(point.get(name, []), f"point {index}: {name}", order, scales)
        for name in ("joint_values", "velocities", "accelerations", "effort")
    ]
    if not values[0]:
        raise PayloadError("values", Sentence("link.payload.no_values", index=index, what="joint_values"))
    if any(values[3]):
        raise PayloadError("values", Sentence("link.payload.efforts", index=index))
    return TrajectoryPoint(values[0], values[1], values[2], _duration(point, index))


def _duration(point: Mapping[str, Any], index: int) -> int:
    place = f"point {index}: time_from_start"
    time = point.get("time_from_start", {"secs": 0, "nsecs": 0})
    keys(time, place, ("secs", "nsecs"), ("secs", "nsecs"))
    parts = []
    for name, end in (("secs", int(LARGEST)), ("nsecs", NANOSECONDS - 1)):
        part = time[name]
        if type(part) is not int or not 0 <= part <= end:
            raise PayloadError(
                "values", Sentence("link.payload.whole", place=place, key=name, found=shown(part), end=end)
            )
        parts.append(part)
    return parts[0] * NANOSECONDS + parts[1]


def _without(point: TrajectoryPoint, name: str) -> TrajectoryPoint:
    velocities = () if name == "velocities" else point.velocities
    accelerations = () if name == "accelerations" else point.accelerations
    return TrajectoryPoint(point.positions, velocities, accelerations, point.time_ns)


# -- parts of both


def _request(
    envelope: Mapping[str, Any], points: tuple[TrajectoryPoint, ...], notes: tuple[str, ...] = ()
) -> TrajectoryRequest:
    """Return the request; a scale of a motion that brings its times would have no effect, and is refused."""
    said = read_fields(envelope, _READERS)
    for key in _SCALES:
        if said.get(key) and _is_timed(points):
            raise PayloadError("values", Sentence("link.payload.scale", key=key))
    return TrajectoryRequest(points=points, notes=notes, **said)


def _order(names: object, joints: Joints) -> list[int]:
    """Return for each joint of the robot where it stands among `names`."""
    given = list_of(names, "joint_names")
    if not all(isinstance(name, str) for name in given) or sorted(given) != sorted(joints.names):
        found = Sentence("link.payload.names", found=shown(given), joints=", ".join(joints.names))
        raise PayloadError("joints", found)
    return [given.index(name) for name in joints.names]


def _values(row: object, place: str, order: Sequence[int], scales: Sequence[float]) -> Values:
    """Return a row in the robot's order and in SI; empty stays empty."""
    values = list_of(row, place)
    if not values:
        return ()
    if len(values) != len(order):
        raise PayloadError("values", Sentence("link.payload.row", place=place, found=len(values), count=len(order)))
    return tuple(number(values[index], place) * scale for index, scale in zip(order, scales))

"""`trajectory` on MQTT: a motion that was planned elsewhere, as JSON; read strictly. Pure.

Units are said by the sender and converted here to SI: m, rad, s. Two forms are read, see docs/reference/mqtt.md: our own, and what
`compas_fab.robots.JointTrajectory` serialises to, alone or as `trajectory` of an envelope. What is not exactly one of them is
refused (PayloadError). Ranges, limits and the start are the planner's to check.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

from pydantic import Field

from construction_twin.core.errors import PayloadError
from construction_twin.core.units import NANOSECONDS
from construction_twin.link.requests import LARGEST, Fraction, Id, Joints, Many, Number, Request, Text, read, shown

#: `joint_types` of COMPAS: revolute and continuous, prismatic.
_COMPAS_LINEAR = {0: False, 1: False, 2: True}
_FACTORS = {"rad": 1.0, "deg": math.pi / 180.0, "m": 1.0, "mm": 1e-3}
_SCALES = ("speed_scale", "acceleration_scale")

Values = tuple[float, ...]


@dataclass(frozen=True)
class TrajectoryPoint:
    """A point in the robot's joint order, SI; velocities and accelerations have values in every point, or in none.

    Attributes:
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
        speed_scale, acceleration_scale: Fractions of the limits, 0 for the planner's default.
        notes: What was understood in a way that the sender should know.
    """

    id: str
    points: tuple[TrajectoryPoint, ...]
    source: str = ""
    speed_scale: float = 0.0
    acceleration_scale: float = 0.0
    notes: tuple[str, ...] = ()


class Envelope(Request):
    """What stands beside a motion."""

    id: Id
    source: Text = ""
    speed_scale: Fraction = 0.0
    acceleration_scale: Fraction = 0.0


class Units(Request):
    """Units of all numbers: said, never guessed."""

    angle: Literal["rad", "deg"]
    length: Literal["m", "mm"]
    time: Literal["s"]


class Point(Request):
    """A point of our own form; empty rows: not given."""

    positions: Annotated[Many[Number], Field(min_length=1)]
    velocities: Many[Number] = []
    accelerations: Many[Number] = []
    time_from_start: Annotated[Number, Field(ge=0.0)] = 0.0


class PlainTrajectory(Envelope):
    """Our own form."""

    units: Units
    joint_names: Many[str]
    points: Many[Point]


class CompasTime(Request):
    """A time of compas_fab."""

    secs: Annotated[int, Field(ge=0, le=int(LARGEST))]
    nsecs: Annotated[int, Field(ge=0, le=NANOSECONDS - 1)]


class CompasPoint(Request):
    """A point of compas_fab."""

    joint_values: Annotated[Many[Number], Field(min_length=1)]
    joint_types: Many[int]
    joint_names: Many[str] = []
    velocities: Many[Number] = []
    accelerations: Many[Number] = []
    effort: Many[Number] = []
    time_from_start: CompasTime = CompasTime(secs=0, nsecs=0)


class CompasData(Request):
    """A trajectory of compas_fab; what is `Any` tells how it was made, and is not read."""

    points: Many[CompasPoint]
    joint_names: Many[str]
    fraction: Number | None = None
    start_configuration: Any = None
    start_state: Any = None
    planning_time: Any = None
    attributes: Any = None


class CompasTrajectory(Request):
    """An object of COMPAS in an envelope."""

    dtype: Literal["compas_fab.robots/JointTrajectory"]
    data: CompasData
    guid: Any = ""
    name: Any = ""
    inheritance: Any = None


class BareCompas(CompasTrajectory):
    """An object of COMPAS alone: its guid is its id, its name the source."""

    guid: Text = ""
    name: Text = ""


class EnvelopedCompas(Envelope):
    """An object of COMPAS with an id of its sender's."""

    trajectory: CompasTrajectory


def parse_trajectory(document: Mapping[str, Any], joints: Joints) -> TrajectoryRequest:
    """Return the motion in a document of `read_document`, or raise PayloadError: ``format``, ``joints``, ``values``."""
    if "dtype" in document:
        bare = read(BareCompas, document, "trajectory")
        points, notes = _compas_points(bare.data, joints)
        return TrajectoryRequest(bare.guid, points, bare.name, notes=notes)
    if "trajectory" in document:
        enveloped = read(EnvelopedCompas, document, "trajectory")
        points, notes = _compas_points(enveloped.trajectory.data, joints)
        return _request(enveloped, points, notes)
    plain = read(PlainTrajectory, document, "trajectory")
    points = _plain_points(plain, joints)
    _check_points(points)
    _check_timed(points)
    return _request(plain, points)


# -- our own form


def _plain_points(plain: PlainTrajectory, joints: Joints) -> tuple[TrajectoryPoint, ...]:
    order = _order(plain.joint_names, joints)
    scales = [_FACTORS[plain.units.length if linear else plain.units.angle] for linear in joints.linear]
    points = []
    for index, point in enumerate(plain.points):
        rows = (point.positions, point.velocities, point.accelerations)
        q, dq, ddq = (_values(row, index, order, scales) for row in rows)
        points.append(TrajectoryPoint(q, dq, ddq, round(point.time_from_start * NANOSECONDS)))
    return tuple(points)


def _check_points(points: Sequence[TrajectoryPoint]) -> None:
    if len(points) < 2:
        raise PayloadError("values", f"{len(points)} points; expected at least two, the first where the twin is")
    for name in ("velocities", "accelerations"):
        given = [bool(getattr(point, name)) for point in points]
        if any(given) and not all(given):
            found = f"point {given.index(False)} has no {name}, others have; expected them in every point or in none"
            raise PayloadError("values", found)


def _is_timed(points: Sequence[TrajectoryPoint]) -> bool:
    return any(point.time_ns for point in points)


def _check_timed(points: Sequence[TrajectoryPoint]) -> None:
    """Refuse velocities of a motion without times: it is timed here, and they would be dropped."""
    if not _is_timed(points) and any(point.velocities or point.accelerations for point in points):
        raise PayloadError(
            "values", "velocities or accelerations without times; expected time_from_start, or none of them"
        )


# -- compas_fab's form


def _compas_points(data: CompasData, joints: Joints) -> tuple[tuple[TrajectoryPoint, ...], tuple[str, ...]]:
    """Return the points, and what was understood in a way that the sender should know."""
    if data.fraction not in (None, 1.0):
        found = (
            f"fraction is {data.fraction:g}: only a part was planned; plan again, or cut the path and say fraction 1"
        )
        raise PayloadError("values", found)
    names = _compas_names(data)
    order = _order(names, joints)
    points = tuple(_compas_point(point, index, names, order, joints) for index, point in enumerate(data.points))
    _check_points(points)
    notes = []
    for name in ("velocities", "accelerations"):
        # compas_fab cannot say "none": it fills in zeros
        if not any(any(getattr(point, name)) for point in points):
            if _is_timed(points) and getattr(points[0], name):
                notes.append(f"all {name} are zero, which compas_fab writes where none are given: read as not given")
            none: dict[str, Any] = {name: ()}
            points = tuple(replace(point, **none) for point in points)
    _check_timed(points)
    return points, tuple(notes)


def _compas_names(data: CompasData) -> list[str]:
    """Return the joints of all points: the trajectory's, else those that every point names alike."""
    names = data.joint_names
    for index, point in enumerate(data.points):
        names = names or point.joint_names
        if point.joint_names and point.joint_names != names:
            found = f"point {index} names its joints {shown(point.joint_names)}; expected {shown(names)}, as before"
            raise PayloadError("joints", found)
    return names


def _compas_point(
    point: CompasPoint, index: int, names: list[str], order: Sequence[int], joints: Joints
) -> TrajectoryPoint:
    kinds = point.joint_types
    if len(kinds) != len(names):
        raise PayloadError(
            "joints", f"point {index} has {len(kinds)} joint_types; expected {len(names)}, one per joint"
        )
    for robots, place in enumerate(order):
        if _COMPAS_LINEAR.get(kinds[place]) is not joints.linear[robots]:
            expected = "2, prismatic [m]" if joints.linear[robots] else "0 or 1, revolute [rad]"
            found = f"joint_types says {shown(kinds[place])} of {joints.names[robots]}; expected {expected}"
            raise PayloadError("joints", f"point {index}: {found}")
    rows = (point.joint_values, point.velocities, point.accelerations, point.effort)
    q, dq, ddq, effort = (_values(row, index, order, (1.0,) * len(order)) for row in rows)
    if any(effort):
        raise PayloadError("values", f"point {index} has efforts; the arm takes positions only: leave them out, or 0")
    return TrajectoryPoint(q, dq, ddq, point.time_from_start.secs * NANOSECONDS + point.time_from_start.nsecs)


# -- parts of both


def _request(envelope: Envelope, points: tuple[TrajectoryPoint, ...], notes: tuple[str, ...] = ()) -> TrajectoryRequest:
    """Return the request; a scale of a motion that brings its times would have no effect, and is refused."""
    for key in _SCALES:
        if getattr(envelope, key) and _is_timed(points):
            raise PayloadError("values", f"{key} is for a motion without times; leave it out, or time_from_start")
    said = {name: getattr(envelope, name) for name in Envelope.model_fields}
    return TrajectoryRequest(points=points, notes=notes, **said)


def _order(names: list[str], joints: Joints) -> list[int]:
    """Return for each joint of the robot where it stands among `names`."""
    if sorted(names) != sorted(joints.names):
        found = f"joint_names are {shown(names)}; expected each of {', '.join(joints.names)} once, in any order"
        raise PayloadError("joints", found)
    return [names.index(name) for name in joints.names]


def _values(values: Sequence[float], index: int, order: Sequence[int], scales: Sequence[float]) -> Values:
    """Return a row in the robot's order and in SI; empty stays empty."""
    if values and len(values) != len(order):
        raise PayloadError("values", f"point {index}: {len(values)} values; expected {len(order)}, one for each joint")
    return tuple(values[index] * scale for index, scale in zip(order, scales)) if values else ()

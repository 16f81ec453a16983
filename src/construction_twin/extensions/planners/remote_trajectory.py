"""`trajectory` on MQTT: a motion that was planned elsewhere, as JSON; read strictly. Pure.

The sender names the units, which are converted here to SI: m, rad, s (docs/reference/mqtt.md). Ranges, limits and the start are
the planner's to check.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import Field

from construction_twin.core.errors import PayloadError
from construction_twin.core.units import NANOSECONDS
from construction_twin.link.requests import Fraction, Id, Joints, Many, Number, Request, Text, read, value_text

_FACTORS = {"rad": 1.0, "deg": math.pi / 180.0, "m": 1.0, "mm": 1e-3}

Values = tuple[float, ...]


@dataclass(frozen=True)
class TrajectoryPoint:
    """A point in the robot's joint order, SI; `time_ns` from the start [ns], 0 in all points: untimed."""

    positions: Values
    velocities: Values
    accelerations: Values
    time_ns: int


@dataclass(frozen=True)
class TrajectoryRequest:
    """A motion from elsewhere, with the sender's own id; scales are fractions of the limits, 0 for the planner's default."""

    id: str
    points: tuple[TrajectoryPoint, ...]
    source: str = ""
    speed_scale: float = 0.0
    acceleration_scale: float = 0.0


class Units(Request):
    """Units of all numbers, each named by the sender."""

    angle: Literal["rad", "deg"]
    length: Literal["m", "mm"]
    time: Literal["s"]


class Point(Request):
    """A point as it is sent; empty rows: absent."""

    positions: Annotated[Many[Number], Field(min_length=1)]
    velocities: Many[Number] = []
    accelerations: Many[Number] = []
    time_from_start: Annotated[Number, Field(ge=0.0)] = 0.0


class TrajectoryMessage(Request):
    """The message."""

    id: Id
    source: Text = ""
    speed_scale: Fraction = 0.0
    acceleration_scale: Fraction = 0.0
    units: Units
    joint_names: Many[str]
    points: Many[Point]


def parse_trajectory(document: Mapping[str, Any], joints: Joints) -> TrajectoryRequest:
    """Return the motion in a document of `read_document`, or raise PayloadError: ``format``, ``joints``, ``values``."""
    message = read(TrajectoryMessage, document, "trajectory")
    order = _order(message.joint_names, joints)
    factors = [_FACTORS[message.units.length if linear else message.units.angle] for linear in joints.linear]
    points = []
    for index, point in enumerate(message.points):
        rows = (point.positions, point.velocities, point.accelerations)
        q, dq, ddq = (_values(row, index, order, factors) for row in rows)
        points.append(TrajectoryPoint(q, dq, ddq, round(point.time_from_start * NANOSECONDS)))
    _check_points(points, message)
    scales = message.speed_scale, message.acceleration_scale
    return TrajectoryRequest(message.id, tuple(points), message.source, *scales)


def _check_points(points: Sequence[TrajectoryPoint], message: TrajectoryMessage) -> None:
    """Refuse what would be dropped or guessed: too few points, rows in some points, rates and scales that have no effect."""
    if len(points) < 2:
        raise PayloadError("values", f"{len(points)} points; expected at least two, the first where the twin is")
    for name in ("velocities", "accelerations"):
        given = [bool(getattr(point, name)) for point in points]
        if any(given) and not all(given):
            found = f"point {given.index(False)} has no {name}, others have; expected them in every point or in none"
            raise PayloadError("values", found)
    if any(point.time_ns for point in points):
        for key in ("speed_scale", "acceleration_scale"):
            if getattr(message, key):
                raise PayloadError("values", f"{key} is for a motion without times; leave it out, or time_from_start")
    elif points[0].velocities or points[0].accelerations:
        expected = "velocities or accelerations without times; expected time_from_start, or none of them"
        raise PayloadError("values", expected)


def _order(names: list[str], joints: Joints) -> list[int]:
    """Return for each joint of the robot where it stands among `names`."""
    if sorted(names) != sorted(joints.names):
        found = f"joint_names are {value_text(names)}; expected each of {', '.join(joints.names)} once, in any order"
        raise PayloadError("joints", found)
    return [names.index(name) for name in joints.names]


def _values(values: Sequence[float], index: int, order: Sequence[int], factors: Sequence[float]) -> Values:
    """Return a row in the robot's order and in SI; empty stays empty."""
    if values and len(values) != len(order):
        raise PayloadError("values", f"point {index}: {len(values)} values; expected {len(order)}, one for each joint")
    return tuple(values[place] * factor for place, factor in zip(order, factors)) if values else ()

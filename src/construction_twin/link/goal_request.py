"""Requests for a plan to a goal; `plan_request` and `ik` on MQTT, read strictly. Pure; standard library only.

A `GoalRequest`, also of the command line and the marker in rviz, becomes a plan for review by the planner's own services, or a
sentence; nothing here moves anything. By MQTT poses are those of `tool0` in the robot's base_link. A request for a plan repeats the
newest moment that its screen had received (`core.freshness`); a pose that is dragged is only answered, and needs none. SI: m, rad,
s. What is not exactly as docs/reference/mqtt.md says is refused (PayloadError).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from construction_twin.core.errors import PayloadError
from construction_twin.core.freshness import Moment, parse_moment
from construction_twin.core.sentences import Sentence
from construction_twin.link.remote_trajectory import Joints
from construction_twin.mqtt.json_fields import (
    Reader,
    fraction,
    keys,
    list_of,
    number,
    own_id,
    read_fields,
    shown,
    text,
)

#: Longest message [bytes].
MAX_BYTES = 4096
#: How far a quaternion may be from unit length; JSON of a browser has all digits, a person's has three.
_UNIT = 1e-3
_SCALES = ("speed_scale", "acceleration_scale")
_POSE = ("position", "orientation")
#: Keys of each kind of plan request, beside `id` and `kind`: those that are needed, and those that may be there.
KINDS: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "joints": (("joints",), _SCALES),
    "pose": (_POSE, ("configuration", *_SCALES)),
    "line": (_POSE, ("speed", *_SCALES)),
    "way_back": ((), ()),
    "work_task": ((), ("task",)),
}
_IK = ("id", *_POSE)

Vector = tuple[float, ...]


@dataclass(frozen=True)
class GoalRequest:
    """A request for a plan to a goal.

    Attributes:
        kind: One of `KINDS`, or ``csv``, which is not taken by MQTT; of the fields below only those of its kind count.
        id: Of MQTT: the sender's own, echoed in the answer.
        moment: Of MQTT: the newest that the screen had received.
        joints: Goal in the robot's order [rad], [m].
        position, orientation: Of tool0 in `frame` [m]; x y z w, of unit length.
        configuration: Empty: any.
        speed: Of the tool along a line [m/s]; 0: as fast as the limits allow.
        speed_scale, acceleration_scale: Fractions of the limits; 0: the planner's default.
        task: Id of a task of the building model; empty: the next one.
        frame: Of tf; by MQTT always "", the base_link.
        duration: Of the motion [s]; 0: the planner's default.
        path, columns: Of a file of waypoints on the planner's machine; see `waypoint_file`.
    """

    kind: str
    id: str = ""
    moment: Moment = Moment("", 0)
    joints: Vector = ()
    position: Vector = ()
    orientation: Vector = ()
    configuration: str = ""
    speed: float = 0.0
    speed_scale: float = 0.0
    acceleration_scale: float = 0.0
    task: str = ""
    frame: str = ""
    duration: float = 0.0
    path: str = ""
    columns: str = ""


@dataclass(frozen=True)
class IkRequest:
    """A pose for which joint values are wanted while it is dragged.

    Attributes:
        position, orientation: As in `GoalRequest`.
        seed: Joint values to be near to [rad], [m], in the robot's order; empty: the twin's present ones.
    """

    id: str
    position: Vector
    orientation: Vector
    seed: Vector = ()


def parse_plan_request(document: Mapping[str, Any], joints: Joints) -> GoalRequest:
    """Return the request in a document of `read_document`; PayloadError (``format``, ``joints``, ``values`` or ``moment``)."""
    kind = document.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise PayloadError("format", Sentence("link.payload.kind", found=shown(kind), known=", ".join(KINDS)))
    needed, optional = KINDS[kind]
    keys(document, f"plan_request {kind}", ("id", "kind", *needed), ("id", "kind", "moment", *needed, *optional))
    fields = read_fields(document, _readers(joints))
    return GoalRequest(kind=kind, moment=parse_moment(document.get("moment")), **fields)


def parse_ik(document: Mapping[str, Any], joints: Joints) -> IkRequest:
    """Return the pose in a document of `read_document`; PayloadError (``format``, ``joints`` or ``values``)."""
    keys(document, "ik", _IK, (*_IK, "seed"))
    return IkRequest(**read_fields(document, _readers(joints)))


def _readers(joints: Joints) -> Mapping[str, Reader]:
    """Return what reads each key of both kinds of request."""
    values = partial(_joint_values, joints)
    return {
        "seed": values,
        "id": own_id,
        "joints": values,
        "position": partial(_numbers, 3),
        "orientation": _unit_quaternion,
        **dict.fromkeys(_SCALES, fraction),
        "configuration": text,
        "speed": _speed,
        "task": text,
    }


def _joint_values(joints: Joints, values: object, key: str) -> Vector:
    if not isinstance(values, dict) or set(values) != set(joints.names):
        found = sorted(values) if isinstance(values, dict) else values
        names = ", ".join(joints.names)
        raise PayloadError("joints", Sentence("link.payload.joints", key=key, found=shown(found), joints=names))
    return tuple(number(values[name], f"{key}: {name}") for name in joints.names)


def _unit_quaternion(values: object, key: str) -> Vector:
    orientation = _numbers(4, values, key)
    norm = math.hypot(*orientation)
    if abs(norm - 1.0) > _UNIT:
        raise PayloadError("values", Sentence("link.payload.orientation", found=shown(list(orientation))))
    return tuple(value / norm for value in orientation)


def _speed(value: object, key: str) -> float:
    speed = number(value, key)
    if speed < 0.0:
        raise PayloadError("values", Sentence("link.payload.speed", found=speed))
    return speed


def _numbers(count: int, values: object, key: str) -> Vector:
    found = list_of(values, key)
    if len(found) != count:
        raise PayloadError("values", Sentence("link.payload.count", key=key, found=len(found), count=count))
    return tuple(number(value, key) for value in found)

"""`plan_request` and `ik` on MQTT: what a person at a console asks for, read strictly, and the answers. Standard library only.

A request becomes a plan for review by the planner's own services, or a sentence; nothing here moves anything. Poses are those of
`tool0` in the robot's base_link. A request for a plan repeats the newest moment that its screen had received (`core.freshness`); a
pose that is dragged is only answered, and needs none. SI: m, rad, s. What is not exactly as docs/reference/mqtt.md says is refused
(PayloadError).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from construction_twin.core.errors import PayloadError
from construction_twin.core.freshness import Moment, parse_moment
from construction_twin.link.json_fields import keys, list_of, number, shown, text
from construction_twin.link.remote_trajectory import Joints

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
class RemoteRequest:
    """A wish for a plan.

    Attributes:
        id: The sender's own, echoed in the answer.
        kind: One of `KINDS`; of the fields below only those of its kind count.
        joints: Goal in the robot's order [rad], [m].
        position, orientation: Of tool0 in the base_link [m]; x y z w, of unit length.
        configuration: Empty: any.
        speed: Of the tool along a line [m/s]; 0: as fast as the limits allow.
        speed_scale, acceleration_scale: Fractions of the limits; 0: the planner's default.
        task: Id of a task of the building model; empty: the next one.
        moment: The newest that the screen had received.
    """

    id: str
    kind: str
    moment: Moment
    joints: Vector = ()
    position: Vector = ()
    orientation: Vector = ()
    configuration: str = ""
    speed: float = 0.0
    speed_scale: float = 0.0
    acceleration_scale: float = 0.0
    task: str = ""


@dataclass(frozen=True)
class IkRequest:
    """A pose for which joint values are wanted while it is dragged.

    Attributes:
        position, orientation: As in `RemoteRequest`.
        seed: Joint values to be near to [rad], [m], in the robot's order; empty: the twin's present ones.
    """

    id: str
    position: Vector
    orientation: Vector
    seed: Vector = ()


def parse_plan_request(document: Mapping[str, Any], joints: Joints) -> RemoteRequest:
    """Return the wish in a document of `read_document`; PayloadError (``format``, ``joints``, ``values`` or ``moment``)."""
    kind = document.get("kind")
    if not isinstance(kind, str) or kind not in KINDS:
        raise PayloadError("format", f"kind is {shown(kind)}; expected one of {', '.join(KINDS)}")
    needed, optional = KINDS[kind]
    keys(document, f"plan_request {kind}", ("id", "kind", *needed), ("id", "kind", "moment", *needed, *optional))
    name, fields = _named(document), _fields(kind, document, joints)
    return RemoteRequest(name, kind, parse_moment(document.get("moment")), **fields)


def _fields(kind: str, document: Mapping[str, Any], joints: Joints) -> dict[str, Any]:
    """Return what a request of a kind says beside its id and its moment."""
    if kind == "joints":
        return {"joints": _joint_values(document["joints"], "joints", joints), **_scales(document)}
    if kind == "way_back":
        return {}
    if kind == "work_task":
        return {"task": text(document.get("task", ""), "task")}
    position, orientation = _pose(document)
    more: dict[str, Any] = {"position": position, "orientation": orientation, **_scales(document)}
    if kind == "pose":
        more["configuration"] = text(document.get("configuration", ""), "configuration")
    else:
        more["speed"] = number(document.get("speed", 0.0), "speed")
        if more["speed"] < 0.0:
            raise PayloadError("values", f"speed is {more['speed']:g}; expected m/s, or 0 for as fast as possible")
    return more


def parse_ik(document: Mapping[str, Any], joints: Joints) -> IkRequest:
    """Return the pose in a document of `read_document`; PayloadError (``format``, ``joints`` or ``values``)."""
    keys(document, "ik", _IK, (*_IK, "seed"))
    seed = _joint_values(document["seed"], "seed", joints) if "seed" in document else ()
    return IkRequest(_named(document), *_pose(document), seed)


def plan_answer(
    request: str, account: str, kind: str, ok: bool, reason: str,
    plan_id: str = "", plan_hash: str = "", duration: float = 0.0, expired: bool = False,
) -> bytes:  # fmt: skip
    """Return the payload for `plan_request/ack`; `ok`: a plan is under review, `reason`: a sentence, `expired`: it was too old."""
    answer = {"id": request, "account": account, "kind": kind, "ok": ok, "reason": reason}
    plan = {"plan_id": plan_id, "plan_hash": plan_hash, "duration": duration}
    return json.dumps(answer | plan | {"expired": expired}).encode()


def ik_answer(
    request: str, reach: str, joints: Mapping[str, float] | None, sentence: str, between: Sequence[str] = ()
) -> bytes:
    """Return the payload for `ik/ack/<account>`.

    Args:
        request: The sender's id; empty when it could not be read.
        reach: ``free``, ``contact``, ``out`` or ``unknown``.
        joints: Joint values by name [rad], [m]; None: there are none.
        sentence: Why, for people.
        between: The two bodies that touch; empty for none.
    """
    answer = {"id": request, "reach": reach, "joints": None if joints is None else dict(joints), "sentence": sentence}
    return json.dumps(answer | {"between": list(between)}, allow_nan=False).encode()


def _named(document: Mapping[str, Any]) -> str:
    name = text(document["id"], "id")
    if not name:
        raise PayloadError("format", "the id is empty; expected a text of your own, which the answer repeats")
    return name


def _scales(document: Mapping[str, Any]) -> dict[str, float]:
    scales = {key: number(document.get(key, 0.0), key) for key in _SCALES}
    for key, scale in scales.items():
        if not 0.0 <= scale <= 1.0:
            raise PayloadError("values", f"{key} is {scale:g}; expected a fraction from 0 (the planner's default) to 1")
    return scales


def _joint_values(values: object, key: str, joints: Joints) -> Vector:
    if not isinstance(values, dict) or set(values) != set(joints.names):
        found = sorted(values) if isinstance(values, dict) else values
        raise PayloadError(
            "joints", f"{key} names {shown(found)}; expected an object with each of {', '.join(joints.names)} once"
        )
    return tuple(number(values[name], f"{key}: {name}") for name in joints.names)


def _pose(document: Mapping[str, Any]) -> tuple[Vector, Vector]:
    position, orientation = (
        _numbers(document[key], key, count) for key, count in (("position", 3), ("orientation", 4))
    )
    norm = math.hypot(*orientation)
    if abs(norm - 1.0) > _UNIT:
        raise PayloadError("values", f"orientation is {shown(list(orientation))}; expected x y z w of length 1")
    return position, tuple(value / norm for value in orientation)


def _numbers(values: object, key: str, count: int) -> Vector:
    found = list_of(values, key)
    if len(found) != count:
        raise PayloadError("values", f"{key} has {len(found)} values; expected {count}")
    return tuple(number(value, key) for value in found)

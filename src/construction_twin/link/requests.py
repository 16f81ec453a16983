"""Models of people's and planners' requests by MQTT (docs/reference/mqtt.md), read strictly.

A refusal is a PayloadError: ``format`` for keys and their kinds, ``values`` for numbers, ``moment``, ``joints``. What starts
something repeats the newest moment that its screen had received (`core.freshness`). Poses are those of `tool0` in base_link.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar

import pydantic
from pydantic import AfterValidator, BeforeValidator, Field, PlainSerializer, PlainValidator, StringConstraints

from construction_twin.core.errors import PayloadError
from construction_twin.core.freshness import Moment, parse_moment
from construction_twin.mqtt.messages import demand_live, parse_object

_LONGEST_TEXT = 64
#: No position, velocity, acceleration or time of an arm is larger, in whatever unit.
LARGEST = 1e6
#: The least that people may set as speed limit, a fraction of the planned speed: 0 would be a pause, which has a name of its own.
LEAST_SPEED = 0.05
#: How far a quaternion may be from unit length; JSON of a browser has all digits, a person's has three.
_UNIT = 1e-3
#: Errors of numbers; all others are of keys and kinds.
_OF_NUMBERS = {
    "float_type", "finite_number", "int_type", "greater_than_equal", "less_than_equal", "too_short", "too_long",
}  # fmt: skip


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("expected one line of printable text")
    return text


def _not_blank(text: str) -> str:
    if not text.strip():
        raise ValueError("expected more than blanks")
    return text


def _unit_length(values: tuple[float, ...]) -> tuple[float, ...]:
    norm = math.hypot(*values)
    if abs(norm - 1.0) > _UNIT:
        raise PayloadError("values", f"orientation is {value_text(list(values))}; expected x y z w of length 1")
    return tuple(value / norm for value in values)


Text = Annotated[str, StringConstraints(max_length=_LONGEST_TEXT), AfterValidator(_printable)]
#: A text of the sender's own, which the answer repeats.
Id = Annotated[str, StringConstraints(min_length=1, max_length=_LONGEST_TEXT), AfterValidator(_printable)]
Name = Annotated[Text, AfterValidator(_not_blank)]
Reason = Annotated[str, StringConstraints(max_length=500), AfterValidator(_printable)]
Number = Annotated[float, Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
#: 0: the planner's default.
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
ParsedMoment = Annotated[Moment, PlainValidator(parse_moment)]
#: JSON has lists only.
Vector = Annotated[
    tuple[Number, ...], BeforeValidator(lambda value: tuple(value) if isinstance(value, list) else value)
]
Position = Annotated[Vector, Field(min_length=3, max_length=3)]
Quaternion = Annotated[Vector, Field(min_length=4, max_length=4), AfterValidator(_unit_length)]
#: By the joints' names.
JointValues = Annotated[dict[str, Number], Field(min_length=1)]
_Item = TypeVar("_Item")
#: A list that is read up to its first fault: a record of each of a million would hold up every thread of a node for seconds.
Many = Annotated[list[_Item], pydantic.FailFast()]


def rounded(places: int) -> PlainSerializer:
    """Return the annotation that writes a number with so many decimals."""
    return PlainSerializer(lambda value: float(round(value, places)), return_type=float)


class Request(pydantic.BaseModel):
    """A message, or a part of one."""

    model_config = pydantic.ConfigDict(strict=True, extra="forbid", frozen=True)

    @pydantic.model_validator(mode="before")
    @classmethod
    def _refuse_extra_keys(cls, found: Any) -> Any:
        # as of `Many`, before each unknown key is one more fault
        if isinstance(found, dict) and len(found) > len(cls.model_fields):
            raise ValueError(f"expected no keys but {', '.join(cls.model_fields)}")
        return found


_Model = TypeVar("_Model", bound=Request)


def read_document(payload: bytes, retained: bool, what: str, limit: int, parameter: str = "") -> dict[str, Any]:
    """Return the JSON object of a message; PayloadError ``retained``, ``size`` or ``format``. `parameter`: what sets the limit."""
    demand_live(retained, what)
    if len(payload) > limit:
        more = f" ({parameter}); use fewer points" if parameter else ""
        raise PayloadError("size", f"{what} of {len(payload)} bytes; at most {limit} are read{more}")
    return parse_object(payload, "format", limit)


def read(model: type[_Model], document: Mapping[str, Any], what: str) -> _Model:
    """Return what a document of `read_document` asks for, or raise PayloadError on the first thing that is wrong with it."""
    try:
        return model.model_validate(document)
    except pydantic.ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
    place = ".".join(map(str, first["loc"])) or what
    found = "nothing" if first["type"] == "missing" else value_text(first["input"])
    expected = repr(first["msg"])[1:-1][:200]
    reason = "values" if first["type"] in _OF_NUMBERS else "format"
    raise PayloadError(reason, f"field {value_text(place)} of a {what} message holds {found}: {expected}")


def value_text(value: object) -> str:
    """Return a value as a short text, of what is nested only the kind."""
    if isinstance(value, dict) and (len(value) > 8 or any(isinstance(item, (dict, list)) for item in value.values())):
        return f"an object of {len(value)}"
    if isinstance(value, list) and any(isinstance(item, (dict, list)) for item in value):
        return f"a list of {len(value)}"
    if isinstance(value, int) and abs(value) > LARGEST:
        return f"a whole number of {value.bit_length()} bits"
    words = repr(value[:8] if isinstance(value, list) else value)
    return words if len(words) <= 96 else words[:93] + "..."


@dataclass(frozen=True)
class Joints:
    """The robot's joints, base to tip: `names`, and which of them are prismatic."""

    names: tuple[str, ...]
    linear: tuple[bool, ...]

    def in_order(self, values: Mapping[str, float], key: str) -> tuple[float, ...]:
        """Return values by name in the robot's order; PayloadError (``joints``) where they are not of exactly these joints."""
        if set(values) != set(self.names):
            names = ", ".join(self.names)
            raise PayloadError(
                "joints", f"{key} names {value_text(sorted(values))}; expected an object with each of {names} once"
            )
        return tuple(values[name] for name in self.names)


# -- verdicts


@dataclass(frozen=True)
class ReviewRequest:
    """A verdict on a plan, by MQTT or from the command line.

    Attributes:
        verdict: ``approved`` or ``rejected``.
        reviewer: On record: the topic's account, and only without one what the message says.
        account: The topic's, which a site's broker has checked; "" on `review`.
        claimed_name: Another name in an account's message; unproven.
        rehearsal_hash: Of an override: of the result as the person saw it; "": there was none.
    """

    plan_id: str
    plan_hash: str
    verdict: str
    reviewer: str
    reason: str = ""
    account: str = ""
    claimed_name: str = ""
    moment: str = ""
    override_rehearsal: bool = False
    rehearsal_hash: str = ""

    @property
    def approve(self) -> bool:
        """Whether it is an approval."""
        return self.verdict == "approved"

    @property
    def recorded_reason(self) -> str:
        """The reviewer's reason on record, marked as received by MQTT."""
        who = f"by MQTT, which says it is {self.claimed_name!r}" if self.claimed_name else "by MQTT"
        return f"{who}: {self.reason}" if self.reason else who


class VerdictMessage(Request):
    """A message on `review/<account>`; an approval repeats its moment."""

    plan_id: Name
    plan_hash: Name
    verdict: Literal["approved", "rejected"]
    reviewer: Name = ""
    reason: Reason = ""
    moment: Text = ""

    @pydantic.model_validator(mode="after")
    def _check_moment(self) -> VerdictMessage:
        if self.verdict == "approved":
            parse_moment(self.moment)
        return self

    def review_by(self, account: str) -> ReviewRequest:
        """Return the verdict on record; without an account under the name in the message."""
        claimed = self.reviewer if account and self.reviewer != account else ""
        names = {"reviewer": account or self.reviewer, "account": account, "claimed_name": claimed}
        return ReviewRequest(**dict(self) | names, override_rehearsal=isinstance(self, Override))


class NamelessVerdict(VerdictMessage):
    """A message on `review`."""

    reviewer: Name


class Override(VerdictMessage):
    """A message on `override_rehearsal/<account>`, with the hash of the result that was seen; "": there was none."""

    verdict: Literal["approved"]
    reason: Annotated[Reason, AfterValidator(_not_blank)]
    rehearsal_hash: Text


# -- what is answered and pressed, speed limits


class AnswerRequest(Request):
    """A message on `answer/<account>`, with the question as the screen had shown it."""

    id: Id
    task: Id
    question: Annotated[str, StringConstraints(min_length=1, max_length=2000)]
    answer: Id
    moment: ParsedMoment


class Acknowledgement(Request):
    """A message on `acknowledge/<account>`; `message` is the id of the one that was read."""

    id: Id
    message: Id


class ButtonPress(Request):
    """A message on `stop/<account>` or `pause/<account>`; a moment in it is ignored, so that a wrong one loses no stop."""

    id: Annotated[Id, AfterValidator(_not_blank)]
    moment: Annotated[str, PlainValidator(lambda _: "")] = ""


class StampedButtonPress(ButtonPress):
    """A message on `resume/<account>`, `reset/<account>` or `arm/<account>`."""

    moment: Annotated[str, PlainValidator(lambda value: str(parse_moment(value)))] = Field("", validate_default=True)


class LowerSpeed(ButtonPress):
    """A message on `lower_speed/<account>`."""

    limit: Annotated[Number, Field(ge=LEAST_SPEED, le=1.0)]


class RaiseSpeed(StampedButtonPress):
    """A message on `raise_speed/<account>`."""

    limit: Annotated[Number, Field(ge=LEAST_SPEED, le=1.0)]


# -- requests for a plan to a goal


@dataclass(frozen=True)
class GoalRequest:
    """A request for a plan to a goal, by MQTT, from the command line or the marker in rviz.

    Attributes:
        kind: One of `GOALS`, or ``csv``, which is not read by MQTT; of the fields below only those of its kind count.
        joints: In the robot's order [rad], [m].
        position, orientation: Of tool0 in `frame` [m]; x y z w, of unit length.
        configuration: "": any.
        speed: Of the tool along a line [m/s]; 0: as fast as the limits allow.
        speed_scale, acceleration_scale, duration: Fractions of the limits, and [s]; 0: the planner's default.
        task: Of the building model; "": the next one.
        frame: Of tf; "": base_link.
        path: Of a file of waypoints on the planner's machine.
    """

    kind: str
    id: str = ""
    moment: Moment = Moment("", 0)
    joints: tuple[float, ...] = ()
    position: tuple[float, ...] = ()
    orientation: tuple[float, ...] = ()
    configuration: str = ""
    speed: float = 0.0
    speed_scale: float = 0.0
    acceleration_scale: float = 0.0
    task: str = ""
    frame: str = ""
    duration: float = 0.0
    path: str = ""


class WayBack(Request):
    """A message on `plan_request/<account>`; what more there may be depends on its kind."""

    id: Id
    kind: str
    moment: ParsedMoment = Field("", validate_default=True)


class _Scaled(WayBack):
    speed_scale: Fraction = 0.0
    acceleration_scale: Fraction = 0.0


class _JointGoal(_Scaled):
    joints: JointValues


class _PoseGoal(_Scaled):
    position: Position
    orientation: Quaternion
    configuration: Text = ""


class _LineGoal(_Scaled):
    position: Position
    orientation: Quaternion
    speed: Annotated[Number, Field(ge=0.0)] = 0.0


class _TaskGoal(WayBack):
    task: Text = ""


GOALS: Mapping[str, type[WayBack]] = {
    "joints": _JointGoal,
    "pose": _PoseGoal,
    "line": _LineGoal,
    "way_back": WayBack,
    "work_task": _TaskGoal,
}


def read_goal(document: Mapping[str, Any], joints: Joints) -> GoalRequest:
    """Return the request for a plan in a document of `read_document`, or raise PayloadError."""
    kind = document.get("kind")
    if not isinstance(kind, str) or kind not in GOALS:
        raise PayloadError("format", f"kind is {value_text(kind)}; expected one of {', '.join(GOALS)}")
    fields: dict[str, Any] = dict(read(GOALS[kind], document, f"plan_request {kind}"))
    if "joints" in fields:
        fields["joints"] = joints.in_order(fields["joints"], "joints")
    return GoalRequest(**fields)

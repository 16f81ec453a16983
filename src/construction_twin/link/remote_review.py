"""`plan` and `review` on MQTT: what a tablet gets to see, and what it may answer. Pure; standard library only.

SI: m, rad, s. An approval repeats the newest moment that its screen had received (`core.freshness`). A review is refused
(PayloadError) unless it is exactly as written here; what is under review decides the rest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any

from construction_twin.core.errors import PayloadError
from construction_twin.core.freshness import parse_moment
from construction_twin.core.records import SPACED, decimals, dumped, left_out
from construction_twin.core.sentences import Sentence
from construction_twin.mqtt.json_fields import Reader, read_fields
from construction_twin.mqtt.messages import demand_live, parse_object, shown_keys

#: Longest review that is read [bytes].
MAX_REVIEW_BYTES = 2048
#: Most numbers of a trajectory that a plan carries, about 5000 waypoints of six joints: brokers limit a message (a site's: 4 MiB).
MAX_TRAJECTORY_NUMBERS = 100_000
#: Longest text of a plan that is shown whole.
_MAX_SHOWN = 200
#: Most names of objects that are shown of a segment's change of the scene.
_MOST_OBJECTS = 20
#: Decimals of lengths that are only displayed, 0.1 mm, and of times [s] and deviations [m].
_DISPLAYED, _MICRO = 4, 6

Point = tuple[float, float, float]


@dataclass(frozen=True)
class ReviewRequest:
    """A verdict on a plan, by MQTT or from the command line.

    Attributes:
        verdict: ``approved`` or ``rejected``.
        reviewer: Who is on record: the topic's account, and only without one what the message says.
        account: The topic's, which a site's broker has checked; "" on `review`.
        says: What a message of an account says of who gave it, where that is another name; proves nothing.
        moment: The newest that the screen had received; of a rejection it may be "".
        override_rehearsal: It came on `override_rehearsal/<account>`: an approval in spite of the rehearsal, which needs a reason.
        rehearsal_hash: Of the result that it is in spite of, as the person saw it; "": there was none.
    """

    plan_id: str
    plan_hash: str
    verdict: str
    reviewer: str
    reason: str = ""
    account: str = ""
    says: str = ""
    moment: str = ""
    override_rehearsal: bool = False
    rehearsal_hash: str = ""

    @property
    def approve(self) -> bool:
        """True for an approval."""
        return self.verdict == "approved"


def parse_review(payload: bytes, retained: bool, account: str = "") -> ReviewRequest:
    """Return the verdict in a message on `review/<account>`, or on `review`.

    Args:
        payload: JSON object with `plan_id`, `plan_hash`, `verdict`, `reviewer`, `moment` and, if wanted, `reason`; with an account
            `reviewer` may be left out, of a rejection `moment`.
        retained: The message's retain flag.
        account: Of the topic; "" on `review`.

    Raises:
        PayloadError: ``retained``, ``moment`` or ``review``.
    """
    return _parse(
        payload, retained, account, ("plan_id", "plan_hash", "verdict", *(() if account else ("reviewer",))), _READERS
    )


def _parse(
    payload: bytes, retained: bool, account: str, needed: Sequence[str], readers: Mapping[str, Reader]
) -> ReviewRequest:
    demand_live(retained, "review")
    document = parse_object(payload, "review", MAX_REVIEW_BYTES)
    if not set(needed) <= set(document) <= set(readers):
        found = Sentence("link.payload.review_keys", found=shown_keys(document), needed=", ".join(needed))
        raise PayloadError("review", found)
    fields = read_fields(document, readers)
    if fields["verdict"] == "approved":
        parse_moment(fields.get("moment"))
    if not account:
        return ReviewRequest(**fields)
    says = fields.pop("reviewer", account)
    return ReviewRequest(**fields, reviewer=account, account=account, says="" if says == account else says)


def parse_override(payload: bytes, retained: bool, account: str) -> ReviewRequest:
    """Return the approval in a message on `override_rehearsal/<account>`: as `parse_review`, with `reason` and
    `rehearsal_hash`: that of the result that was seen, "" where there was none.

    Raises:
        PayloadError: As `parse_review`; ``review`` for a rejection, or without a reason.
    """
    review = _parse(payload, retained, account, _OVERRIDE_NEEDS, _OVERRIDE_READERS)
    if not (review.approve and review.reason.strip()):
        raise PayloadError("review", Sentence("link.payload.override"))
    return replace(review, override_rehearsal=True)


def _text(most: int, value: object, key: str) -> str:
    if not isinstance(value, str) or len(value) > most or not value.isprintable():
        raise PayloadError("review", Sentence("link.payload.review_text", key=key, longest=most))
    return value


def _name(value: object, key: str) -> str:
    found = _text(64, value, key)
    if not found.strip():
        raise PayloadError("review", Sentence("link.payload.review_without", key=key))
    return found


def _verdict(value: object, key: str) -> str:
    found = _text(16, value, key)
    if found not in ("approved", "rejected"):
        raise PayloadError("review", Sentence("link.payload.review_verdict", found=repr(found)))
    return found


#: What reads each key of a review.
_READERS: Mapping[str, Reader] = {
    **dict.fromkeys(("plan_id", "plan_hash", "reviewer"), _name),
    "verdict": _verdict,
    "reason": partial(_text, 500),
    "moment": partial(_text, 64),
}
_OVERRIDE_READERS: Mapping[str, Reader] = {**_READERS, "rehearsal_hash": partial(_text, 64)}
_OVERRIDE_NEEDS = ("plan_id", "plan_hash", "verdict", "reason", "rehearsal_hash")


def recorded_reason(review: ReviewRequest) -> str:
    """Return the reviewer's words as they are recorded: what came by MQTT was not said at this machine."""
    who = f"by MQTT, which says it is {review.says!r}" if review.says else "by MQTT"
    return f"{who}: {review.reason}" if review.reason else who


@dataclass(frozen=True)
class SwitchView:
    """What is shown of a switch at the end of a segment.

    Attributes:
        confirm: What the tool's inputs must read afterwards.
        timeout: [s]
    """

    output: str
    value: bool
    confirm: Mapping[str, bool]
    timeout: float


@dataclass(frozen=True)
class SegmentView:
    """What is shown of a segment of a work plan; the keys of its JSON.

    Attributes:
        end: [s]
        tool_path_end: Which point of the tool path is at its end, from 0.
        requires: Inputs of the tool.
        scene, scene_after: Hashes.
        put, remove: Names of the objects that come, and of those that go; for display.
    """

    name: str
    end: float
    tool_path_end: int
    engaged: bool
    requires: Mapping[str, bool]
    switches: Sequence[SwitchView]
    scene: str
    scene_after: str
    put: Sequence[str]
    remove: Sequence[str]


@dataclass(frozen=True)
class ClearanceView:
    """How close the arm comes to something else.

    Attributes:
        distance: [m]; inf, which JSON has as null: there is nothing to touch.
        time: Of the plan [s].
        between: Links or objects.
        point: In the plan's `frame` [m].
    """

    distance: Annotated[float, {"type": ["number", "null"]}]
    time: float
    between: Sequence[str]
    point: Point


@dataclass(frozen=True)
class UseView:
    """Largest fraction of the limits per joint; empty: not measured."""

    velocity: Sequence[float]
    acceleration: Sequence[float]
    jerk: Sequence[float]


@dataclass(frozen=True, kw_only=True)
class PlanView:
    """A message on <prefix>/<robot>/plan: the plan under review.

    Attributes:
        scene: Its hash.
        frame: Of all points.
        created_ns: ROS time [ns].
        duration, planning_time: [s]
        start, goal: Joint positions [rad, m].
        waypoints: How many points the whole tool path has.
        tool_path: Of tool0 [m]; at the waypoints until it is thinned.
        tool_path_deviation: How far the thinned path is off at most [m].
        clearance: None when it was not measured.
        trajectory: What the trajectory's hash covers besides the joints' names: ``times`` [s], and by waypoint ``positions``,
            ``velocities`` and ``accelerations`` [rad, m, s]; None when it is too long. Who checks the hash reads the numbers.
        tool: Hash of the tool file that counts, where there is a tool. A rehearsal with another one is none of this plan.
        task, content, segments: Of a work plan only. `content` is the text whose SHA-256 is its hash.
    """

    id: Annotated[str, {"minLength": 1}]
    hash: str
    source: str
    planner: str
    scene: str
    frame: str
    created_ns: int
    duration: float = decimals(_MICRO)
    planning_time: float = decimals(_MICRO)
    joints: Sequence[str]
    start: Sequence[float]
    goal: Sequence[float]
    waypoints: int
    tool_path: Sequence[Point] = decimals(_DISPLAYED)
    tool_path_deviation: float = decimals(_MICRO, 0.0)
    clearance: ClearanceView | None
    use: UseView
    trajectory: Mapping[str, Any] | None
    tool: str | None = left_out()
    task: str | None = left_out()
    content: str | None = left_out()
    segments: Sequence[SegmentView] | None = left_out()

    def to_json(self, points: int) -> bytes:
        """Return the payload for `plan`.

        Args:
            points: The tool path is thinned to at most so many points, both ends among them; of a work plan the ends of the
                segments are kept besides.
        """
        segments = self.segments or ()
        path, deviation, ends = thinned(self.tool_path, points, [segment.tool_path_end for segment in segments])
        sent = [
            replace(segment, tool_path_end=end, put=_object_names(segment.put)) for segment, end in zip(segments, ends)
        ]
        message = replace(
            self,
            source=shown(self.source),
            planner=shown(self.planner),
            scene=shown(self.scene),
            frame=shown(self.frame),
            tool_path=path,
            tool_path_deviation=deviation,
            trajectory=None if self._is_too_long() else self.trajectory,
            segments=sent or None,
        )
        return dumped(message, marks=SPACED)

    def _is_too_long(self) -> bool:
        """Return whether the trajectory has more numbers than a message may carry."""
        times = self.trajectory["times"] if self.trajectory is not None else ()
        return len(times) * (1 + 3 * len(self.joints)) > MAX_TRAJECTORY_NUMBERS


def shown(text: str) -> str:
    """Return a text as a reviewer sees it: cut where it is longer than `_MAX_SHOWN`, and ending in ... then."""
    return text if len(text) <= _MAX_SHOWN else text[: _MAX_SHOWN - 3] + "..."


def _object_names(names: Sequence[str]) -> list[str]:
    """Return the first names of many; the last entry says how many more there are."""
    found = [shown(name) for name in names[:_MOST_OBJECTS]]
    return found if len(names) <= _MOST_OBJECTS else [*found, f"and {len(names) - _MOST_OBJECTS} more"]


def kept_points(count: int, points: int, keep: Sequence[int] = ()) -> list[int]:
    """Return the numbers of at most `points` of `count` points, evenly and with both ends, and besides those of `keep`."""
    if count <= points:
        return list(range(count))
    return sorted({round(k * (count - 1) / (points - 1)) for k in range(points)} | set(keep))


def thinned(path: Sequence[Point], points: int, keep: Sequence[int] = ()) -> tuple[list[Point], float, list[int]]:
    """Return at most `points` of a path, evenly by their number and with both ends, and how much was lost.

    Args:
        path: [m]
        points: At least 2.
        keep: Numbers of points that are kept besides.

    Returns:
        kept: [m]
        deviation: Largest distance of a point left out from the line between its kept neighbours [m].
        places: Where in `kept` the points of `keep` are.
    """
    indices = kept_points(len(path), points, keep)
    deviation = 0.0
    for begin, end in zip(indices, indices[1:]):
        for k in range(begin + 1, end):
            deviation = max(deviation, _distance(path[k], path[begin], path[end]))
    place = {index: number for number, index in enumerate(indices)}
    return [path[k] for k in indices], deviation, [place[index] for index in keep]


def _distance(point: Point, begin: Point, end: Point) -> float:
    """Return the distance of a point from the line between two others [m]."""
    along = [b - a for a, b in zip(begin, end)]
    length = math.hypot(*along)
    if length == 0.0:
        return math.dist(point, begin)
    fraction = sum(d * (p - a) for d, p, a in zip(along, point, begin)) / length**2
    fraction = min(1.0, max(0.0, fraction))
    return math.dist(point, [a + fraction * d for a, d in zip(begin, along)])


class PlanBoard:
    """What `plan` holds on MQTT: the plan under review, or nothing. Payloads are bytes; empty means nothing.

    Messages on ROS may come in any order, and a verdict before the plan it is about.
    """

    def __init__(self):
        self._decided = ""
        self._plan = ""
        self.payload = b""

    def on_plan(self, plan_id: str, payload: bytes) -> None:
        """Take a new plan, in place of the one before."""
        self._plan = plan_id
        self.payload = b"" if plan_id == self._decided else payload

    def on_verdict(self, plan_id: str) -> None:
        """Take that a plan was decided, by whomever."""
        self._decided = plan_id
        if plan_id == self._plan:
            self.payload = b""

    def restart(self) -> None:
        """Take the plan away: a new session has made it void."""
        self.on_verdict(self._plan)


#: Decimals of a time [s] and of a place that is drawn [m].
_TIME, _PLACE = 6, 4


@dataclass(frozen=True)
class PathView:
    """A message on <prefix>/<robot>/path: the tool's path of the plan that is played.

    Attributes:
        plan_id: As `execution` of `view` has it.
        times: Of the plan, when the tool is at each point [s].
        tool_path: Of tool0 in base_link [m].
    """

    plan_id: Annotated[str, {"minLength": 1}]
    times: Sequence[float] = decimals(_TIME)
    tool_path: Sequence[Point] = decimals(_PLACE)

    def to_json(self, points: int, keep: Sequence[int] = ()) -> bytes:
        """Return the payload for `path`.

        Args:
            points: It is thinned to at most so many, both ends among them.
            keep: Numbers of points that are kept besides.
        """
        kept = kept_points(len(self.tool_path), points, keep)
        return dumped(PathView(self.plan_id, [self.times[k] for k in kept], [self.tool_path[k] for k in kept]))

"""`plan` and `review` on MQTT: what a tablet gets to see, and what it may answer. Pure; standard library only.

SI: m, rad, s. A review is refused (PayloadError) unless it is exactly as written here; what is under review decides the rest.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from construction_twin.core.errors import PayloadError
from construction_twin.mqtt.messages import parse_object

#: Longest review that is read [bytes].
MAX_REVIEW_BYTES = 2048
_KEYS = ("plan_id", "plan_hash", "verdict", "reviewer")
_MAX_TEXT = {"plan_id": 64, "plan_hash": 64, "verdict": 16, "reviewer": 64, "reason": 500}
#: Longest text of a plan that is shown whole.
_MAX_SHOWN = 200
#: Decimals of lengths that are only displayed: 0.1 mm.
_DECIMALS = 4

Point = tuple[float, float, float]


@dataclass(frozen=True)
class RemoteReview:
    """A verdict that came by MQTT; `verdict` is ``approved`` or ``rejected``."""

    plan_id: str
    plan_hash: str
    verdict: str
    reviewer: str
    reason: str = ""

    @property
    def approves(self) -> bool:
        """True for an approval."""
        return self.verdict == "approved"


def parse_review(payload: bytes, retained: bool) -> RemoteReview:
    """Return the verdict in a message on `review`.

    Parameters
    ----------
    payload : bytes
        JSON object with `plan_id`, `plan_hash`, `verdict`, `reviewer` and, if wanted, `reason`.
    retained : bool
        The message's retain flag.

    Raises
    ------
    PayloadError
        ``retained`` or ``review``.
    """
    if retained:
        raise PayloadError(
            "retained", "retained review: it is unknown when it was given; publish it without the retain flag"
        )
    document = parse_object(payload, "review", MAX_REVIEW_BYTES)
    if not set(_KEYS) <= set(document) <= {*_KEYS, "reason"}:
        raise PayloadError(
            "review",
            f"review with keys {[key[:32] for key in sorted(document)[:8]]}; expected {', '.join(_KEYS)} and reason",
        )
    for key, value in document.items():
        if not isinstance(value, str) or len(value) > _MAX_TEXT[key] or not value.isprintable():
            raise PayloadError(
                "review", f"review whose {key} is not a text of at most {_MAX_TEXT[key]} characters in one line"
            )
    for key in ("plan_id", "plan_hash", "reviewer"):
        if not document[key].strip():
            raise PayloadError("review", f"review without {key}: say which plan was looked at, and by whom")
    if document["verdict"] not in ("approved", "rejected"):
        raise PayloadError("review", f"review with verdict {document['verdict']!r}; expected approved or rejected")
    return RemoteReview(**document)


def review_answer(review: RemoteReview | None, ok: bool, reason: str) -> bytes:
    """Return the payload for `review/ack`; without a review, because it could not be read, its fields are empty."""
    review = review or RemoteReview("", "", "", "")
    answer = {"plan_id": review.plan_id, "plan_hash": review.plan_hash, "verdict": review.verdict}
    return json.dumps(answer | {"reviewer": review.reviewer, "ok": ok, "reason": reason}).encode()


@dataclass(frozen=True)
class PlanView:
    """What is shown of a plan.

    Attributes
    ----------
    id, hash, source, planner, scene, frame : str
        `frame` is that of all points.
    created_ns : int
        ROS time [ns].
    duration, planning_time : float
        [s]
    joint_names : sequence of str
    start, goal : sequence of float
        Joint positions [rad].
    tool_path : sequence of (float, float, float)
        Of tool0 at the waypoints [m].
    clearance : Mapping or None
        ``distance`` [m], ``time`` [s], ``between``, ``point`` [m]; None when it was not measured.
    use : Mapping
        Largest fraction of the limits per joint: ``velocity``, ``acceleration``, ``jerk``; empty lists when not measured.
    """

    id: str
    hash: str
    source: str
    planner: str
    scene: str
    frame: str
    created_ns: int
    duration: float
    planning_time: float
    joint_names: Sequence[str]
    start: Sequence[float]
    goal: Sequence[float]
    tool_path: Sequence[Point]
    clearance: Mapping | None
    use: Mapping[str, Sequence[float]]

    def to_json(self, points: int) -> bytes:
        """Return the payload for `plan`.

        Parameters
        ----------
        points : int
            The tool path is thinned to at most so many points, both ends among them.
        """
        path, deviation = thinned(self.tool_path, points)
        document = {
            "id": self.id,
            "hash": self.hash,
            "source": shown(self.source),
            "planner": shown(self.planner),
            "scene": shown(self.scene),
            "frame": shown(self.frame),
            "created_ns": self.created_ns,
            "duration": round(self.duration, 6),
            "planning_time": round(self.planning_time, 6),
            "joints": list(self.joint_names),
            "start": list(self.start),
            "goal": list(self.goal),
            "waypoints": len(self.tool_path),
            "tool_path": [[round(value, _DECIMALS) for value in point] for point in path],
            "tool_path_deviation": round(deviation, 6),
            "clearance": self.clearance,
            "use": {name: list(values) for name, values in self.use.items()},
        }
        # nan and inf are no JSON: a tablet could not read them
        return json.dumps(_finite(document), allow_nan=False).encode()


def shown(text: str) -> str:
    """Return a text as a reviewer sees it: cut where it is longer than `_MAX_SHOWN`, and ending in ... then."""
    return text if len(text) <= _MAX_SHOWN else text[: _MAX_SHOWN - 3] + "..."


def _finite(value):
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    return [_finite(item) for item in value] if isinstance(value, (list, tuple)) else value


def thinned(path: Sequence[Point], points: int) -> tuple[list[Point], float]:
    """Return at most `points` of a path, evenly by their number and with both ends, and how much was lost.

    Returns
    -------
    kept : list of (float, float, float)
        [m]
    deviation : float
        Largest distance of a point left out from the line between its kept neighbours [m].
    """
    last = len(path) - 1
    if last < points:
        return list(path), 0.0
    indices = [round(k * last / (points - 1)) for k in range(points)]
    deviation = 0.0
    for begin, end in zip(indices, indices[1:]):
        for k in range(begin + 1, end):
            deviation = max(deviation, _distance(path[k], path[begin], path[end]))
    return [path[k] for k in indices], deviation


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

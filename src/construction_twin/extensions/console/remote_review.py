"""`plan`, `path` and `scene` on MQTT: a plan and a scene for a tablet. SI: m, rad, s. Pure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any

import pydantic
from pydantic import Field

from construction_twin.core.records import OR_NULL
from construction_twin.link.requests import rounded
from construction_twin.scene.objects import Scene

#: Most numbers of a trajectory that a plan carries, about 5000 waypoints of six joints: brokers limit a message (a site's: 4 MiB).
MAX_TRAJECTORY_NUMBERS = 100_000
#: Longest text of a plan that is shown whole.
_MAX_SHOWN = 200
#: Most names of objects that are shown of a segment's change of the scene.
_MOST_OBJECTS = 20
#: Decimals of lengths that are only displayed, 0.1 mm, and of times [s].
_DISPLAYED, _MICRO = 4, 6

Point = tuple[float, float, float]
_Shown = Annotated[float, rounded(_DISPLAYED)]
_ShownPoint = tuple[_Shown, _Shown, _Shown]
#: Of a field that is written only where it is not None.
_LEFT_OUT = Field(exclude_if=lambda value: value is None)


@dataclass(frozen=True)
class SwitchView:
    """A switch at the end of a segment; `confirm`: what the tool's inputs must read within `timeout` [s]."""

    output: str
    value: bool
    confirm: Mapping[str, bool]
    timeout: float


@dataclass(frozen=True)
class SegmentView:
    """A segment of a work plan, which ends at `end` [s] and at a point of the tool path."""

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
    """The smallest distance [m], null for nothing to touch: at a `time` of the plan [s] and a `point` in its frame [m]."""

    distance: Annotated[float, OR_NULL]
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
    """A message on <prefix>/<robot>/plan: the plan under review. SI: m, rad, s.

    Attributes:
        waypoints: Number of points of the whole tool path.
        tool_path: Of tool0; at the waypoints until `to_json` thins it.
        trajectory: ``times``, and for each ``positions``, ``velocities``, ``accelerations``, which the hash covers; None: too long.
        tool: Hash of the tool file, as in the plan's rehearsal.
        task, content, segments: Of a work plan only. `content` is the text whose SHA-256 is its hash.
    """

    id: Annotated[str, Field(min_length=1)]
    hash: str
    source: str
    planner: str
    scene: str
    frame: str
    created_ns: int
    duration: Annotated[float, rounded(_MICRO)]
    planning_time: Annotated[float, rounded(_MICRO)]
    joints: Sequence[str]
    start: Sequence[float]
    goal: Sequence[float]
    waypoints: int
    tool_path: Sequence[_ShownPoint]
    clearance: ClearanceView | None
    use: UseView
    trajectory: Mapping[str, Any] | None
    tool: Annotated[str | None, _LEFT_OUT] = None
    task: Annotated[str | None, _LEFT_OUT] = None
    content: Annotated[str | None, _LEFT_OUT] = None
    segments: Annotated[Sequence[SegmentView] | None, _LEFT_OUT] = None

    def to_json(self, points: int) -> bytes:
        """Return the payload for `plan`, its tool path thinned to `points` and the ends of the segments."""
        segments = self.segments or ()
        sampled = sampled_points(len(self.tool_path), points, [segment.tool_path_end for segment in segments])
        sent = [
            replace(each, tool_path_end=sampled.index(each.tool_path_end), put=_object_names(each.put))
            for each in segments
        ]
        times = self.trajectory["times"] if self.trajectory is not None else ()
        too_long = len(times) * (1 + 3 * len(self.joints)) > MAX_TRAJECTORY_NUMBERS
        message = replace(
            self,
            source=shortened(self.source),
            planner=shortened(self.planner),
            scene=shortened(self.scene),
            frame=shortened(self.frame),
            tool_path=[self.tool_path[k] for k in sampled],
            trajectory=None if too_long else self.trajectory,
            segments=sent or None,
        )
        return _PLANS.dump_json(message)


_PLANS = pydantic.TypeAdapter(PlanView)


def shortened(text: str) -> str:
    """Return a text of at most `_MAX_SHOWN` characters, cut with ..."""
    return text if len(text) <= _MAX_SHOWN else text[: _MAX_SHOWN - 3] + "..."


def _object_names(names: Sequence[str]) -> list[str]:
    """Return the first names of many; the last entry says how many more there are."""
    found = [shortened(name) for name in names[:_MOST_OBJECTS]]
    return found if len(names) <= _MOST_OBJECTS else [*found, f"and {len(names) - _MOST_OBJECTS} more"]


def sampled_points(count: int, points: int, required: Sequence[int] = ()) -> list[int]:
    """Return the numbers of at most `points` of `count` points, evenly and with both ends, and besides those of `required`."""
    if count <= points:
        return list(range(count))
    return sorted({round(k * (count - 1) / (points - 1)) for k in range(points)} | set(required))


class PlanBoard:
    """The payload of `plan` on MQTT, empty for none; a verdict may come before its plan."""

    def __init__(self):
        self._decided = ""
        self._plan = ""
        self.payload = b""

    @property
    def plan(self) -> str:
        """Id of the plan; empty: none."""
        return self._plan if self.payload else ""

    def on_plan(self, plan_id: str, payload: bytes) -> None:
        """Replace the plan."""
        self._plan = plan_id
        self.payload = b"" if plan_id == self._decided else payload

    def on_verdict(self, plan_id: str) -> None:
        """Clear a decided plan."""
        self._decided = plan_id
        if plan_id == self._plan:
            self.payload = b""

    def restart(self) -> None:
        """Clear the plan (a new session)."""
        self.on_verdict(self._plan)


@dataclass(frozen=True)
class PathView:
    """A message on <prefix>/<robot>/path: where tool0 is in base_link [m] at `times` of the plan that is played [s]."""

    plan_id: Annotated[str, Field(min_length=1)]
    times: Sequence[Annotated[float, rounded(_MICRO)]]
    tool_path: Sequence[_ShownPoint]

    def to_json(self, points: int, required: Sequence[int] = ()) -> bytes:
        """Return the payload for `path`, thinned to `points` and those of `required`."""
        sampled = sampled_points(len(self.tool_path), points, required)
        return _PATHS.dump_json(
            PathView(self.plan_id, [self.times[k] for k in sampled], [self.tool_path[k] for k in sampled])
        )


_PATHS = pydantic.TypeAdapter(PathView)


@dataclass(frozen=True)
class ObjectView:
    """One body of a scene: at its pose in `link`, or in the scene's frame [m], x y z w.

    Attributes:
        size: As in `SceneObject.msg` [m]; of a mesh its scale.
        mesh: SHA-256 of the file; empty for other shapes.
        padding: Distance to keep from it [m], added to the scene's own.
    """

    name: str
    shape: str
    size: Sequence[float]
    mesh: str
    position: Annotated[Sequence[float], Field(min_length=3, max_length=3)]
    orientation: Annotated[Sequence[float], Field(min_length=4, max_length=4)]
    padding: float
    link: str
    touch: Sequence[str]


@dataclass(frozen=True)
class SceneView:
    """A message on <prefix>/<robot>/scene: what the arm must not touch, in its base_link, and how far to keep from it [m]."""

    hash: str
    frame: str
    padding: float
    objects: Sequence[ObjectView]


def scene_view(scene: Scene, frame: str) -> SceneView:
    """Return what is shown of a scene; `frame` is the robot's base_link. `core.records` writes it."""
    other = {"mesh": "mesh_digest", "orientation": "quaternion"}
    names = [each.name for each in fields(ObjectView)]
    objects = [ObjectView(*(getattr(each, other.get(name, name)) for name in names)) for each in scene.objects]
    return SceneView(scene.hash, frame, scene.padding, objects)

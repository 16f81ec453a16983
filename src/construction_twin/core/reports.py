"""What gate, bridge, tool, executor and work report: one record per message.

Fields are named, and explained, as in ``msg/``: `text` is `state` as a word, times are whole ns of ROS time, 0 for none.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated, Any

from construction_twin.core.records import OR_NULL, SECONDS, seconds_field
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import seconds

#: Why nothing is known of the tool before the first report.
NO_REPORT = Sentence("no report of the tool yet; check that bridge and gateway run")
#: Numbers of the states WAITING and IDLE of `Execution.msg`.
_NOTHING_PLAYED = (0, 1)
#: A number that may be nan, which JSON has as null.
_OrNan = Annotated[float, OR_NULL]


@dataclass(frozen=True)
class SyncReport:
    """The gate's report: `Sync.msg`."""

    text: str
    reason: str
    policy: str = ""
    comparison: str = ""
    error: tuple[float, ...] = ()
    threshold: tuple[float, ...] = ()
    round_trip: float = math.nan
    servo_lag: float = math.nan
    violations: int = 0
    agreed: bool = False
    name: tuple[str, ...] = ()
    held_stamp: int = 0
    state: int = 0
    stamp: int = 0


@dataclass(frozen=True)
class HoldReport:
    """Why the gate is closed: `Hold.msg`."""

    cause: str = ""
    since: int = 0
    stamp: int = 0


@dataclass(frozen=True)
class SpeedReport:
    """The speed limit in force: `SpeedLimitInForce.msg`. Fractions of the planned speed, 0 to 1."""

    limit: float = 1.0
    by: str = ""
    reason: str = ""
    people: float = 1.0
    person: str = ""
    since: int = 0
    replaced: float = 1.0
    replaced_person: str = ""
    program: float = 1.0
    program_name: str = ""
    stamp: int = 0


@dataclass(frozen=True)
class LinkReport:
    """The bridge's report: `Link.msg`."""

    text: str
    reason: str
    gateway_state: str = ""
    gateway_counters: Mapping[str, str] = field(default_factory=dict)
    commands_refused: int = 0
    states_refused: int = 0
    responsible: str = ""
    not_checked: tuple[str, ...] = ()
    gateway_kind: str = ""
    session: str = ""
    tool_pose: str = ""
    state: int = 0
    stamp: int = 0
    commands_sent: int = 0
    reply_us_bins: tuple[int, ...] = ()
    reply_us_counts: tuple[int, ...] = ()

    @property
    def late(self) -> int | None:
        """Number of late replies at the controller; None: unknown."""
        # a counter appears with its first use
        return int(self.gateway_counters.get("late_replies", "0")) if self.gateway_counters else None


@dataclass(frozen=True)
class SessionRequest:
    """A person asked for a session with the gateway: `SessionRequest.msg`."""

    verb: str
    person: str
    lifts: str
    stamp: int = 0


@dataclass(frozen=True)
class SpeedChange:
    """A person has set the speed limit of people: `SpeedChange.msg`."""

    person: str
    limit: float
    before: float
    whose: str
    stamp: int = 0


@dataclass(frozen=True)
class ExecutionReport:
    """The executor's report: `Execution.msg`."""

    text: str
    reason: str
    plan_id: str = ""
    outcome: str = ""
    plan_start: int = 0
    duration: float = 0.0
    rate: float = 0.0
    speed_limit: float = 1.0
    segment: int = -1
    segment_name: str = ""
    at_boundary: bool = False
    wants_scene: bool = False
    engaged: bool = False
    expected_scene: str = ""
    approval_obstacle: str = ""
    overridable: bool = False
    state: int = 0
    stamp: int = 0
    moment: str = ""

    @property
    def playing(self) -> bool:
        """Whether a plan is under way, paused or held included."""
        return self.state not in _NOTHING_PLAYED

    @property
    def final_outcome(self) -> str:
        """Outcome of the last plan; empty while one is under way."""
        return "" if self.playing else self.outcome

    def progress(self, now: float) -> float | None:
        """Return how much of a plan's time is over at `now` [s], 0 to 1; None unless a plan is being played."""
        if self.text != "PLAYING" or not self.plan_start or self.duration <= 0.0:
            return None
        return min(1.0, max(0.0, (now - seconds(self.plan_start)) / self.duration))


@dataclass(frozen=True, kw_only=True)
class TaskReport:
    """One task of a building model: `WorkTask.msg`, one entry of `work/tasks` on MQTT. What has a default may be missing there."""

    id: str
    name: str
    element: str
    element_name: str = ""
    state: str
    reason: str
    after: tuple[str, ...]
    robot: str = ""
    plan_id: str = ""
    deviation_mm: _OrNan = math.nan
    deviation_deg: _OrNan = math.nan
    mass_kg: _OrNan = math.nan
    scheduled_duration: _OrNan = math.nan
    tolerance_mm: _OrNan = math.nan
    tolerance_deg: _OrNan = math.nan
    question: str = ""
    answers: tuple[str, ...] = ()
    grip: str = ""
    scheduled_start: str = ""
    begun: Annotated[int, OR_NULL] = seconds_field(None)
    settled: Annotated[int, OR_NULL] = seconds_field(None)


@dataclass(frozen=True, kw_only=True)
class WorkReport:
    """The tasks of a building model, in the order in which they can be done: `WorkTasks.msg`, and `work/tasks` on MQTT."""

    stamp: Annotated[int, SECONDS] = seconds_field()
    model: str
    model_hash: str
    schedule: str
    engaged: bool
    reading: bool = False
    next: str
    reason: str
    tasks: tuple[TaskReport, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class EngagementReport:
    """Where an arm was left engaged: `Engagement.msg`, without the path."""

    plan_id: str
    segment: str
    scenes: tuple[str, ...]
    task: str = ""
    reason: str = ""
    engaged: bool = True


class SwitchState(Enum):
    """States of a switch at the gateway; values are those of `ToolState.msg`."""

    PENDING = -1  # not judged yet: never reported, and no message has this number
    ARMED = 0  # acknowledged; fires when the playout passes its stamp
    FIRED = 1  # the output was changed
    VOID = 2  # did not fire, and will not any more
    REFUSED = 3

    @property
    def word(self) -> str:
        """Name of the state in the gateway's `status`."""
        return self.name.lower()


@dataclass(frozen=True)
class SwitchReport:
    """The gateway's report on one switch."""

    state: SwitchState
    reason: str = ""


@dataclass(frozen=True)
class ToolReport:
    """The tool's state: `ToolState.msg`, whose lists belong together."""

    known: bool = False
    tool: str = ""
    outputs: Mapping[str, bool] = field(default_factory=dict)
    inputs: Mapping[str, bool] = field(default_factory=dict)
    switches: Mapping[str, SwitchReport] = field(default_factory=dict)
    reason: str = NO_REPORT

    def mismatch(self, signals: Iterable[Any]) -> str:
        """Return the first unknown or differing input, as a clause; "": all read as their `Signal`."""
        signals = tuple(signals)
        if not signals:
            return ""
        if not self.known:
            return self.why_unknown()
        for signal in signals:
            if signal.name not in self.inputs:
                return Sentence("the tool {tool} has no input {signal}", tool=repr(self.tool), signal=repr(signal.name))
            if self.inputs[signal.name] is not signal.value:
                return Sentence(
                    "{signal} reads off, not on" if signal.value else "{signal} reads on, not off", signal=signal.name
                )
        return ""

    def why_unknown(self) -> str:
        """Return in a clause why the tool's state is unknown; "" when it is known."""
        return (
            "" if self.known else Sentence("the tool's state is not known: {reason}", reason=self.reason or NO_REPORT)
        )

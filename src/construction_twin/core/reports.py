"""What gate, bridge, tool, executor and work report: one record per message, for every folder that shows or acts on it.

Each field has the name that it has in the ROS message; times are whole ns of ROS time, and lists are tuples in the order of the
message. SI unless a name says otherwise. Records only: what follows from them is decided where it matters. Standard library only.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated, Protocol

from construction_twin.core.records import OR_NULL, SECONDS, as_seconds
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
    """The gate's report: `Sync.msg`.

    Attributes:
        text: State as a word; `state` is its number.
        error, threshold: Length n. [rad], [m] for prismatic joints; empty while nothing is compared.
        round_trip, servo_lag: [s]; nan when unknown.
        violations: How often the gate left IN_SYNC.
        agreed: Twin and arm agree, whatever the state.
        held_stamp: Nominal time of the last setpoint that passed [ns]; 0 for none.
    """

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
    """Why the gate is closed: `Hold.msg`.

    Attributes:
        cause: What closed it, or which pose differed before it opened; empty: it is open, or nothing is known against it.
        since: Since when that is so [ns]; 0 without a cause.
        stamp: Of the report [ns].
    """

    cause: str = ""
    since: int = 0
    stamp: int = 0


@dataclass(frozen=True)
class SpeedReport:
    """The speed limit in force: `SpeedLimitInForce.msg`. Fractions of the planned speed, 0 to 1.

    Attributes:
        limit: The lowest of what a program and people have set.
        by: Whose it is: ``people``, ``program``; empty: nobody limits.
        reason: One sentence.
        people: The one limit of all people, above 0.
        person: Who set it; empty: nobody has yet, or it is not known.
        since: When [ns]; 0: nobody has.
        replaced, replaced_person: What it was before that, and whose; empty: nobody's.
        program: What a program allows, also by its silence.
        program_name: The node that said so last; empty: none was heard.
        stamp: Of the report [ns].
    """

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
    """The bridge's report: `Link.msg`.

    Attributes:
        text: State as a word; `state` is its number.
        gateway_counters: What the gateway counts, and says of its playout and controller.
        responsible: Who has armed a bare PLC; empty otherwise.
        not_checked: What is not checked with a bare PLC, one sentence each.
        gateway_kind: `rsi`, or `plc` for a bare one.
        reply_us_bins, reply_us_counts: Times that the gateway's replies took: upper edges [us], and how many were no longer.
    """

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
    state: int = 0
    stamp: int = 0
    commands_sent: int = 0
    reply_us_bins: tuple[int, ...] = ()
    reply_us_counts: tuple[int, ...] = ()

    @property
    def late(self) -> int | None:
        """How many replies came too late at the controller; None when the gateway has not said anything."""
        # a counter appears with its first use
        return int(self.gateway_counters.get("late_replies", "0")) if self.gateway_counters else None


@dataclass(frozen=True)
class SessionRequest:
    """A person asked for a session with the gateway: `SessionRequest.msg`.

    Attributes:
        verb: `reset` or `arm`.
        person: By MQTT the account; empty: by a service on the robot's computers, which knows no names.
        lifts: Why the link waited for a person, as it was told then.
        stamp: When it was begun [ns].
    """

    verb: str
    person: str
    lifts: str
    stamp: int = 0


@dataclass(frozen=True)
class SpeedChange:
    """A person has set the speed limit of people: `SpeedChange.msg`.

    Attributes:
        limit, before: Fractions of the planned speed: what is set now, and what was set before.
        whose: Who had set what was before; empty: nobody, or it is not known.
        stamp: When it was set [ns].
    """

    person: str
    limit: float
    before: float
    whose: str
    stamp: int = 0


@dataclass(frozen=True)
class ExecutionReport:
    """The executor's report: `Execution.msg`.

    Attributes:
        text: State as a word; `state` is its number.
        plan_id: Of the plan that is played, or of the last one; empty for none.
        outcome: Of the last plan; empty: none has ended.
        plan_start: Nominal time of the plan's first setpoint [ns]; 0 for none.
        duration: Of the plan as planned [s].
        rate, speed_limit: Fraction of the planned speed now, and the fraction that is allowed.
        segment, segment_name: Of a work plan: where it is, from 0; -1 without.
        at_boundary, wants_scene: It stands at the end of that segment; and waits for the scene to change.
        engaged: Only the way back along the executed path can be planned.
        expected_scene: Hash of the scene that is waited for; empty for none.
        approval_obstacle: Why the plan under review could not be approved now; empty: it could, or there is none.
        overridable: Only the rehearsal is against approving it, which a person may override.
        stamp: Of the report [ns].
        moment: The same by the robot's clock (`core.freshness.Moment`).
    """

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
    def ended(self) -> str:
        """Outcome of the last plan; empty while one is under way."""
        return "" if self.playing else self.outcome

    def progress(self, now: float) -> float | None:
        """Return how much of a plan's time is over at `now` [s], 0 to 1; None unless a plan is being played."""
        if self.text != "PLAYING" or not self.plan_start or self.duration <= 0.0:
            return None
        return min(1.0, max(0.0, (now - seconds(self.plan_start)) / self.duration))


@dataclass(frozen=True, kw_only=True)
class TaskReport:
    """One task of a building model: `WorkTask.msg`, one entry of `work/tasks` on MQTT. What has a default may be missing there.

    Attributes:
        id, element: GlobalIds: of the task, and of the element that it places, or that people take down.
        state: As in docs/reference/states.md.
        reason: One sentence: what is waited for, by whom, what to do.
        after: Ids of the tasks that must be done before.
        robot: Which robot does it; empty: any.
        plan_id: Of the plan under review or executed; empty: none.
        deviation_mm, deviation_deg: Of the placed element from the model; nan: not placed.
        mass_kg: Of the element, as it is planned with; nan: nobody says.
        scheduled_duration: [s]; nan: the schedule says nothing.
        tolerance_mm, tolerance_deg: A placed element that deviates by more than one of them counts as off.
        question, answers: What only a person can know, empty: nothing is asked; and what can be answered.
        grip: How the element is or was held; empty: it was not gripped yet.
        scheduled_start: ISO 8601; empty: the schedule says nothing.
        begun, settled: When it was begun, and done or skipped, last; 0: not yet. Whole ns, in JSON [s] and null.
    """

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
    begun: Annotated[int, OR_NULL] = as_seconds(None)
    settled: Annotated[int, OR_NULL] = as_seconds(None)


@dataclass(frozen=True, kw_only=True)
class WorkReport:
    """The tasks of a building model, in the order in which they can be done: `WorkTasks.msg`, and `work/tasks` on MQTT.

    Attributes:
        stamp: ROS time of the change; whole ns, in JSON [s].
        model, model_hash: File name of the model, and the file's SHA-256.
        schedule: `model`, `accepted` (a proposal that a person accepted) or `proposed` (nothing can be planned yet).
        engaged: Only the way back can be planned.
        reading: The model is being read: tasks come when it was.
        next: Id of the task that comes next; empty: none can.
        reason: One sentence: what the work waits for.
        notes: What a person should know of model, schedule and ledger: what was left out, or understood in some way.
    """

    stamp: Annotated[int, SECONDS] = as_seconds()
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
    """Where an arm was left engaged: `Engagement.msg`, without the path.

    Attributes:
        plan_id, task, segment: The work plan that ended inside, its task, and the name of the segment.
        scenes: Hashes of the scenes in which it may go back; they change with the tool's inputs.
        reason: One sentence: why the plan ended.
        engaged: False: it was not left engaged, and the rest is empty.
    """

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
        """As the gateway's `status` has it."""
        return self.name.lower()


@dataclass(frozen=True)
class SwitchReport:
    """What the gateway says of one switch: its state, and one sentence."""

    state: SwitchState
    reason: str = ""


class Reading(Protocol):
    """What an input of the tool must read."""

    @property
    def name(self) -> str:
        """Input of the tool file."""

    @property
    def value(self) -> bool:
        """What it must read."""


@dataclass(frozen=True)
class ToolReport:
    """What is known of the tool: `ToolState.msg`, whose lists belong together.

    Attributes:
        known: Whether the outputs were read back in this controller session: what is told below is true.
        tool: Name of the tool; empty: a tool without hands.
        outputs: As read back from the controller.
        switches: The last switches that were asked for, by id, oldest first.
        reason: Why nothing is known, or what was refused last.
    """

    known: bool = False
    tool: str = ""
    outputs: Mapping[str, bool] = field(default_factory=dict)
    inputs: Mapping[str, bool] = field(default_factory=dict)
    switches: Mapping[str, SwitchReport] = field(default_factory=dict)
    reason: str = NO_REPORT

    def problem(self, signals: Iterable[Reading]) -> str:
        """Return why the inputs are not known to read what these signals say, as a clause; "" when they do, or none are named."""
        signals = tuple(signals)
        if not signals:
            return ""
        if not self.known:
            return self.unknown()
        for signal in signals:
            if signal.name not in self.inputs:
                return Sentence("the tool {tool} has no input {signal}", tool=repr(self.tool), signal=repr(signal.name))
            if self.inputs[signal.name] is not signal.value:
                return Sentence(
                    "{signal} reads off, not on" if signal.value else "{signal} reads on, not off", signal=signal.name
                )
        return ""

    def unknown(self) -> str:
        """Return why nothing is known of the tool, as a clause; "" when it is known."""
        return (
            "" if self.known else Sentence("the tool's state is not known: {reason}", reason=self.reason or NO_REPORT)
        )

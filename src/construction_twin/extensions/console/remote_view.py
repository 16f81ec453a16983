"""`view` on MQTT: the state of twin, arm, gate, link and execution in one message of plain JSON. Pure.

Fixed by `View`, of which pydantic makes the JSON Schema (scripts/schemas.py); a change raises `VERSION`, one that only adds keys
keeps `COMPATIBLE`. SI: m, rad, s; times are numbers of seconds, because stamps in ns are larger than the
whole numbers that JavaScript keeps exactly.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Annotated, Generic, Literal, TypeVar

import pydantic
from pydantic import Field

from construction_twin.core.freshness import Moment
from construction_twin.core.records import SchemaKeywords
from construction_twin.core.reports import ExecutionReport, HoldReport, LinkReport, SpeedReport, SyncReport
from construction_twin.core.sentences import SentenceTemplates, templates_of
from construction_twin.core.units import NANOSECONDS, seconds
from construction_twin.link.requests import Joints, rounded

VERSION = 8
#: The oldest version whose readers can read this one.
COMPATIBLE = 8
#: Decimals of positions [rad], [m] and of times [s].
_POSITION, _TIME = 9, 6
_UNITS = {"angle": "rad", "length": "m", "time": "s"}
#: A number as `status_values` writes it.
_DIGITS = re.compile(r"-?\d{1,9}(?:\.\d{1,9})?")
#: States of the executor in which the plan goes on.
_MOVING = ("PLAYING", "STOPPING", "PAUSING")

# what the schema says of a value besides its type
_Number = Annotated[float, rounded(_POSITION)]
_Count = Annotated[int, Field(ge=0)]
_Seconds = Annotated[float, rounded(_TIME), SchemaKeywords(minimum=0)]
_Report = TypeVar("_Report", SyncReport, LinkReport, ExecutionReport)
_Part = TypeVar("_Part")


@dataclass(frozen=True)
class JointsView:
    """The joints of all lists, base to tip."""

    names: Sequence[str]
    types: Sequence[Literal["revolute", "prismatic"]]


@dataclass(frozen=True)
class PoseView:
    """A pose, positions in rad and m. `stamp` is that of the joint state."""

    stamp: _Seconds
    age: _Seconds
    positions: Sequence[_Number]


@dataclass(frozen=True)
class SyncView:
    """The gate, per joint in rad and m; null after 0.5 s without a report.

    Attributes:
        agreed: Twin and arm agree, whatever the state.
        servo_lag: How long the arm trails its command [s]; null: not known yet.
    """

    state: str
    reason: str
    age: _Seconds
    policy: str
    agreed: bool
    error: Sequence[_Number | None]
    threshold: Sequence[_Number | None]
    servo_lag: _Number | None
    violations: _Count


@dataclass(frozen=True)
class ControllerView:
    """The controller's optional channels: "" and null are not sent; null: none is."""

    mode: str
    program: str
    override_percent: _Number | None


@dataclass(frozen=True)
class LinkView:
    """The bridge's view of broker, gateway and controller; null after 3 s without a report.

    Attributes:
        responsible: Bare mode: the person who armed the PLC.
        round_trip_ms: From a setpoint's passing of the gate to the arm's answer to it.
        late: Replies that came too late at the controller, since the gateway's start.
    """

    state: str
    reason: str
    age: _Seconds
    gateway_state: str
    gateway_kind: str
    responsible: str
    round_trip_ms: _Number | None
    late: _Count | None
    controller: ControllerView | None


@dataclass(frozen=True)
class SegmentNow:
    """The segment of a work plan, from 0; null: none was entered. At its boundary tool and scene change."""

    number: _Count
    name: str
    at_boundary: bool


@dataclass(frozen=True)
class HoldView:
    """Why the gate is closed, since a ROS time [s]; null: it is open, or the cause is unknown."""

    cause: str
    since: _Seconds


@dataclass(frozen=True)
class SpeedView:
    """The speed limit in force, a fraction of the planned speed; null: unknown.

    Attributes:
        by: ``people``, ``program``; empty: nobody limits.
        people: The one limit of all people, which `person` set `since` [s], in place of `replaced`.
    """

    limit: _Number
    by: str
    reason: str
    people: _Number
    person: str
    since: _Seconds
    replaced: _Number
    replaced_person: str


@dataclass(frozen=True)
class ExecutionView:
    """The executor; null while it does not run.

    Attributes:
        plan_id: Of the plan that is played, or of the last one, as `outcome` and `duration` as planned [s].
        progress: How much of its time is over; 1: finished.
        rate: Present fraction of the planned speed, of which `speed_limit` allows one.
    """

    state: str
    reason: str
    age: _Seconds
    plan_id: str
    outcome: str
    duration: _Seconds
    progress: Annotated[_Number, SchemaKeywords(minimum=0, maximum=1)]
    rate: _Number | None
    speed_limit: _Number | None
    segment: SegmentNow | None


@dataclass(frozen=True)
class View:
    """A message on <prefix>/<robot>/view: the state of one robot; docs/reference/mqtt.md says its keys. SI units: m, rad, s.

    null: unknown, or too old. An `age` is at `stamp` of the message, since what it stands beside was received [s]. A reader of
    version n reads what has `compatible` <= n, and ignores keys that it does not know.
    """

    version: Annotated[int, SchemaKeywords(const=VERSION)]
    compatible: Annotated[int, SchemaKeywords(const=COMPATIBLE)]
    robot: str
    online: bool
    run: str
    seq: _Count
    stamp: _Seconds
    moment: Annotated[str, SchemaKeywords(pattern="^([0-9a-f]{8}-[0-9]{1,15})?$")]
    units: Annotated[Mapping[str, str], SchemaKeywords(const=_UNITS)]
    joints: JointsView
    twin: PoseView | None
    arm: PoseView | None
    expected: PoseView | None
    sync: SyncView | None
    link: LinkView | None
    execution: ExecutionView | None
    plan: str
    hold: HoldView | None
    approval_obstacle: str
    speed: SpeedView | None
    overridable: bool
    said: SentenceTemplates


#: Writes them, 25 a second: in a sixth of the time that `core.records` takes.
_VIEWS = pydantic.TypeAdapter(View)


@dataclass(frozen=True)
class FreshReport(Generic[_Report]):
    """A report that is the present, and how long ago it was received [s]."""

    report: _Report
    age: _Number


@dataclass(frozen=True)
class ViewInputs:
    """What a view is made of, `plan` the id of the one under review; None: unknown, or too old."""

    twin: PoseView | None = None
    arm: PoseView | None = None
    sync: FreshReport[SyncReport] | None = None
    link: FreshReport[LinkReport] | None = None
    execution: FreshReport[ExecutionReport] | None = None
    plan: str = ""
    progress: float = 0.0
    hold: HoldReport = HoldReport()
    speed: SpeedReport | None = None
    expected: PoseView | None = None


class ViewWriter:
    """Writes the messages of one run of the program, which `run` names; for one thread."""

    def __init__(self, robot: str, run: str, joints: Joints):
        self._run = run
        self._robot = robot
        self._joints = JointsView(joints.names, ["prismatic" if linear else "revolute" for linear in joints.linear])
        self._seq = 0

    def write(self, now: int, inputs: ViewInputs, moment: Moment) -> bytes:
        """Return the next message at the ROS time `now` [ns], with the moment that a screen's requests repeat."""
        self._seq += 1
        return self._message(True, self._seq, now, inputs, str(moment))

    def offline(self) -> bytes:
        """Return the last will, also a run's last message: all is unknown. Its `seq` and `stamp` are 0, its `moment` is ""."""
        return self._message(False, 0, 0, ViewInputs(), "")

    def _message(self, online: bool, seq: int, now: int, inputs: ViewInputs, moment: str) -> bytes:
        progress, segment = inputs.progress, _segment(inputs.execution)
        reports = [each.report for each in (inputs.sync, inputs.link, inputs.execution) if each is not None]
        execution = inputs.execution.report if inputs.execution is not None and inputs.plan else ExecutionReport("", "")
        view = View(
            version=VERSION,
            compatible=COMPATIBLE,
            robot=self._robot,
            online=online,
            run=self._run,
            seq=seq,
            stamp=round(now / NANOSECONDS, _TIME),
            moment=moment,
            units=_UNITS,
            joints=self._joints,
            twin=inputs.twin,
            arm=inputs.arm,
            expected=inputs.expected,
            sync=_part(SyncView, inputs.sync),
            link=_part(
                LinkView, inputs.link, round_trip_ms=_round_trip_ms(inputs.sync), controller=_controller(inputs.link)
            ),
            execution=_part(ExecutionView, inputs.execution, progress=progress, segment=segment),
            plan=inputs.plan,
            hold=HoldView(inputs.hold.cause, round(seconds(inputs.hold.since), _TIME)) if inputs.hold.cause else None,
            approval_obstacle=execution.approval_obstacle,
            overridable=execution.overridable,
            speed=_speed(inputs.speed),
            said=templates_of(
                [each.reason for each in reports], inputs.hold.cause, execution.approval_obstacle, inputs.speed
            ),
        )
        return _VIEWS.dump_json(view)


def _part(kind: type[_Part], shown: FreshReport | None, **known: object) -> _Part | None:
    """Return what a view shows of a report: its fields of the same names, where they are not `known` otherwise."""
    if shown is None:
        return None
    report, values = shown.report, {"state": shown.report.text, "age": shown.age, **known}
    names = [each.name for each in fields(kind)]  # type: ignore[arg-type]  # a part is a record
    return kind(**{name: values[name] if name in values else getattr(report, name) for name in names})


def _speed(report: SpeedReport | None) -> SpeedView | None:
    if report is None:
        return None
    since, replaced = round(seconds(report.since), _TIME), (report.replaced, report.replaced_person)
    return SpeedView(report.limit, report.by, report.reason, report.people, report.person, since, *replaced)


def _round_trip_ms(sync: FreshReport[SyncReport] | None) -> float:
    # from a setpoint's passing of the gate to the arm's answer to it: the gate measures it, and it says how the link is
    return sync.report.round_trip * 1e3 if sync is not None else math.nan


def _controller(shown: FreshReport[LinkReport] | None) -> ControllerView | None:
    counters = shown.report.gateway_counters if shown is not None else {}
    mode, program, override = (
        counters.get(f"controller_{name}", "") for name in ("mode", "program", "override_percent")
    )
    # the gateway has sent a number, and the bridge has checked that it is a number or a text
    percent = float(override) if _DIGITS.fullmatch(override) else None
    return ControllerView(mode, program, percent) if mode or program or percent is not None else None


def _segment(shown: FreshReport[ExecutionReport] | None) -> SegmentNow | None:
    if shown is None or shown.report.segment < 0:
        return None
    report = shown.report
    return SegmentNow(report.segment, report.segment_name, report.at_boundary)


class PlanProgress:
    """How much of a plan's time is over, from the executor's reports, which come when the rate changes: evenly between two."""

    def __init__(self):
        self._last: ExecutionReport | None = None
        self._elapsed = 0.0

    def on_report(self, report: ExecutionReport) -> None:
        """Add a report of the executor."""
        last = self._last
        self._last = report
        if last is None or (last.plan_id, last.plan_start) != (report.plan_id, report.plan_start):
            # it begins before it is reported, or was being played when this program started
            begun = seconds(report.stamp) - seconds(report.plan_start)
            self._elapsed = max(0.0, begun) * report.rate if report.plan_start else 0.0
        elif last.text in _MOVING:
            passed = seconds(report.stamp) - seconds(last.stamp)
            self._elapsed += max(0.0, passed) * (last.rate + report.rate) / 2.0

    def at(self, now: float) -> float:
        """Return the fraction at `now` [s]: 0 before a first plan, 1 once it has finished."""
        last = self._last
        if last is None or not last.plan_start or last.duration <= 0.0:
            return 0.0
        if last.outcome == "finished" and last.text not in _MOVING:
            return 1.0
        moved = max(0.0, now - seconds(last.stamp)) * last.rate if last.text in _MOVING else 0.0
        # what is still moving has not arrived
        return min(0.999, max(0.0, (self._elapsed + moved) / last.duration))

"""`view` on MQTT: the state of twin, arm, gate, link and execution in one message of plain JSON. Pure; standard library only.

Fixed by docs/reference/view.schema.json; a change that a reader could notice raises `VERSION`. Versions that only add keys keep
`COMPATIBLE`: a reader of that version goes on reading, if it leaves alone what it does not know. SI: m, rad, s; times are numbers
of seconds, because stamps in ns are larger than the whole numbers that JavaScript keeps exactly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

from construction_twin.core.freshness import Moment
from construction_twin.core.records import decimals, dumped
from construction_twin.core.reports import ExecutionReport, LinkReport, SyncReport
from construction_twin.core.units import NANOSECONDS, seconds
from construction_twin.link.remote_trajectory import Joints

VERSION = 3
#: The oldest version whose readers can read this one.
COMPATIBLE = 1
#: Decimals of positions [rad], [m] and of times [s].
_POSITION, _TIME = 9, 6
_UNITS = {"angle": "rad", "length": "m", "time": "s"}
#: States of the executor in which the plan goes on.
_MOVING = ("PLAYING", "STOPPING", "PAUSING")
#: What a view shows of each report, after its state, reason and age.
_SYNC = ("policy", "agreed", "error", "threshold", "servo_lag", "violations")
_LINK = ("gateway_state", "gateway_kind", "responsible", "round_trip_ms", "late")
_EXECUTION = ("plan_id", "outcome", "duration", "progress", "rate", "speed_limit", "segment")


_Report = TypeVar("_Report", SyncReport, LinkReport, ExecutionReport)


@dataclass(frozen=True)
class PoseView:
    """A pose: its stamp in ROS time, its age since reception [s], positions [rad] or [m]."""

    stamp: float = decimals(_TIME)
    age: float = decimals(_TIME)
    positions: Sequence[float] = decimals(_POSITION)


@dataclass(frozen=True)
class SegmentNow:
    """Where a work plan is: the segment's number from 0, its name, and whether the arm stands at its end."""

    number: int
    name: str
    at_boundary: bool


@dataclass(frozen=True)
class ClosestView:
    """Which two bodies are closest at the twin's pose: distance [m], where on the first of them in the base_link [m], age [s]."""

    distance: float
    between: Sequence[str]
    point: Sequence[float]
    age: float


@dataclass(frozen=True)
class Shown(Generic[_Report]):
    """A report that is the present, and how long ago it was received [s]."""

    report: _Report
    age: float


@dataclass(frozen=True)
class Seen:
    """The parts of a view; None is what is not known, or too old to be shown as the present. `plan` is the id of the plan under
    review, "" for none; `progress` how much of the executor's plan is over, 0 to 1.
    """

    twin: PoseView | None = None
    arm: PoseView | None = None
    sync: Shown[SyncReport] | None = None
    link: Shown[LinkReport] | None = None
    execution: Shown[ExecutionReport] | None = None
    plan: str = ""
    closest: ClosestView | None = None
    progress: float = 0.0


class ViewWriter:
    """Writes the messages of one run of the program; not for use from several threads.

    Args:
        run: Random id of this run: `seq` begins again with another one.
    """

    def __init__(self, robot: str, run: str, joints: Joints):
        self._run = run
        self._robot = robot
        kinds = ["prismatic" if linear else "revolute" for linear in joints.linear]
        self._joints = {"names": list(joints.names), "types": kinds}
        self._seq = 0

    def write(self, now: int, seen: Seen, moment: Moment) -> bytes:
        """Return the next message.

        Args:
            now: ROS time [ns].
            moment: The present one, for the requests of whoever sees this.
        """
        self._seq += 1
        return self._message(True, self._seq, now, seen, str(moment))

    def offline(self) -> bytes:
        """Return the last will, and the farewell: nothing more is known. Its `seq` and `stamp` are 0, its `moment` is ""."""
        return self._message(False, 0, 0, Seen(), "")

    def _message(self, online: bool, seq: int, now: int, seen: Seen, moment: str) -> bytes:
        message = {
            "version": VERSION,
            "compatible": COMPATIBLE,
            "robot": self._robot,
            "online": online,
            "run": self._run,
            "seq": seq,
            "stamp": round(now / NANOSECONDS, _TIME),
            "moment": moment,
            "units": _UNITS,
            "joints": self._joints,
            "twin": seen.twin,
            "arm": seen.arm,
            "sync": _part(seen.sync, _SYNC),
            "link": _part(seen.link, _LINK, round_trip_ms=_round_trip_ms(seen.sync)),
            "execution": _part(seen.execution, _EXECUTION, progress=seen.progress, segment=_segment(seen.execution)),
            "plan": seen.plan,
            "closest": seen.closest,
        }
        return dumped(message, _POSITION)


def _part(shown: Shown | None, names: Sequence[str], **known: object) -> Mapping | None:
    """Return what a view shows of a report: fields of these names, of the report itself where they are not `known` otherwise."""
    if shown is None:
        return None
    report = shown.report
    first = {"state": report.text, "reason": report.reason, "age": shown.age}
    return first | {name: known[name] if name in known else getattr(report, name) for name in names}


def _round_trip_ms(sync: Shown[SyncReport] | None) -> float:
    # from a setpoint's passing of the gate to the arm's answer to it: the gate measures it, and it says how the link is
    return sync.report.round_trip * 1e3 if sync is not None else math.nan


def _segment(shown: Shown[ExecutionReport] | None) -> SegmentNow | None:
    if shown is None or shown.report.segment < 0:
        return None
    report = shown.report
    return SegmentNow(report.segment, report.segment_name, report.at_boundary)


class PlanProgress:
    """How much of a plan's time is over, from the executor's reports, which tell the rate only when it changes.

    Between two reports the rate is taken to change evenly. So during a ramp this is off by a part of the ramp's length, and exact
    where the plan is played as planned.
    """

    def __init__(self):
        self._last: ExecutionReport | None = None
        self._elapsed = 0.0

    def on_report(self, report: ExecutionReport) -> None:
        """Take a report; of one plan they come in their order."""
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

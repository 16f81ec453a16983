"""`view` on MQTT: the state of twin, arm, gate, link and execution in one message of plain JSON. Pure; standard library only.

Fixed by docs/reference/view.schema.json; a change that a reader could notice raises `VERSION`. Versions that only add keys keep
`COMPATIBLE`: a reader of that version goes on reading, if it leaves alone what it does not know. SI: m, rad, s; times are numbers
of seconds, because stamps in ns are larger than the whole numbers that JavaScript keeps exactly.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from construction_twin.core.freshness import Moment
from construction_twin.core.units import NANOSECONDS
from construction_twin.link.remote_trajectory import Joints

VERSION = 3
#: The oldest version whose readers can read this one.
COMPATIBLE = 1
#: Decimals of positions [rad], [m] and of times [s].
_POSITION, _TIME = 9, 6
_UNITS = {"angle": "rad", "length": "m", "time": "s"}
#: States of the executor in which the plan goes on.
_MOVING = ("PLAYING", "STOPPING", "PAUSING")


@dataclass(frozen=True)
class PoseView:
    """A pose: its stamp in ROS time, its age since reception [s], positions [rad] or [m]."""

    stamp: float
    age: float
    positions: Sequence[float]


@dataclass(frozen=True)
class SyncView:
    """What the gate says; see Sync.msg."""

    state: str
    reason: str
    age: float
    policy: str
    agreed: bool
    error: Sequence[float]
    threshold: Sequence[float]
    servo_lag: float
    violations: int


@dataclass(frozen=True)
class LinkView:
    """What the bridge says; see Link.msg.

    `round_trip_ms` is the time from a setpoint's passing of the gate to the arm's answer to it, nan when unknown; `late` is how
    many replies came too late at the controller, None when the gateway has not said.
    """

    state: str
    reason: str
    age: float
    gateway_state: str
    gateway_kind: str
    responsible: str
    round_trip_ms: float = math.nan
    late: int | None = None


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
class ExecutionView:
    """What the executor says; see Execution.msg. `age` is that of its last change, `progress` a fraction of the plan's time."""

    state: str
    reason: str
    age: float
    plan_id: str
    outcome: str
    duration: float
    progress: float
    rate: float
    speed_limit: float
    segment: SegmentNow | None = None


@dataclass(frozen=True)
class Seen:
    """The parts of a view; None is what is not known, or too old to be shown as the present. `plan` is the id of the plan under
    review, "" for none.
    """

    twin: PoseView | None = None
    arm: PoseView | None = None
    sync: SyncView | None = None
    link: LinkView | None = None
    execution: ExecutionView | None = None
    plan: str = ""
    closest: ClosestView | None = None


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
        document = {
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
            "twin": _pose(seen.twin),
            "arm": _pose(seen.arm),
            "sync": _part(seen.sync),
            "link": _part(seen.link),
            "execution": _part(seen.execution),
            "plan": seen.plan,
            "closest": _part(seen.closest),
        }
        # nan and inf are no JSON
        return json.dumps(document, allow_nan=False, separators=(",", ":")).encode()


def _pose(pose: PoseView | None) -> Mapping | None:
    if pose is None:
        return None
    positions = [round(value, _POSITION) for value in pose.positions]
    return {"stamp": round(pose.stamp, _TIME), "age": round(pose.age, _TIME), "positions": positions}


def _part(part: SyncView | LinkView | ExecutionView | SegmentNow | ClosestView | None) -> Mapping | None:
    return None if part is None else {key: _plain(value) for key, value in vars(part).items()}


def _plain(value: object) -> object:
    if isinstance(value, float):
        return round(value, _POSITION) if math.isfinite(value) else None
    if isinstance(value, SegmentNow):
        return _part(value)
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value


@dataclass(frozen=True)
class Report:
    """What counts of an Execution.msg for the progress; times in ROS time [s].

    Attributes:
        stamp, start: Of the report; nominal time of the plan's first setpoint, 0 for none.
        duration, rate: Of the plan [s]; fraction of the planned speed.
    """

    stamp: float
    start: float
    state: str
    plan_id: str
    outcome: str
    duration: float
    rate: float


class PlanProgress:
    """How much of a plan's time is over, from the executor's reports, which tell the rate only when it changes.

    Between two reports the rate is taken to change evenly. So during a ramp this is off by a part of the ramp's length, and exact
    where the plan is played as planned.
    """

    def __init__(self):
        self._last: Report | None = None
        self._elapsed = 0.0

    def on_report(self, report: Report) -> None:
        """Take a report; of one plan they come in their order."""
        last = self._last
        self._last = report
        if last is None or (last.plan_id, last.start) != (report.plan_id, report.start):
            # it begins before it is reported, or was being played when this program started
            self._elapsed = max(0.0, report.stamp - report.start) * report.rate if report.start else 0.0
        elif last.state in _MOVING:
            self._elapsed += max(0.0, report.stamp - last.stamp) * (last.rate + report.rate) / 2.0

    def at(self, now: float) -> float:
        """Return the fraction at `now` [s]: 0 before a first plan, 1 once it has finished."""
        last = self._last
        if last is None or not last.start or last.duration <= 0.0:
            return 0.0
        if last.outcome == "finished" and last.state not in _MOVING:
            return 1.0
        moved = max(0.0, now - last.stamp) * last.rate if last.state in _MOVING else 0.0
        # what is still moving has not arrived
        return min(0.999, max(0.0, (self._elapsed + moved) / last.duration))

"""The report of a rehearsal, for message, file, screen and terminal, and its objection to an approval. SI.

Fields have the names, and the meaning, that they have in `Rehearsal.msg`. Joints in the order of the trajectory's `joint_names`.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Annotated

from construction_twin.core.records import OR_NULL, SECONDS, json_value, seconds_field
from construction_twin.core.sentences import Sentence
from construction_twin.review.plan_under_review import NOT_REHEARSED, Rehearsed
from construction_twin.robot.plan import Plan

#: A number that may be nan, which JSON has as null.
_OrNan = Annotated[float, OR_NULL]
#: How a rehearsal ended.
PASSED, FAILED, BROKEN = "passed", "failed", "broken"
STATES = (PASSED, FAILED, BROKEN)


@dataclass(frozen=True)
class AxisLoad:
    """A plan's load on one axis."""

    joint: str
    peak: float
    time: float
    rms: float
    gravity: float
    limit: float
    estimated: bool

    @property
    def usage(self) -> float:
        """Fraction of the limit that is used; 0 without one."""
        return self.peak / self.limit if self.limit else 0.0


@dataclass(frozen=True)
class RehearsedContact:
    """A contact of two bodies that the plan excludes."""

    first: str
    second: str
    time: float
    point: tuple[float, float, float]
    force: float
    seconds: float


@dataclass(frozen=True)
class LooseObject:
    """The motion of a loose object: one released by the plan, or one that stands around."""

    name: str
    released: _OrNan
    moved: float
    turned: float
    fell: float
    resting: bool


@dataclass(frozen=True)
class PayloadLoad:
    """The flange's load beside the arm's rating. Each number is the largest of the plan's loads."""

    mass: float = 0.0
    estimated: bool = False
    across: float = 0.0
    along: float = 0.0
    inertia: float = 0.0
    rated_mass: float = 0.0
    rated_inertia: float = 0.0
    rated_across: float = 0.0
    rated_along: float = 0.0


@dataclass(frozen=True)
class GripLoad:
    """The largest load of the tool's cups, beside their capacity."""

    name: str = ""
    cups: int = 0
    time: float = 0.0
    usage: float = 0.0


@dataclass(frozen=True)
class Braking:
    """A stop at the worst moment of the plan: at its largest kinetic energy."""

    time: float = 0.0
    seconds: float = 0.0
    distance: float = 0.0
    joint: str = ""
    angle: float = 0.0
    usage: float = 0.0


@dataclass(frozen=True)
class RehearsalReport:
    """The result of one rehearsal: `Rehearsal.msg`; `state` is `PASSED`, `FAILED` or `BROKEN`."""

    plan_id: str = ""
    plan_hash: str = ""
    scene: str = ""
    tool: str = ""
    inputs: str = ""
    state: str = BROKEN
    reasons: tuple[str, ...] = ()
    axes: tuple[AxisLoad, ...] = ()
    payload: PayloadLoad = PayloadLoad()
    tracking: _OrNan = math.nan
    tracking_joint: str = ""
    braking: Braking = Braking()
    worst_time: float = 0.0
    worst_pose: tuple[float, ...] = ()
    contacts: tuple[RehearsedContact, ...] = ()
    objects: tuple[LooseObject, ...] = ()
    grip: GripLoad = GripLoad()
    energy: _OrNan = math.nan
    duration: float = 0.0
    took: float = 0.0
    settle_took: float = 0.0
    engine: str = ""
    remarks: tuple[str, ...] = ()
    hash: str = ""
    stamp: Annotated[int, SECONDS] = seconds_field()


def is_consistent(report: RehearsalReport) -> bool:
    """Return whether a received report has a known state, no reasons where it passed, and the hash of its content."""
    if report.state not in STATES or (report.state == PASSED and report.reasons):
        return False
    return with_hash(report, report.took).hash == report.hash


def has_finite_numbers(report: RehearsalReport) -> bool:
    """Return whether all numbers of a report but `released` are finite."""
    return all(map(math.isfinite, _numbers(report)))


def _numbers(value: object) -> Iterator[float]:
    if is_dataclass(value):
        for each in fields(value):
            if each.name != "released":
                yield from _numbers(getattr(value, each.name))
    elif isinstance(value, tuple):
        for part in value:
            yield from _numbers(part)
    elif isinstance(value, float):
        yield value


def with_hash(report: RehearsalReport, took: float) -> RehearsalReport:
    """Return a report with its hash and the time it took [s]."""
    content = json_value(replace(report, took=0.0, settle_took=0.0, hash="", stamp=0))
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    return replace(report, took=took, hash=digest)


#: Results that are kept: of the plan under review, and of those that come before it is offered.
_KEPT = 4


class RehearsalCheck:
    """Keeps results of rehearsals; `tool`: hash of the tool file that counts, empty for no tool."""

    def __init__(self, required: bool = False, tool: str = ""):
        self.required = required
        self._tool = tool
        self._reports: dict[str, RehearsalReport] = {}

    def on_report(self, report: RehearsalReport) -> None:
        """Store a result, the newest of each plan."""
        self._reports.pop(report.plan_id, None)
        self._reports[report.plan_id] = report
        while len(self._reports) > _KEPT:
            del self._reports[next(iter(self._reports))]

    def report_of(self, plan: Plan) -> RehearsalReport | None:
        """Return the result for exactly this plan, its first scene and the tool; None: there is none."""
        report = self._reports.get(plan.id)
        if report is None or (report.plan_hash, report.scene, report.tool) != (plan.hash, plan.scene, self._tool):
            return None
        return report

    def lacks_result(self, plan: Plan) -> bool:
        """Return whether a required result is missing."""
        return self.required and self.report_of(plan) is None

    def obstacle(self, plan: Plan) -> str:
        """Return the rehearsal's objection to an approval as one sentence; empty for none."""
        if not self.required:
            return ""
        report = self.report_of(plan)
        if report is None:
            return Sentence("plan {plan} was not rehearsed yet, and it must be", plan=plan.id)
        if report.state == PASSED:
            return ""
        return Sentence(
            "plan {plan} has failed its rehearsal: {reason}"
            if report.state == FAILED
            else "plan {plan} could not be rehearsed: {reason}",
            plan=plan.id,
            reason=first_reason(report.reasons),
        )

    def rehearsed(self, plan: Plan, overridden: bool) -> Rehearsed | None:
        """Return the rehearsal for the record of a verdict; None: neither made nor required."""
        report = self.report_of(plan)
        if report is not None:
            return Rehearsed(report.state, report.hash, report.engine, overridden)
        return Rehearsed(NOT_REHEARSED, "", overridden=overridden) if self.required else None


def first_reason(reasons: tuple[str, ...]) -> str:
    """Return the first reason, and how many more there are; empty for none."""
    first, more = reasons[0] if reasons else "", len(reasons) - 1
    return Sentence("{first}; and {count} more", first=first, count=more) if more > 0 else first

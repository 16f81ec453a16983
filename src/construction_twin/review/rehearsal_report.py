"""What a rehearsal has found: one record for message, file, screen and terminal; and what it has against an approval. SI.

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
    """What a plan asks of one axis."""

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
    """Two bodies that touched although the plan has no contact of them."""

    first: str
    second: str
    time: float
    point: tuple[float, float, float]
    force: float
    seconds: float


@dataclass(frozen=True)
class LooseObject:
    """What became of an object that can be moved: one that the plan lets go of, or one that stands around."""

    name: str
    released: _OrNan
    moved: float
    turned: float
    fell: float
    resting: bool


@dataclass(frozen=True)
class PayloadLoad:
    """What the flange carries, beside what the arm is rated for. Each number is the largest of the plan's loads."""

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
    """What the tool's cups had to hold at the worst moment, beside what they can."""

    name: str = ""
    cups: int = 0
    time: float = 0.0
    usage: float = 0.0


@dataclass(frozen=True)
class Braking:
    """How far the arm goes on when it has to stop at the worst moment of the plan: at its largest kinetic energy."""

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


def is_whole(report: RehearsalReport) -> bool:
    """Return whether a report that came from elsewhere is what its hash says."""
    if report.state not in STATES or (report.state == PASSED and report.reasons):
        return False
    return with_hash(report, report.took).hash == report.hash


def has_finite_numbers(report: RehearsalReport) -> bool:
    """Return whether no number of a rehearsal that has ended is nan or infinite; `released` is nan of what was never held."""
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
        """Take a result; of one plan the newest counts."""
        self._reports.pop(report.plan_id, None)
        self._reports[report.plan_id] = report
        while len(self._reports) > _KEPT:
            del self._reports[next(iter(self._reports))]

    def report_of(self, plan: Plan) -> RehearsalReport | None:
        """Return the result that is of exactly this plan, in the scene that it begins in, with the tool; None: there is none."""
        report = self._reports.get(plan.id)
        if report is None or (report.plan_hash, report.scene, report.tool) != (plan.hash, plan.scene, self._tool):
            return None
        return report

    def awaits(self, plan: Plan) -> bool:
        """Return whether a result must come before a plan can be approved."""
        return self.required and self.report_of(plan) is None

    def obstacle(self, plan: Plan) -> str:
        """Return why a plan must not be approved, as one sentence; empty: nothing is against it."""
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
        """Return what the record of a verdict on a plan says of its rehearsal; None: there was none, and none was required."""
        report = self.report_of(plan)
        if report is not None:
            return Rehearsed(report.state, report.hash, report.engine, overridden)
        return Rehearsed(NOT_REHEARSED, "", overridden=overridden) if self.required else None


def first_reason(reasons: tuple[str, ...]) -> str:
    """Return the first reason, and how many more there are; empty for none."""
    first, more = reasons[0] if reasons else "", len(reasons) - 1
    return Sentence("{first}; and {count} more", first=first, count=more) if more > 0 else first

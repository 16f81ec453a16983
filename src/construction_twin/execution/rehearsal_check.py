"""What the executor knows of the rehearsals of its plans, and whether a plan may be approved by it."""

from __future__ import annotations

from construction_twin.core.sentences import Sentence
from construction_twin.review.plan_under_review import NOT_REHEARSED, Rehearsed
from construction_twin.review.rehearsal_report import FAILED, PASSED, RehearsalReport
from construction_twin.robot.plan import Plan

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

    def of(self, plan: Plan) -> RehearsalReport | None:
        """Return the result that is of exactly this plan, in the scene that it begins in, with the tool; None: there is none."""
        report = self._reports.get(plan.id)
        if report is None or (report.plan_hash, report.scene, report.tool) != (plan.hash, plan.scene, self._tool):
            return None
        return report

    def awaits(self, plan: Plan) -> bool:
        """Return whether a result must come before a plan can be approved."""
        return self.required and self.of(plan) is None

    def problem(self, plan: Plan) -> str:
        """Return why a plan must not be approved, as one sentence; empty: nothing is against it."""
        if not self.required:
            return ""
        report = self.of(plan)
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

    def on_record(self, plan: Plan, overridden: bool) -> Rehearsed | None:
        """Return what the record of a verdict on a plan says of its rehearsal; None: there was none, and none was required."""
        report = self.of(plan)
        if report is not None:
            return Rehearsed(report.state, report.hash, report.engine, overridden)
        return Rehearsed(NOT_REHEARSED, "", overridden=overridden) if self.required else None


def first_reason(reasons: tuple[str, ...]) -> str:
    """Return the first reason, and how many more there are; empty for none."""
    first, more = reasons[0] if reasons else "", len(reasons) - 1
    return Sentence("{first}; and {count} more", first=first, count=more) if more > 0 else first

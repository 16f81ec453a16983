"""A rehearsal that is required: what cannot be approved without it, who may override it, and what the record says."""

from __future__ import annotations

from dataclasses import replace

import pytest
from executor_bench import SCENE, Bench, make_plan

from construction_twin.core.errors import ReviewError
from construction_twin.core.sentences import Sentence
from construction_twin.execution.approval import AUTO_APPROVE
from construction_twin.execution.executor import ExecutorState
from construction_twin.monitor.states import SyncState
from construction_twin.review.plan_under_review import NOT_REHEARSED, Rehearsed
from construction_twin.review.rehearsal_report import BROKEN, FAILED, PASSED, RehearsalCheck, RehearsalReport

#: What simulated.
ENGINE = "MuJoCo 4.0.0"
WHY = "the flange carries 240.0 kg; the arm is rated for 120.0 kg"


def report_of(plan, state=PASSED, **changes) -> RehearsalReport:
    reasons = () if state == PASSED else (WHY,)
    return replace(
        RehearsalReport(plan.id, plan.hash, plan.scene, "t", "i", state, reasons, engine=ENGINE, hash="f00d"), **changes
    )


@pytest.fixture
def bench() -> Bench:
    bench = Bench()
    bench.approval.rehearsal = RehearsalCheck(required=True, tool="t")
    return bench.ready()


def offered(bench, report=None):
    plan = make_plan()
    bench.executor.offer(plan)
    if report is not None:
        bench.approval.rehearsal.on_report(report(plan))
    return plan


def override(bench, plan, reason="seen by the crane's driver", seen="f00d"):
    return bench.approval.review(plan.id, plan.hash, True, "Ada", reason, override=seen)


class TestRequired:
    def test_a_plan_that_has_passed_is_approved_and_the_record_says_by_which_rehearsal(self, bench):
        plan = offered(bench, report_of)
        bench.review(plan.id, plan.hash, True, "Ada")
        assert bench.state is ExecutorState.PLAYING
        assert bench.records[0].rehearsal == Rehearsed(PASSED, "f00d", ENGINE)

    @pytest.mark.parametrize(
        "report, words",
        [
            (None, "was not rehearsed yet"),
            (lambda plan: report_of(plan, FAILED), "has failed its rehearsal"),
            (lambda plan: report_of(plan, BROKEN), "could not be rehearsed"),
            (lambda plan: report_of(plan, plan_hash="0" * 64), "was not rehearsed yet"),
            (lambda plan: report_of(plan, scene="another"), "was not rehearsed yet"),
            (lambda plan: report_of(plan, tool="another"), "was not rehearsed yet"),
            (lambda plan: report_of(plan, plan_id="another"), "was not rehearsed yet"),
        ],
    )
    def test_nothing_else_is_approved_and_the_refusal_is_on_record(self, bench, report, words):
        plan = offered(bench, report)
        bench.approval.update_obstacle()
        obstacle = bench.approval.obstacle
        assert isinstance(obstacle, Sentence) and words in obstacle and bench.approval.overridable
        bench.executor.on_sync(SyncState.HOLDING, True)
        bench.approval.update_obstacle()
        assert bench.approval.obstacle != obstacle and not bench.approval.overridable
        bench.executor.on_sync(SyncState.IN_SYNC, True)
        with pytest.raises(ReviewError, match=words):
            bench.review(plan.id, plan.hash, True, "Ada")
        assert bench.state is ExecutorState.IDLE and bench.executor.under_review.plan is plan
        assert [(record.verdict, record.rehearsal.overridden) for record in bench.records] == [("refused", False)]

    def test_the_newest_result_of_a_plan_counts(self, bench):
        plan = offered(bench, report_of)
        bench.approval.rehearsal.on_report(report_of(plan, FAILED))
        with pytest.raises(ReviewError, match=f"has failed its rehearsal: {WHY}"):
            bench.review(plan.id, plan.hash, True, "Ada")

    def test_one_that_fails_while_its_approval_is_written_down_starts_nothing(self, bench):
        plan = offered(bench, report_of)

        def disk(record):
            bench.records.append(record)
            bench.approval.rehearsal.on_report(report_of(plan, FAILED))

        bench.record = disk
        with pytest.raises(ReviewError, match=f"has failed its rehearsal: {WHY}"):
            bench.review(plan.id, plan.hash, True, "Ada")
        assert bench.state is ExecutorState.IDLE

    def test_a_rejection_needs_none(self, bench):
        plan = offered(bench)
        bench.review(plan.id, plan.hash, False, "Ada")
        assert bench.executor.under_review.plan is None

    def test_results_of_other_plans_are_forgotten_only_behind_the_newest(self, bench):
        plan = offered(bench, report_of)
        for number in range(3):
            bench.approval.rehearsal.on_report(report_of(make_plan(f"q{number}")))
        assert bench.approval.rehearsal.report_of(plan) is not None
        bench.approval.rehearsal.on_report(report_of(make_plan("q4")))
        assert bench.approval.rehearsal.report_of(plan) is None

    def test_what_needs_no_person_waits_for_it_and_is_withdrawn_when_it_fails(self, bench):
        plan = offered(bench)
        assert bench.approval.approve_automatically(bench.stamp) is None
        assert bench.executor.under_review.plan is plan
        bench.approval.rehearsal.on_report(report_of(plan, FAILED))
        assert bench.approval.approve_automatically(bench.stamp) is None
        assert bench.executor.under_review.plan is None and bench.state is ExecutorState.IDLE
        passed = make_plan("q")
        bench.executor.offer(passed)
        bench.approval.rehearsal.on_report(report_of(passed))
        taken = bench.approval.approve_automatically(bench.stamp)
        assert taken is not None and taken.reviewer == AUTO_APPROVE


class TestOverride:
    @pytest.mark.parametrize("state", [FAILED, BROKEN])
    def test_by_name_and_with_a_reason_it_starts_and_is_on_record(self, bench, state):
        plan = offered(bench, lambda plan: report_of(plan, state))
        override(bench, plan)
        assert bench.state is ExecutorState.PLAYING
        assert (bench.records[0].reviewer, bench.records[0].rehearsal) == (
            "Ada",
            Rehearsed(state, "f00d", ENGINE, True),
        )

    def test_also_without_any_result(self, bench):
        override(bench, offered(bench), seen="")
        assert bench.records[0].rehearsal == Rehearsed(NOT_REHEARSED, "", overridden=True)

    @pytest.mark.parametrize("seen", ["", "0ld", "f00", "f00d "])
    def test_not_where_another_result_was_seen(self, bench, seen):
        plan = offered(bench, lambda plan: report_of(plan, FAILED))
        with pytest.raises(ReviewError, match="something else than was seen:") as caught:
            override(bench, plan, seen=seen)
        assert str(WHY) in str(caught.value)
        assert bench.state is ExecutorState.IDLE and bench.executor.under_review.plan is plan
        assert [(one.verdict, one.rehearsal) for one in bench.records] == [
            ("refused", Rehearsed(FAILED, "f00d", ENGINE))
        ]

    def test_not_by_a_result_that_counts_no_more(self, bench):
        plan = offered(bench, lambda plan: report_of(plan, FAILED, scene="another"))
        with pytest.raises(ReviewError, match="something else than was seen:"):
            override(bench, plan)
        assert bench.state is ExecutorState.IDLE

    @pytest.mark.parametrize("before, seen", [(None, ""), (lambda plan: report_of(plan, BROKEN), "f00d")])
    @pytest.mark.parametrize(
        "state, words",
        [
            (FAILED, "something else than was seen"),
            (BROKEN, "something else than was seen"),
            (PASSED, "nothing to override"),
        ],
    )
    def test_what_comes_while_it_is_written_down_is_not_overridden(self, bench, before, seen, state, words):
        plan = offered(bench, before)

        def disk(record):
            bench.records.append(record)
            bench.approval.rehearsal.on_report(report_of(plan, state, hash="2nd"))

        bench.record = disk
        with pytest.raises(ReviewError, match=words):
            override(bench, plan, seen=seen)
        assert bench.state is ExecutorState.IDLE and bench.executor.under_review.plan is plan
        approved, ending = bench.records
        assert (approved.rehearsal.hash, approved.rehearsal.overridden, ending.outcome) == (seen, True, "dropped")

    def test_not_without_the_plans_hash(self, bench):
        plan = offered(bench, lambda plan: report_of(plan, FAILED))
        with pytest.raises(ReviewError, match="name the plan's hash"):
            bench.approval.review(plan.id, "", True, "Ada", "because", override="f00d")
        assert bench.state is ExecutorState.IDLE

    @pytest.mark.parametrize("reason", ["", "  "])
    def test_not_without_a_reason(self, bench, reason):
        plan = offered(bench, lambda plan: report_of(plan, FAILED))
        with pytest.raises(ReviewError, match="say why"):
            override(bench, plan, reason)
        assert bench.state is ExecutorState.IDLE

    def test_not_where_there_is_nothing_to_override(self, bench):
        plan = offered(bench, report_of)
        with pytest.raises(ReviewError, match="nothing to override"):
            override(bench, plan)
        assert bench.state is ExecutorState.IDLE

    def test_it_overrides_nothing_else(self, bench):
        plan = offered(bench)
        bench.executor.on_scene("another scene")
        bench.executor.offer(make_plan("q"))
        with pytest.raises(ReviewError, match="plan q was made for scene .*, the present one is"):
            bench.approval.review("q", plan.hash, True, "Ada", "because", override="")
        bench.executor.on_scene(SCENE)
        with pytest.raises(ReviewError, match="a verdict needs the reviewer's name"):
            bench.approval.review("q", "", True, " ", "because", override="")
        assert bench.state is ExecutorState.IDLE


class TestAdvised:
    def test_a_failed_rehearsal_is_on_record_and_holds_nothing_back(self):
        bench = Bench()
        bench.approval.rehearsal = RehearsalCheck(tool="t")
        bench.ready()
        plan = offered(bench, lambda plan: report_of(plan, FAILED))
        bench.review(plan.id, plan.hash, True, "Ada")
        assert bench.state is ExecutorState.PLAYING and bench.records[0].rehearsal == Rehearsed(FAILED, "f00d", ENGINE)

    def test_without_one_the_record_says_nothing_of_it(self):
        bench = Bench().ready()
        plan = offered(bench)
        bench.review(plan.id, plan.hash, True, "Ada")
        assert bench.records[0].rehearsal is None

    def test_and_there_is_nothing_to_override(self):
        bench = Bench().ready()
        with pytest.raises(ReviewError, match="nothing to override"):
            override(bench, offered(bench))

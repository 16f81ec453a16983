"""What the review record says of one plan, to a node that has lost sight of it."""

from __future__ import annotations

from dataclasses import replace

from plan_samples import make_plan

from construction_twin.core.reports import SessionRequest, SpeedChange
from construction_twin.review.plan_under_review import APPROVED, REJECTED, ExecutionEnd, Verdict
from construction_twin.review.record import PlanRecord, ReviewLog, read_plan_record
from construction_twin.robot.trajectory import Trajectory

PLAN = make_plan(Trajectory(("a",), [0.0, 1.5], [[0.0], [1.0]], [[0.0]] * 2, [[0.0]] * 2), "p", "5ce0e")


def record(path, *records) -> None:
    log = ReviewLog(path, lambda: 1_790_000_000_123_456_789)
    for one in records:
        log.append(one)
    log.close()


def verdict(plan_id: str, word: str = APPROVED, source: str = "work, offer 12ab") -> Verdict:
    return Verdict(word, plan_id, PLAN.hash, "Ada", "", replace(PLAN, id=plan_id, source=source))


def test_a_plan_is_found_by_its_id_or_by_what_its_source_names(tmp_path):
    path = tmp_path / "reviews.jsonl"
    record(
        path, verdict("other", source="someone"), verdict("p1"), ExecutionEnd(replace(PLAN, id="p1"), "stopped", "why")
    )
    assert read_plan_record(path, "p1") == PlanRecord("p1", True, "stopped")
    assert read_plan_record(path, "", "offer 12ab") == PlanRecord("p1", True, "stopped")
    assert read_plan_record(path, "", "offer 99") == PlanRecord("", False)


def test_a_plan_that_was_rejected_or_never_decided_was_not_approved(tmp_path):
    path = tmp_path / "reviews.jsonl"
    record(path, verdict("p1", REJECTED))
    assert read_plan_record(path, "p1") == PlanRecord("p1", False)
    assert read_plan_record(path, "p2") == PlanRecord("p2", False)


def test_what_people_set_meanwhile_says_nothing_of_a_plan(tmp_path):
    path = tmp_path / "reviews.jsonl"
    lowered, lifted = SpeedChange("dora", 0.3, 1.0, ""), SessionRequest("reset", "ada", "stop 3")
    record(
        path, lowered, verdict("p1"), lifted, lowered, ExecutionEnd(replace(PLAN, id="p1"), "stopped", "why"), lowered
    )
    assert read_plan_record(path, "p1") == PlanRecord("p1", True, "stopped")
    assert read_plan_record(path, "", "offer 12ab") == PlanRecord("p1", True, "stopped")


def test_the_line_that_is_being_written_does_not_count(tmp_path):
    path = tmp_path / "reviews.jsonl"
    record(path, verdict("p1"))
    path.write_bytes(path.read_bytes() + b'{"verdict": "appro')
    assert read_plan_record(path, "p1").approved


def test_a_record_that_cannot_be_read_says_nothing(tmp_path):
    path = tmp_path / "reviews.jsonl"
    assert read_plan_record(path, "p1") == PlanRecord("p1", None)
    path.write_text("no JSON\n")
    assert read_plan_record(path, "p1") == PlanRecord("p1", None)
    path.write_text("[1]\n")
    assert read_plan_record(path, "p1") == PlanRecord("p1", None)

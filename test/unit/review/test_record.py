"""The review record: what it holds, and that it is on the disk before anything moves. Its file: `core/test_append_only.py`."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest
from plan_samples import make_plan

from construction_twin.core.errors import ConfigurationError
from construction_twin.core.reports import SessionRequest, SpeedChange
from construction_twin.review.plan_under_review import APPROVED, REFUSED, ExecutionEnd, Verdict
from construction_twin.review.record import ReviewLog
from construction_twin.robot.plan import Clearance
from construction_twin.robot.trajectory import Trajectory

NOW = 1_790_000_000_123_456_789
MOTION = Trajectory(("a",), [0.0, 1.5], [[0.0], [1.0]], [[0.0]] * 2, [[0.0]] * 2)
PLAN = make_plan(MOTION, "p", "5ce0e")


def verdict(plan_id: str = "p", **changes) -> Verdict:
    return replace(Verdict(APPROVED, plan_id, PLAN.hash, "Ada", "looks good", PLAN), **changes)


@pytest.fixture
def path(tmp_path) -> Path:
    return tmp_path / "deep" / "reviews.jsonl"


@pytest.fixture
def log(path):
    log = ReviewLog(path, lambda: NOW)
    yield log
    log.close()


@pytest.fixture
def written(path) -> Path:
    """A file of five records whose writer has ended."""
    log = ReviewLog(path, lambda: NOW)
    for number in range(4):
        log.append(verdict(f"p{number}"))
    log.append(ExecutionEnd(replace(PLAN, id="p3"), "finished", "as Ada said"))
    log.close()
    return path


def lines(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()]


class TestContent:
    def test_a_verdict_tells_who_when_why_and_on_what(self, log, path):
        report = replace(PLAN.report, clearance=Clearance(0.0312, ("link_5", "wall"), (1.0, 0.0, 0.5), 0.75))
        log.append(verdict(plan=replace(PLAN, report=report)))
        assert lines(path) == [
            {
                "time": "2026-09-21T14:13:20.123456789Z",
                "time_ns": NOW,
                "record": "verdict",
                "verdict": "approved",
                "plan": "p",
                "trajectory": MOTION.content_hash(),
                "reviewer": "Ada",
                "reason": "looks good",
                "scene": "5ce0e",
                "source": "test",
                "planner": "none",
                "duration": 1.5,
                "clearance": 0.0312,
                "clearance_between": ["link_5", "wall"],
                "clearance_time": 0.75,
            }
        ]

    def test_a_clearance_without_anything_to_touch_is_null(self, log, path):
        assert math.isinf(PLAN.report.clearance.distance)
        log.append(verdict())
        assert lines(path)[0]["clearance"] is None

    def test_a_refusal_of_an_unknown_plan_has_no_details(self, log, path):
        log.append(Verdict(REFUSED, "x", "", "Ada", "plan x is not under review"))
        assert "scene" not in lines(path)[0] and lines(path)[0]["verdict"] == "refused"

    def test_what_became_of_an_execution_is_a_record_of_its_own(self, log, path):
        log.append(ExecutionEnd(PLAN, "stopped", "stop requested"))
        (record,) = lines(path)
        assert (record["record"], record["plan"], record["trajectory"]) == ("execution", "p", PLAN.hash)
        assert (record["outcome"], record["reason"]) == ("stopped", "stop requested")

    def test_words_cannot_break_out_of_their_line(self, log, path):
        reason = 'line\nbreak "quoted" \u2028 Schöne Grüße'
        log.append(verdict(reason=reason))
        log.append(verdict())
        assert lines(path)[0]["reason"] == reason and len(lines(path)) == 2


class TestContinuation:
    def test_an_execution_that_the_executor_did_not_survive_gets_its_end_recorded(self, path):
        log = ReviewLog(path, lambda: NOW)
        log.append(verdict("p0"))
        log.append(ExecutionEnd(PLAN, "finished", "goal reached"))
        log.append(verdict("p1"))
        # what people did meanwhile is of no plan
        log.defer(SpeedChange("dora", 0.3, 1.0, ""))
        log.defer(SessionRequest("reset", "ada", "stop 3"))
        log.flush()
        log.close()
        ReviewLog(path, lambda: NOW + 1).close()
        record = lines(path)[-1]
        assert (record["record"], record["plan"], record["outcome"]) == ("execution", "p1", "dropped")
        assert record["time_ns"] == NOW + 1 and "the executor ended" in record["reason"]
        ReviewLog(path, lambda: NOW).close()
        assert len(lines(path)) == 6

    def test_an_execution_that_has_its_end_gets_no_other(self, path):
        log = ReviewLog(path, lambda: NOW)
        log.append(verdict())
        log.append(verdict(verdict=REFUSED, reason="decided already"))
        log.append(ExecutionEnd(PLAN, "finished", "goal reached"))
        log.close()
        ReviewLog(path, lambda: NOW).close()
        assert len(lines(path)) == 3

    @pytest.mark.parametrize("empty", ["", "  "])
    def test_no_file_is_refused(self, empty):
        with pytest.raises(ConfigurationError, match="a path: nothing is approved without"):
            ReviewLog(empty, lambda: NOW)

"""The executor beside another arm: no start without a fresh verdict that the way is free."""

from __future__ import annotations

import pytest
from executor_bench import Bench, make_plan, within_acceleration
from hypothesis import given, settings
from hypothesis import strategies as st

from construction_twin.core.errors import ReviewError
from construction_twin.core.units import CYCLE_NS
from construction_twin.execution.approval import VERDICT_TIMEOUT, ConflictVerdicts
from construction_twin.execution.executor import ExecutorState
from construction_twin.review.plan_under_review import ExecutionEnd

PROBLEM = "link_3 would come too close to b/link_5 in 1.2 s, which stands there"


class Beside(Bench):
    """A bench with a watch that repeats its verdict every 25 cycles."""

    def __init__(self):
        super().__init__()
        self.approval.neighbour = ConflictVerdicts("b")
        self.verdict: str | None = ""
        self.plan = make_plan()

    def step(self):
        if self.verdict is not None and self.stamp // CYCLE_NS % 25 == 0:
            self.say(self.verdict)
        return super().step()

    def say(self, problem: str, plan_id: str = "") -> None:
        self.approval.neighbour.on_verdict(plan_id or self.plan.id, problem, self.stamp)
        self.executor.on_conflict(plan_id or self.plan.id, problem)

    def offered(self) -> Beside:
        self.ready()
        self.executor.offer(self.plan)
        self.run(30)
        return self

    def approve(self) -> str:
        return self.approval.review(self.plan.id, self.plan.hash, True, "tester").answer

    def ending(self) -> ExecutionEnd:
        return next(event for event in self.executor.pop_events() if isinstance(event, ExecutionEnd))


def test_a_free_way_is_played_to_its_end():
    bench = Beside().offered()
    bench.approve()
    bench.run_until_idle()
    assert bench.executor.outcome == "finished"


def test_a_plan_in_conflict_is_refused_with_the_sentence_and_stays_under_review():
    bench = Beside().offered()
    bench.say(PROBLEM)
    with pytest.raises(ReviewError, match=f"may not start: {PROBLEM}"):
        bench.approve()
    assert bench.state is ExecutorState.IDLE
    bench.say("")
    bench.approve()
    assert bench.state is ExecutorState.PLAYING


def test_nobody_who_looks_is_no_free_way():
    bench = Beside()
    bench.verdict = None
    with pytest.raises(ReviewError, match="may not start: its path was not checked against b yet"):
        bench.offered().approve()


def test_auto_approve_waits_until_the_way_is_free():
    bench = Beside().offered()
    bench.say(PROBLEM)
    assert bench.approval.approve_automatically(bench.stamp) is None
    assert bench.executor.under_review.plan is bench.plan
    bench.say("")
    assert bench.approval.approve_automatically(bench.stamp) is not None


@settings(max_examples=10, deadline=None)
@given(st.integers(1, 450))
def test_a_conflict_while_moving_brakes_along_the_path_within_the_limits(cycles):
    bench = Beside().offered()
    bench.approve()
    bench.run(cycles)
    bench.verdict = PROBLEM
    bench.say(PROBLEM)
    bench.run_until_idle()
    bench.run(5)
    ending = bench.ending()
    assert ending.outcome == "stopped" and ending.reason.startswith(PROBLEM)
    assert within_acceleration(bench.outputs)
    assert bench.outputs[-1] == bench.outputs[-2]


def test_a_watch_that_has_fallen_silent_lets_nothing_start():
    bench = Beside().offered()
    bench.verdict = None
    bench.run(VERDICT_TIMEOUT // CYCLE_NS + 30)
    with pytest.raises(ReviewError, match="is not checked against b any more"):
        bench.approve()


def test_a_verdict_on_another_plan_is_none():
    bench = Beside().offered()
    bench.verdict = None
    bench.say("", "another")
    with pytest.raises(ReviewError, match="not checked against b"):
        bench.approve()
    bench.say("")
    bench.approve()
    bench.say(PROBLEM, "another")
    bench.run_until_idle()
    assert bench.executor.outcome == "finished"


def test_a_paused_plan_ends_when_the_other_arm_was_earlier():
    bench = Beside().offered()
    bench.approve()
    bench.run(100)
    bench.executor.pause(bench.stamp)
    bench.run_until(ExecutorState.PAUSED)
    bench.say(PROBLEM)
    bench.step()
    assert bench.executor.outcome == "stopped"

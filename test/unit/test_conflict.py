"""The watch over the other arm: what is a conflict, who gives way, and what is known of an arm's plans."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from neighbour_cell import AWAY, CLEAR, NEAR, TOWARDS, empty_world, line, other, plan
from planning_cell import HOME, ROBOT

from construction_twin.executor_state import ACTIVE, ExecutorState
from construction_twin.neighbour_watch import VERDICT_TIMEOUT, NeighbourWatch
from construction_twin.planning.conflict import Claim, Conflict, OwnWay, braking_horizon, gives_way
from construction_twin.planning.plan_book import PlanBook, PlanUnknownError

OWN_STEP, PADDING = 0.1, 0.03
CLAIMS = st.builds(Claim, st.integers(0, 5), st.sampled_from(["a", "b"]))


def way(start=CLEAR, end=NEAR) -> OwnWay:
    return OwnWay(plan(start, end), empty_world(), OWN_STEP)


def row(made: OwnWay, share: float) -> int:
    return int(share * (len(made._rows) - 1))


def test_a_free_way_has_no_conflict_and_an_obstructed_one_says_when_and_with_what():
    made = way()
    assert made.conflict(other().between(AWAY, AWAY), PADDING) is None
    found = made.conflict(other().between(TOWARDS, TOWARDS), PADDING)
    assert found.between[0].startswith("link_") and found.between[1].startswith("other/")
    assert 0.0 < found.time < 4.0


def test_the_time_is_never_later_than_the_first_contact():
    made = way()
    obstacles = other().between(TOWARDS, TOWARDS)
    exact = empty_world().facing(item.padded(PADDING) for item in obstacles)
    contact = exact.all_free(made._rows)
    for now in (0, contact // 2, contact - 1):
        assert made.conflict(obstacles, PADDING, now).time <= (contact - now) * 0.004 + 1e-9


def test_what_lies_behind_is_no_conflict():
    """Back from where the other arm comes to: the way home is free once we are past it."""
    made = way(NEAR, CLEAR)
    obstacles = other().between(TOWARDS, TOWARDS)
    assert made.conflict(obstacles, PADDING, 0) is not None
    assert way(NEAR, CLEAR).conflict(obstacles, PADDING, row(made, 0.8)) is None


def test_the_watch_refuses_nothing_that_a_plan_with_the_larger_padding_allows():
    """Half of `own_step` and the watch's padding are less than the planner's: see `NeighbourSettings`."""
    path = line(AWAY, TOWARDS)
    for obstacles in (other().between(AWAY, AWAY), other().along(path).rest(), other().between(TOWARDS, TOWARDS)):
        planned = empty_world().with_neighbour(item.padded(PADDING + OWN_STEP / 2 + 0.02) for item in obstacles)
        for goal in np.linspace(0.0, 1.0, 8):
            made = way(CLEAR, CLEAR + goal * (NEAR - CLEAR) + 0.01)
            if planned.all_free(made._rows) is None:
                assert made.conflict(obstacles, PADDING) is None


def test_who_has_looked_at_the_whole_path_need_not_look_at_its_rest(monkeypatch):
    made, swept = way(CLEAR, HOME + np.radians([60, 0, 0, 0, 0, 0])), other().along(line(AWAY, AWAY + 0.3))
    assert made.conflict(swept.rest(), PADDING) is None
    monkeypatch.setattr(type(made._world), "facing", lambda *_: pytest.fail("looked again"))
    assert made.conflict(swept.rest(200), PADDING, 50) is None
    with pytest.raises(pytest.fail.Exception):
        made.conflict(other().between(TOWARDS, TOWARDS), PADDING, 50)


@given(CLAIMS, CLAIMS)
def test_of_two_that_run_exactly_one_gives_way(one, two):
    if one.name == two.name or not (one.since and two.since):
        return
    far = Conflict(10.0, ("link_1", "other/link_1"))
    assert gives_way(far, one, two, 2.0) != gives_way(far, two, one, 2.0)


def test_the_later_one_gives_way_and_the_name_settles_a_draw():
    far = Conflict(10.0, ("link_1", "other/link_1"))
    assert gives_way(far, Claim(7, "a"), Claim(5, "b"), 2.0)
    assert not gives_way(far, Claim(5, "a"), Claim(7, "b"), 2.0)
    assert not gives_way(far, Claim(5, "a"), Claim(5, "b"), 2.0)
    assert gives_way(far, Claim(5, "b"), Claim(5, "a"), 2.0)


def test_a_plan_that_has_not_begun_gives_way_and_so_does_one_before_an_arm_that_stands():
    far = Conflict(10.0, ("link_1", "other/link_1"))
    assert gives_way(far, Claim(0, "a"), Claim(5, "b"), 2.0)
    assert gives_way(far, Claim(0, "a"), Claim(0, "b"), 2.0)
    assert gives_way(far, Claim(5, "a"), None, 2.0)


def test_close_to_a_conflict_both_give_way():
    near = Conflict(1.9, ("link_1", "other/link_1"))
    assert gives_way(near, Claim(5, "a"), Claim(7, "b"), 2.0)


def test_the_horizon_holds_both_braking_times():
    braking = max(np.divide(ROBOT.velocity, ROBOT.acceleration))
    assert braking_horizon(ROBOT, ROBOT, 0.1, 0.1) == pytest.approx(2 * braking + 0.3)
    slower = dataclasses.replace(ROBOT, acceleration=tuple(value / 2 for value in ROBOT.acceleration))
    assert braking_horizon(ROBOT, slower, 0.1, 0.1) == pytest.approx(3 * braking + 0.3)


def problem(watch: NeighbourWatch, plan_id: str, now: int) -> str:
    watch.now = now
    return watch.problem(plan_id)


def test_a_verdict_holds_for_its_plan_and_for_half_a_second():
    watch = NeighbourWatch("b")
    assert "not checked against b yet" in problem(watch, "p1", 0)
    watch.on_verdict("p1", "", 1000)
    assert problem(watch, "p1", 1000 + VERDICT_TIMEOUT) == ""
    assert "last checked against b 0.5 s ago" in problem(watch, "p1", 1001 + VERDICT_TIMEOUT)
    assert "not checked" in problem(watch, "p2", 1000)
    watch.on_verdict("p1", "b stands there", 2000)
    assert problem(watch, "p1", 2000) == "b stands there"


def test_an_arm_alone_has_no_problem():
    assert problem(NeighbourWatch(), "p1", 0) == ""


def test_old_verdicts_are_forgotten():
    watch = NeighbourWatch("b")
    for number in range(20):
        watch.on_verdict(f"p{number}", "", number)
    assert problem(watch, "p19", 19) == "" and "not checked" in problem(watch, "p1", 19)


def book(state: ExecutorState = ExecutorState.IDLE, followed: str = "") -> PlanBook:
    made = PlanBook()
    made.on_execution(state.value, followed, 0)
    return made


def test_nothing_is_known_before_the_executor_speaks():
    with pytest.raises(PlanUnknownError, match="nothing yet"):
        PlanBook().followed()


@pytest.mark.parametrize("state", ExecutorState)
def test_a_plan_is_followed_until_it_has_ended_also_while_it_rests(state):
    made, p = book(), plan(CLEAR, NEAR)
    made.on_plan(p)
    made.on_execution(state.value, p.id, 5)
    assert made.followed() is (p if state in ACTIVE else None)
    assert made.waiting() is None


def test_a_plan_that_nobody_has_seen_is_not_taken_for_none():
    with pytest.raises(PlanUnknownError, match="plan gone"):
        book(ExecutorState.PLAYING, "gone").followed()


def test_a_plan_waits_until_it_is_decided_or_replaced():
    made = book()
    first, second = plan(CLEAR, NEAR, "p1"), plan(CLEAR, HOME, "p2")
    made.on_plan(first)
    assert made.waiting() is first
    made.on_plan(second)
    made.on_verdict("p1", False)
    assert made.waiting() is second
    made.on_verdict("p2", True)
    assert made.waiting() is second  # until it plays: it must be watched in between
    made.on_verdict("p2", False)
    assert made.waiting() is None


def test_the_plan_that_runs_is_kept_while_many_others_come():
    made, p = book(), plan(CLEAR, NEAR)
    made.on_plan(p)
    made.on_execution(ExecutorState.PLAYING.value, p.id, 5)
    for number in range(30):
        made.on_plan(plan(CLEAR, HOME, f"other{number}"))
    assert made.followed() is p
    assert len(made._plans) <= 10


def test_an_unknown_state_is_refused():
    with pytest.raises(ValueError):
        PlanBook().on_execution(99, "", 0)

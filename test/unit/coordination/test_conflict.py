"""The watch over the other arm: what is a conflict, who gives way, and what is known of an arm's plans."""

from __future__ import annotations

import dataclasses
from functools import cache

import coal
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from memory import size
from neighbour_cell import AWAY, CLEAR, NEAR, STRETCHED, TOWARDS, empty_world, line, other, plan
from planning_cell import HOME, ROBOT
from sentence_checks import says

from construction_twin.coordination import conflict as conflict_module
from construction_twin.coordination.conflict import (
    Claim,
    Conflict,
    OwnPath,
    braking_horizon,
    copies,
    first_contact,
    gives_way,
)
from construction_twin.coordination.path_judge import PlanBook, PlanUnknownError
from construction_twin.coordination.path_sweep import PathSweep
from construction_twin.core.errors import PayloadError
from construction_twin.execution.conflict_verdicts import AHEAD, VERDICT_TIMEOUT, ConflictVerdicts
from construction_twin.execution.states import ACTIVE, ExecutorState
from construction_twin.kinematics.chain import Pose
from construction_twin.scene.neighbour import Neighbour

OWN_STEP, PADDING = 0.1, 0.03
CLAIMS = st.builds(Claim, st.integers(0, 5), st.sampled_from(["a", "b"]))


@cache
def own_arm() -> Neighbour:
    return Neighbour("own", ROBOT, Pose(np.zeros(3), np.eye(3)), OWN_STEP)


def way(start=CLEAR, end=NEAR) -> OwnPath:
    return OwnPath(plan(start, end), own_arm())


def rows(made: OwnPath) -> np.ndarray:
    return made.plan.trajectory.sample_many(PathSweep(own_arm(), made.plan.trajectory).times)[0]


def row(made: OwnPath, fraction: float) -> int:
    return int(fraction * (len(rows(made)) - 1))


def conflict(made: OwnPath, obstacles, at: int = 0) -> Conflict | None:
    return made.check(obstacles, PADDING, at).conflict


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    monkeypatch.setattr(conflict_module, "BLOCK", 16)


@pytest.fixture
def compared(monkeypatch) -> list[int]:
    """How many copies of our arm each comparison took."""
    counts = []

    def counting(own, others, padding):
        counts.append(sum(len(item.places) for item in own))
        return first_contact(own, others, padding)

    monkeypatch.setattr(conflict_module, "first_contact", counting)
    return counts


def test_a_free_way_has_no_conflict_and_an_obstructed_one_says_when_and_with_what():
    made = way()
    assert conflict(made, other().between(AWAY, AWAY)) is None
    found = conflict(made, other().between(TOWARDS, TOWARDS))
    assert found.between[0].startswith("link_") and found.between[1].startswith("other/")
    assert 0.0 < found.time < 4.0


def test_the_time_is_never_later_than_the_first_contact():
    made = way()
    obstacles = other().between(TOWARDS, TOWARDS)
    exact = empty_world().with_neighbour(item.padded(PADDING) for item in obstacles)
    contact = exact.all_free(rows(made))
    for now in (0, contact // 2, contact - 1):
        assert conflict(made, obstacles, now).time <= (contact - now) * 0.004 + 1e-9


def test_what_lies_behind_is_no_conflict():
    """Back from where the other arm comes to: the way home is free once we are past it."""
    made = way(NEAR, CLEAR)
    obstacles = other().between(TOWARDS, TOWARDS)
    assert conflict(made, obstacles) is not None
    assert conflict(way(NEAR, CLEAR), obstacles, row(made, 0.8)) is None
    assert conflict(made, obstacles, row(made, 0.8)) is None


def test_the_watch_refuses_nothing_that_a_plan_with_the_larger_padding_allows():
    """Half of `OWN_STEP` and the watch's padding are less than the planner's: see `NeighbourSettings`."""
    path = line(AWAY, TOWARDS)
    for obstacles in (other().between(AWAY, AWAY), other().along(path).rest(), other().between(TOWARDS, TOWARDS)):
        planned = empty_world().with_neighbour(item.padded(PADDING + OWN_STEP / 2 + 0.02) for item in obstacles)
        for goal in np.linspace(0.0, 1.0, 8):
            made = way(CLEAR, CLEAR + goal * (NEAR - CLEAR) + 0.01)
            if planned.all_free(rows(made)) is None:
                assert conflict(made, obstacles) is None


def test_who_has_looked_at_the_whole_path_need_not_look_at_its_rest(compared):
    made, swept = way(CLEAR, HOME + np.radians([60, 0, 0, 0, 0, 0])), other().along(line(AWAY, AWAY + 0.3))
    assert conflict(made, swept.rest()) is None
    compared.clear()
    assert conflict(made, swept.rest(200), 50) is None
    assert not compared
    conflict(made, other().between(TOWARDS, TOWARDS), 50)
    assert compared


def test_a_look_takes_what_is_near_and_no_more_than_its_budget_beyond(compared):
    made, obstacles = way(CLEAR, CLEAR + np.radians([-60, 0, 0, 0, 0, 0])), other().along(line(AWAY, AWAY + 0.3)).rest()
    whole = PathSweep(own_arm(), made.plan.trajectory, standing=False)
    whole.grow(whole.row_after(0, np.inf))
    copies = len(whole.copies)
    near = whole.copies_before(126)
    assert 0 < near < copies - 200
    check = made.check(obstacles, PADDING, 0, 0.5)
    assert check.conflict is None and sum(compared) == -(-near // 16) * 16 and 0.1 < check.fraction < 0.3
    fractions = []
    while check.fraction < 1.0:
        compared.clear()
        check = made.check(obstacles, PADDING, 0, 0.5, 1)
        assert check.conflict is None and 0 < sum(compared) <= 16
        fractions.append(check.fraction)
    assert len(fractions) >= (copies - near) // 16 and fractions == sorted(set(fractions))
    compared.clear()
    assert made.check(obstacles, PADDING, 0, 0.5, 1).fraction == 1.0 and not compared


def test_many_looks_find_the_same_conflict_as_one_and_keep_it_without_looking_again(compared):
    obstacles = other().between(TOWARDS, TOWARDS)
    whole, made = conflict(way(), obstacles), way()
    check = made.check(obstacles, PADDING, 0, 0.1, 1)
    while check.conflict is None:
        assert check.fraction < 1.0
        check = made.check(obstacles, PADDING, 0, 0.1, 1)
    assert check.conflict == whole
    compared.clear()
    assert made.check(obstacles, PADDING, 0, 0.1, 1).conflict == whole and not compared


def test_a_conflict_with_what_the_other_arm_has_left_behind_is_over():
    made, swept = way(), other().along(line(TOWARDS, AWAY))
    assert conflict(made, swept.rest()) is not None
    left = swept.rest(390)
    assert conflict(made, left) == conflict(way(), left)


def test_new_obstacles_need_no_new_look_at_the_old_ones(compared):
    made, old = way(CLEAR, HOME + np.radians([60, 0, 0, 0, 0, 0])), other().along(line(AWAY, AWAY + 0.3)).rest()
    assert made.check(old, PADDING, 0, 0.1, 1).fraction < 1.0
    for shift in range(1, 20):
        beside = other().along(np.array([AWAY + 0.01 * shift])).rest()
        check = made.check((*old, *beside), PADDING, 0, 0.1, 30_000)
    assert check.conflict is None and check.fraction < 1.0
    compared.clear()
    assert made.check(old, PADDING, 0, 0.1, 1).fraction == 1.0 and not compared


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.3))
def test_the_first_meeting_is_that_of_every_pair_measured_one_by_one(seed, padding):
    rng = np.random.default_rng(seed)
    turns = rng.uniform(-0.9, 0.9, (4, 6))
    own = [item for _, _, item in own_arm().along(line(*(NEAR + turns[:2]), 60), False).copies]
    theirs = other().along(line(*(STRETCHED + turns[2:]), 60)).rest()
    found = first_contact(copies(own), copies(theirs), padding)
    expected = next((place for place, item in enumerate(own) if any(meets(item, it, padding) for it in theirs)), None)
    assert (found and found[0]) == expected
    if found is not None:
        assert meets(own[found[0]], found[1], padding)


def meets(one, two, padding: float) -> bool:
    request = coal.CollisionRequest()
    request.security_margin = one.padding + two.padding + padding
    at = [coal.Transform3s(item.placement.rotation, item.placement.translation) for item in (one, two)]
    return bool(coal.collide(one.geometry, at[0], two.geometry, at[1], request, coal.CollisionResult()))


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


def test_the_horizon_holds_both_braking_times_and_the_age_of_all_that_is_known():
    braking = max(np.divide(ROBOT.velocity, ROBOT.acceleration))
    assert braking_horizon(ROBOT, ROBOT, 0.2, 0.3, 0.1) == pytest.approx(2 * braking + 0.6)
    slower = dataclasses.replace(ROBOT, acceleration=tuple(value / 2 for value in ROBOT.acceleration))
    assert braking_horizon(ROBOT, slower, 0.2, 0.3, 0.1) == pytest.approx(3 * braking + 0.6)


def problem(watch: ConflictVerdicts, plan_id: str, now: int) -> str:
    watch.now = now
    return watch.problem(plan_id)


def test_a_verdict_holds_for_its_plan_and_for_half_a_second():
    watch = ConflictVerdicts("b")
    assert "not checked against b yet" in problem(watch, "p1", 0)
    watch.on_verdict("p1", "", 1000)
    assert problem(watch, "p1", 1000 + VERDICT_TIMEOUT) == ""
    assert "last checked against b 0.5 s ago" in problem(watch, "p1", 1001 + VERDICT_TIMEOUT)
    assert "not checked" in problem(watch, "p2", 1000)
    watch.on_verdict("p1", "b stands there", 2000)
    assert problem(watch, "p1", 2000) == "b stands there"


def test_a_verdict_is_as_old_as_the_poses_it_goes_by():
    watch = ConflictVerdicts("b")
    watch.on_verdict("p1", "", 1000, VERDICT_TIMEOUT // 2)
    assert problem(watch, "p1", 1000 + VERDICT_TIMEOUT // 2) == ""
    assert "last checked" in problem(watch, "p1", 1001 + VERDICT_TIMEOUT // 2)


@pytest.mark.parametrize("age", [VERDICT_TIMEOUT + 1, -AHEAD - 1])
def test_a_verdict_that_comes_too_late_or_from_the_future_is_refused_and_the_last_one_grows_old(age):
    watch = ConflictVerdicts("b")
    watch.on_verdict("p1", "", 0)
    with pytest.raises(PayloadError, check=says("executor.refused.conflict_age", least=-0.01, most=0.5)) as caught:
        watch.on_verdict("p1", "", 1000, age)
    assert caught.value.reason == "conflict_age"
    assert "last checked" in problem(watch, "p1", VERDICT_TIMEOUT + 1)


def test_a_clock_that_is_set_a_little_makes_no_verdict_younger_than_its_arrival():
    watch = ConflictVerdicts("b")
    watch.on_verdict("p1", "", 0, -AHEAD)
    assert "last checked" in problem(watch, "p1", VERDICT_TIMEOUT + 1)


def test_an_arm_alone_has_no_problem():
    assert problem(ConflictVerdicts(), "p1", 0) == ""


def test_old_verdicts_are_forgotten():
    watch = ConflictVerdicts("b")
    for number in range(20):
        watch.on_verdict(f"p{number}", "", number)
    assert problem(watch, "p19", 19) == "" and "not checked" in problem(watch, "p1", 19)


def book(state: ExecutorState = ExecutorState.IDLE, followed: str = "") -> PlanBook:
    made = PlanBook()
    made.on_execution(state.value, followed, 0)
    return made


def test_nothing_is_known_before_the_executor_speaks():
    with pytest.raises(PlanUnknownError, check=says("reason.neighbour.executor_silent")):
        PlanBook().followed()


@pytest.mark.parametrize("state", ExecutorState)
def test_a_plan_is_followed_until_it_has_ended_also_while_it_rests(state):
    made, p = book(), plan(CLEAR, NEAR)
    made.on_plan(p)
    made.on_execution(state.value, p.id, 5)
    assert made.followed() is (p if state in ACTIVE else None)
    assert made.waiting() is None


def test_a_plan_that_nobody_has_seen_is_not_taken_for_none():
    with pytest.raises(PlanUnknownError, check=says("reason.neighbour.earlier_plan", plan="gone")):
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
        if number == 10:
            held = size(made)
        made.on_plan(plan(CLEAR, HOME, f"other{number}"))
    assert made.followed() is p
    assert size(made) <= held * 1.05


def test_an_unknown_state_is_refused():
    with pytest.raises(ValueError):
        PlanBook().on_execution(99, "", 0)

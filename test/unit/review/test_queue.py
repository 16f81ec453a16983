"""The review desk: one plan at a time, one verdict per plan, on exactly the content that was looked at."""

from __future__ import annotations

import plan_samples
import pytest

from construction_twin.core.errors import ReviewError
from construction_twin.review.queue import ReviewDesk, prove_hash
from construction_twin.robot.plan import Plan
from construction_twin.robot.trajectory import Trajectory


def make_plan(name: str, goal: float = 1.0, scene: str = "s") -> Plan:
    motion = Trajectory(("joint_a1",), [0.0, 1.0], [[0.0], [goal]], [[0.0]] * 2, [[0.0]] * 2)
    return plan_samples.make_plan(motion, name, scene)


@pytest.fixture
def desk() -> ReviewDesk:
    desk = ReviewDesk()
    desk.offer(make_plan("a"))
    return desk


@pytest.mark.parametrize("compared", [True, False])
def test_a_verdict_takes_the_plan_off_the_desk(desk, compared):
    plan = desk.plan
    assert desk.decide("a", plan.hash if compared else "", "Ada") is plan
    assert desk.plan is None


def test_a_decided_plan_cannot_be_decided_again(desk):
    desk.decide("a", "", "Ada")
    with pytest.raises(ReviewError, match="decided already"):
        desk.decide("a", "", "Ada")


def test_a_decided_plan_that_is_offered_again_stays_off_the_desk(desk):
    plan = desk.plan
    desk.decide("a", "", "Ada")
    desk.offer(plan)
    assert desk.plan is None


@pytest.mark.parametrize(
    "plan_id, plan_hash, reviewer, sentence",
    [
        ("a", "", "", "name"),
        ("a", "", "  ", "name"),
        ("b", "", "Ada", "not under review; plan a is"),
        ("a", "0" * 64, "Ada", "look at it again"),
    ],
)
def test_a_verdict_that_does_not_fit_leaves_the_plan_on_the_desk(desk, plan_id, plan_hash, reviewer, sentence):
    with pytest.raises(ReviewError, match=sentence):
        desk.decide(plan_id, plan_hash, reviewer)
    assert desk.plan.id == "a"


def test_an_empty_desk_says_so():
    with pytest.raises(ReviewError, match="no plan is"):
        ReviewDesk().decide("a", "", "Ada")


def test_a_newer_plan_replaces_the_one_before(desk):
    desk.offer(make_plan("b", 2.0))
    assert desk.plan.id == "b"
    with pytest.raises(ReviewError, match="a was decided already or withdrawn"):
        desk.decide("a", "", "Ada")


def test_a_plan_taken_off_the_desk_cannot_be_approved_later(desk):
    plan = desk.plan
    desk.clear()
    desk.offer(plan)
    with pytest.raises(ReviewError, match="decided already"):
        desk.decide("a", "", "Ada")


def test_clearing_an_empty_desk_decides_nothing():
    desk = ReviewDesk()
    desk.clear()
    desk.offer(make_plan("a"))
    assert desk.plan.id == "a"


def test_a_plan_that_does_not_end_at_rest_is_refused():
    motion = Trajectory(("a",), [0.0, 1.0], [[0.0], [1.0]], [[0.0], [0.1]], [[0.0], [0.0]])
    with pytest.raises(ReviewError, match="at rest"):
        ReviewDesk().offer(plan_samples.make_plan(motion))


def test_offering_tells_which_plan_was_replaced(desk):
    first = desk.plan
    assert desk.offer(make_plan("a")) is None and desk.plan is first
    assert desk.offer(make_plan("b")) is first


def test_voiding_tells_what_lay_there_and_refuses_what_is_on_its_way(desk):
    first = desk.plan
    assert desk.void(5) is first and desk.void(6) is None
    with pytest.raises(ReviewError, match="last stop, pause or reset"):
        desk.offer(make_plan("b"))


class TestScene:
    def test_another_scene_takes_the_plan_off_the_desk(self, desk):
        plan = desk.plan
        assert desk.on_scene("s") is None and desk.plan is plan
        assert desk.on_scene("t") is plan and desk.plan is None
        with pytest.raises(ReviewError, match="decided already"):
            desk.check("a", "", "Ada")

    def test_a_plan_for_the_scene_that_comes_stays(self, desk):
        desk.on_scene("s")
        desk.offer(make_plan("b", scene="t"))
        assert desk.on_scene("t") is None and desk.plan.id == "b"
        desk.check_scene()

    def test_content_is_checked_against_scene(self, desk):
        with pytest.raises(ReviewError, match="no scene is known"):
            desk.check_scene()
        desk.on_scene("s")
        desk.check_scene()

    def test_content_is_checked_against_its_hash(self, desk):
        prove_hash(desk.plan)
        positions = desk.plan.trajectory.positions.copy()
        positions[1] += 1e-15
        object.__setattr__(desk.plan.trajectory, "positions", positions)
        with pytest.raises(ReviewError, match="no longer what its hash"):
            prove_hash(desk.plan)

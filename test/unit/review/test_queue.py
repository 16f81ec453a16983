"""The review queue: one plan at a time, one verdict per plan, on exactly the content that was looked at."""

from __future__ import annotations

import plan_samples
import pytest

from construction_twin.core.errors import ReviewError
from construction_twin.review.plan_under_review import PlanUnderReview
from construction_twin.robot.plan import Plan
from construction_twin.robot.trajectory import Trajectory


def make_plan(name: str, goal: float = 1.0, scene: str = "s") -> Plan:
    motion = Trajectory(("joint_a1",), [0.0, 1.0], [[0.0], [goal]], [[0.0]] * 2, [[0.0]] * 2)
    return plan_samples.make_plan(motion, name, scene)


@pytest.fixture
def queue() -> PlanUnderReview:
    queue = PlanUnderReview()
    queue.offer(make_plan("a"))
    return queue


def test_a_decided_plan_that_is_offered_again_stays_out_of_review(queue):
    plan = queue.plan
    queue.decide("a", "", "Ada")
    queue.offer(plan)
    assert queue.plan is None


@pytest.mark.parametrize(
    "plan_id, plan_hash, reviewer, words",
    [
        ("a", "", "", "needs the reviewer's name"),
        ("a", "", "  ", "needs the reviewer's name"),
        ("b", "", "Ada", "plan b is not under review; plan a is"),
        ("a", "0" * 64, "Ada", "has hash .*, not 0+; look at it again"),
    ],
)
def test_a_verdict_that_does_not_fit_leaves_the_plan_under_review(queue, plan_id, plan_hash, reviewer, words):
    with pytest.raises(ReviewError, match=words):
        queue.decide(plan_id, plan_hash, reviewer)
    assert queue.plan.id == "a"


def test_a_plan_that_does_not_end_at_rest_is_refused():
    motion = Trajectory(("a",), [0.0, 1.0], [[0.0], [1.0]], [[0.0], [0.1]], [[0.0], [0.0]])
    with pytest.raises(ReviewError, match="does not start and end at rest; plan again"):
        PlanUnderReview().offer(plan_samples.make_plan(motion))


def test_voiding_tells_what_lay_there_and_refuses_what_is_on_its_way(queue):
    first = queue.plan
    assert queue.void(5) is first and queue.void(6) is None
    with pytest.raises(ReviewError, match="was asked for before the last stop, pause or reset"):
        queue.offer(make_plan("b"))


class TestScene:
    def test_another_scene_takes_the_plan_out_of_review(self, queue):
        plan = queue.plan
        assert queue.on_scene("s") is None and queue.plan is plan
        assert queue.on_scene("t") is plan and queue.plan is None
        with pytest.raises(ReviewError, match="plan a was decided already"):
            queue.check("a", "", "Ada")

    def test_a_plan_for_the_scene_that_comes_stays(self, queue):
        queue.on_scene("s")
        queue.offer(make_plan("b", scene="t"))
        assert queue.on_scene("t") is None and queue.plan.id == "b"
        queue.check_scene()

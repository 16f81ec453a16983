"""The preview: the ghost plays the plan under review and nothing else."""

from __future__ import annotations

import math

import pytest
from plan_samples import make_plan

from construction_twin.core.errors import ReviewError
from construction_twin.robot.plan import Plan
from construction_twin.robot.trajectory import Trajectory
from construction_twin.views.preview import LOOP_REST, Preview

NAMES = ("joint_a1", "joint_a2")
TWIN = (0.3, -0.3)
GOAL = (1.0, 2.0)
DURATION = 2.0


def plan(name: str = "p") -> Plan:
    rest = [[0.0, 0.0]] * 2
    return make_plan(Trajectory(NAMES, [0.0, DURATION], [[0.0, 0.0], [1.0, 2.0]], rest, rest), name)


@pytest.fixture
def preview() -> Preview:
    preview = Preview()
    preview.on_twin(TWIN)
    preview.on_plan(plan())
    return preview


class TestGhost:
    def test_hides_inside_the_twin_while_no_plan_is_under_review(self):
        preview = Preview()
        preview.on_twin(TWIN)
        assert preview.pose(0.0) == TWIN
        preview.on_twin((0.4, 0.0))
        assert preview.pose(1.0) == (0.4, 0.0)

    def test_stands_at_the_goal_of_the_plan_under_review_without_being_asked(self, preview):
        assert preview.pose(0.0) == preview.pose(100.0) == GOAL
        preview.on_verdict("p", True)
        assert preview.pose(100.0) == TWIN

    def test_is_nowhere_before_the_twin_is_known(self):
        assert Preview().pose(0.0) is None

    @pytest.mark.parametrize("speed", [0.1, 1.0, 3.0])
    def test_plays_the_plan_at_the_chosen_speed(self, preview, speed):
        sentence = preview.play(speed, False, 10.0)
        assert f"{DURATION / speed:.3f} s" in sentence
        trajectory = preview.plan.trajectory
        for fraction in (0.0, 0.25, 0.5, 0.9):
            expected = tuple(trajectory.sample(fraction * DURATION)[0].tolist())
            assert preview.pose(10.0 + fraction * DURATION / speed) == pytest.approx(expected, abs=1e-12)

    def test_plays_again_and_again_with_a_rest_at_the_goal(self, preview):
        assert preview.play(2.0, True, 0.0).endswith("again and again; nothing moves")
        period = DURATION / 2.0 + LOOP_REST
        assert preview.pose(DURATION / 2.0 + LOOP_REST / 2) == (1.0, 2.0)
        for time in (0.2, 0.7):
            assert preview.pose(3 * period + time) == pytest.approx(preview.pose(time), abs=1e-9)

    def test_begins_anew_when_asked_again(self, preview):
        preview.play(1.0, False, 0.0)
        preview.play(1.0, False, 1.0)
        assert preview.pose(1.0) == (0.0, 0.0)

    def test_ends_at_speed_zero(self, preview):
        preview.play(1.0, True, 0.0)
        assert preview.play(0.0, False, 0.5) == "the preview has ended"
        assert preview.pose(1.0) == GOAL

    @pytest.mark.parametrize("speed", [-1.0, math.inf, math.nan])
    def test_refuses_a_speed_that_makes_no_sense(self, preview, speed):
        with pytest.raises(ReviewError, match="expected a positive number, or 0 to end it"):
            preview.play(speed, False, 0.0)
        assert preview.pose(0.5) == GOAL

    @pytest.mark.parametrize("approved", [True, False, None])
    def test_plays_nothing_that_is_not_under_review(self, preview, approved):
        if approved is None:
            preview = Preview()
        else:
            preview.on_verdict("p", approved)
        with pytest.raises(ReviewError, match="no plan is under review"):
            preview.play(1.0, False, 0.0)

    @pytest.mark.parametrize("approved", [True, False])
    def test_a_verdict_ends_it(self, preview, approved):
        preview.play(1.0, True, 0.0)
        preview.on_verdict("p", approved)
        assert preview.pose(0.5) == TWIN

    def test_a_verdict_on_another_plan_changes_nothing(self, preview):
        preview.play(1.0, False, 0.0)
        preview.on_verdict("q", False)
        preview.on_ending("q")
        assert preview.pose(DURATION) == (1.0, 2.0)

    def test_a_newer_plan_ends_it_but_the_same_again_does_not(self, preview):
        preview.play(1.0, False, 0.0)
        preview.on_plan(plan())
        assert preview.pose(DURATION) == (1.0, 2.0)
        preview.on_plan(plan("q"))
        # at the goal, not on its way there
        assert preview.pose(DURATION / 2) == GOAL and preview.under_review.id == "q"


class TestShown:
    def test_an_approved_plan_is_shown_until_its_execution_ends(self, preview):
        preview.on_verdict("p", True)
        assert preview.plan.id == "p" and preview.under_review is None
        preview.on_ending("p")
        assert preview.plan is None

    def test_a_plan_that_arrives_after_its_verdict_is_not_played(self):
        preview = Preview()
        preview.on_verdict("p", True)
        preview.on_plan(plan())
        assert preview.plan is not None and preview.under_review is None

    @pytest.mark.parametrize("end", [lambda p: p.on_verdict("p", False), lambda p: p.on_ending("p")], ids=["no", "end"])
    def test_a_plan_that_arrives_after_its_end_is_not_shown(self, end):
        preview = Preview()
        end(preview)
        preview.on_plan(plan())
        assert preview.plan is None

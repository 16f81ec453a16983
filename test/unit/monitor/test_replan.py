"""What a re-plan asks for: the goal of the plan that was interrupted, no faster than it was approved."""

from __future__ import annotations

import pytest
from memory import size

from construction_twin.monitor.monitor import MAX_GOALS, Monitor, ReplanGoal


def monitor() -> Monitor:
    return Monitor(None, ())


def test_asks_for_the_goal_of_what_plays_at_its_largest_shares():
    goals = monitor()
    goals.on_plan("a", [0.1, 0.2], [0.05, 0.2], [0.3, 1.0001])
    goals.on_plan("b", [1.0, 2.0], [0.5, 0.5], [0.5, 0.5])
    assert goals.interrupted is None
    goals.on_execution("a", "", True, "c0ffee00-7")
    assert goals.interrupted == ReplanGoal("a", (0.1, 0.2), 0.2, 1.0, "c0ffee00-7")


def test_a_played_plan_is_remembered_however_many_are_offered():
    goals = monitor()
    goals.on_plan("a", [0.1], [0.2], [0.3])
    goals.on_execution("a", "", True, "c0ffee00-7")
    for number in range(3 * MAX_GOALS):
        if number == MAX_GOALS + 2:
            held = size(goals)
        goals.on_plan(str(number), [0.0], [0.1], [0.1])
    assert goals.interrupted.goal == (0.1,)
    assert size(goals) <= held
    goals.on_execution(str(3 * MAX_GOALS - 1), "", True, "c0ffee00-7")
    assert goals.interrupted.goal == (0.0,)


@pytest.mark.parametrize("use", [[], [0.0, 0.0]])
def test_a_plan_that_stands_still_is_not_re_planned_at_the_planner_s_default_speed(use):
    goals = monitor()
    goals.on_plan("a", [0.1, 0.2], use, [0.1, 0.1])
    goals.on_execution("a", "", True, "c0ffee00-7")
    assert goals.interrupted is None

"""The marker's goal: until a motion has ended there, or the operator drops it."""

from __future__ import annotations

import numpy as np
from executor_bench import ROBOT, make_plan

from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.ros.shared.tool_marker_menu import REACHED, MarkerGoal, moved


def test_a_goal_that_a_plan_led_to_is_told_from_another():
    chain, plan, goal = Chain(ROBOT), make_plan("p1"), MarkerGoal()
    begin, end = (chain.forward(plan.trajectory.positions[index]) for index in (0, -1))
    goal.drag(begin)
    goal.reached(end)
    assert goal.pose is begin
    goal.drag(end)
    goal.reached(chain.forward(plan.trajectory.positions[-1]))
    assert goal.pose is None
    goal.reached(end)
    assert goal.pose is None


def test_moved_is_position_or_rotation():
    origin = Pose(np.zeros(3), np.eye(3))
    assert not moved(origin, Pose(np.full(3, 0.9 * REACHED), np.eye(3)), REACHED)
    assert moved(origin, Pose(np.array([0.0, 1.1 * REACHED, 0.0]), np.eye(3)), REACHED)
    turned = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert moved(origin, Pose(np.zeros(3), turned), REACHED)

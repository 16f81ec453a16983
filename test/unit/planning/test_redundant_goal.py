"""A pose goal of an arm with seven joints: the free joint is chosen so that nothing is touched."""

from __future__ import annotations

import time

import numpy as np
from inverse_cases import PANDA_LIKE, make_inverse

from construction_twin.planning.planner import Planner, PlannerSettings, PlanRequest
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.self_collision import sample_self_collision

SETTINGS = PlannerSettings(
    planner="RRTConnect", planning_budget=10.0, edge_step=0.05, speed_scale=0.5, max_waypoints=2000,
    max_duration=600.0, seed=1,
)  # fmt: skip
HOME = np.array(PANDA_LIKE.home)
GOAL = np.array([0.7, 0.3, 0.2, -1.9, 0.1, 2.0, 0.6])


def test_where_the_nearest_posture_touches_something_another_one_of_the_same_pose_is_taken():
    inverse = make_inverse(PANDA_LIKE)
    chain = inverse.chain
    pose = chain.forward(GOAL)
    nearest = inverse.nearest(pose, HOME).q
    # a ball where the nearest posture has its elbow
    elbow = chain.skeleton(nearest)[4]
    pairs = sample_self_collision(PANDA_LIKE, samples=1000)
    world = CollisionWorld(PANDA_LIKE, Scene((SceneObject("ball", "sphere", (0.03,), tuple(elbow)),), 0.005), pairs)
    assert not world.is_free(nearest)
    planner = Planner(PANDA_LIKE, inverse, SETTINGS, time.monotonic)
    plan = planner.plan_to_pose(HOME, pose, PlanRequest("plan", 0), world)
    end = plan.trajectory.positions[-1]
    assert world.is_free(end)
    np.testing.assert_allclose(chain.forward(end).position, pose.position, atol=1e-5)
    np.testing.assert_allclose(chain.forward(end).rotation, pose.rotation, atol=1e-5)
    assert np.linalg.norm(end - nearest) > 0.1

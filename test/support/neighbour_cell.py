"""Two KR 120 beside each other, for the tests of the neighbour."""

from __future__ import annotations

from functools import cache

import numpy as np
from plan_samples import make_plan
from planning_cell import HOME, ROBOT, SELF_COLLISION

from construction_twin.kinematics.chain import Pose
from construction_twin.planning.timing import time_path
from construction_twin.robot.plan import Plan
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.neighbour import Neighbour
from construction_twin.scene.objects import Scene, SceneObject

#: Of the other arm's root in ours: to the left, within reach of each other.
BESIDE = Pose(np.array([0.0, 2.6, 0.0]), np.eye(3))
#: The other arm stretched out towards us, and turned away.
TOWARDS = HOME + np.radians([90, 40, -40, 0, 0, 0])
AWAY = HOME + np.radians([-90, 0, 0, 0, 0, 0])
#: Our arm reaching to the other's side (A1 turns as KUKA's does, clockwise from above), and turned away.
NEAR, CLEAR = HOME + np.radians([-60, 20, -20, 0, 0, 0]), HOME + np.radians([90, 40, -40, 0, 0, 0])
#: The other arm, low and stretched out between A1 -20 deg and A1 -100 deg of ours.
STRETCHED = HOME + np.radians([45, 75, -60, 0, 0, 0])


@cache
def other() -> Neighbour:
    """Return the other arm."""
    return Neighbour("other", ROBOT, BESIDE)


def line(start: np.ndarray, end: np.ndarray, count: int = 400) -> np.ndarray:
    """Return a straight joint path, shape (count, n)."""
    return start + np.linspace(0.0, 1.0, count)[:, None] * (end - start)


def empty_world(*objects: SceneObject) -> CollisionWorld:
    return CollisionWorld(ROBOT, Scene(objects, 0.0), SELF_COLLISION)


def plan(start: np.ndarray, end: np.ndarray, plan_id: str = "p1", duration: float = 4.0) -> Plan:
    """Return a straight plan, checked against nothing."""
    trajectory = time_path(np.array([start, end]), ROBOT, duration=duration)
    return make_plan(trajectory, plan_id, "0" * 64, asked_ns=1)

"""A KR 120 with a planner in small scenes, for the planning tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio
from plan_samples import make_plan

from construction_twin.core.freshness import Moment
from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.planning.planner import Planner, PlannerSettings, PlanRequest
from construction_twin.planning.timing import time_path
from construction_twin.planning.work_plan import joined
from construction_twin.robot.description import read_robot_files
from construction_twin.robot.plan import Plan, content_hash
from construction_twin.robot.segments import Segment
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.objects import Scene, SceneObject
from construction_twin.scene.scene_yaml import read_scene
from construction_twin.scene.self_collision import read_self_collision

ROOT = Path(__file__).parents[2]
ROBOT = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
CHAIN = Chain(ROBOT)
SELF_COLLISION = read_self_collision(ROOT / "config/kr120_self_collision.yaml", ROBOT)
HOME = np.array(ROBOT.home)
RIGHT, LEFT = HOME + np.radians([-40, 10, 0, 0, 0, 0]), HOME + np.radians([40, 10, 0, 0, 0, 0])
REQUEST = PlanRequest(plan_id="p1", asked=Moment("c0ffee00", 7))
QUICK = dict(
    planner="RRTConnect",
    planning_budget=5.0,
    edge_step=0.1,
    speed_scale=1.0,
    max_waypoints=2000,
    max_duration=600.0,
    seed=1,
)
#: Between RIGHT and LEFT: the straight joint motion goes through it, the arm can go over it.
WALL = SceneObject("wall", "box", (1.6, 0.1, 1.7), (1.6, 0.0, 0.85))


class Clock:
    """Advances 1 ms a call."""

    def __init__(self):
        self.now = 0.0

    def __call__(self) -> float:
        self.now += 1e-3
        return self.now


def solver():
    return inverse_kinematics(CHAIN, IkSettings(), np.random.default_rng(0), Clock())


def planner(clock=None, **changes) -> Planner:
    settings = PlannerSettings(**(QUICK | changes))
    return Planner(ROBOT, solver(), settings, clock or Clock())


def world(*objects: SceneObject, padding: float = 0.01) -> CollisionWorld:
    return CollisionWorld(ROBOT, Scene(objects, padding), SELF_COLLISION)


def standing(held: SceneObject, q) -> SceneObject:
    """Return an object that the tool carries as it stands where it is gripped, at joint values `q`."""
    pose = world(held).object_pose(q, held.name)
    quaternion = pinocchio.Quaternion(pose.rotation).normalized().coeffs()
    return replace(held, position=tuple(pose.position.tolist()), quaternion=tuple(quaternion.tolist()), link="")


def bench_world(name: str) -> CollisionWorld:
    return CollisionWorld(ROBOT, read_scene(ROOT / "benchmarks/problems" / f"{name}.yaml"), SELF_COLLISION)


def work_plan(scenes: Sequence[Scene]) -> Plan:
    """Return a plan of fetch, carry and home through three scenes."""
    motion, ends = joined([time_path(np.array(pair), ROBOT) for pair in ((HOME, RIGHT), (RIGHT, LEFT), (LEFT, HOME))])
    hashes = [scene.hash for scene in (*scenes, scenes[2])]
    segments = tuple(
        Segment(name, end, name == "carry", (), (), *hashes[number : number + 2])
        for number, (name, end) in enumerate(zip(("fetch", "carry", "home"), ends))
    )
    made = make_plan(motion, "w1", hashes[0])
    return replace(made, hash=content_hash(motion, "t", segments), task="t", segments=segments)

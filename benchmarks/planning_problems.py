"""The planning benchmark's problems: joint vectors in three scenes, fixed in benchmarks/problems/.

`generate` made them: start and goal free of contact in random poses, by rules of the scene (see `KINDS`), each solved by
the project's planner in a long run. Joints that can turn more than once are kept within half a turn to either side,
except in the free scene.
"""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from construction_twin.core.motion_errors import NoPathError
from construction_twin.kinematics.chain import Chain
from construction_twin.planning.motion_validator import MotionValidator
from construction_twin.planning.planner import Planner, PlanRequest
from construction_twin.scene.collision_world import CollisionWorld

FOLDER = Path(__file__).parent / "problems"
SCENES = ("free", "window", "cluttered")
#: Problems per scene, and how many of them are of the hard kind: through the window, or not on a straight joint motion.
PROBLEMS = 100
HARD = {"free": 0, "window": 70, "cluttered": 80}
#: Where the tool is in front of the window's wall, and behind it [m along x]: clear of it, and through it.
NEAR, THROUGH = 1.35, 1.75
#: Step of the check whether a straight joint motion is blocked [m].
STEP = 0.02


def read(scene: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return a scene's problems: pairs of start and goal, arrays of shape (n,) [rad]."""
    with open(FOLDER / f"{scene}.csv", encoding="utf-8", newline="") as file:
        rows = np.array(list(csv.reader(file))[1:], dtype=float)
    half = rows.shape[1] // 2
    return [(row[:half], row[half:]) for row in rows]


def write(scene: str, joint_names: tuple[str, ...], problems: list[tuple[np.ndarray, np.ndarray]]) -> Path:
    """Write a scene's problems, one per row, in radians to the last bit; return the file."""
    path = FOLDER / f"{scene}.csv"
    with open(path, "w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([f"{end}_{name}_rad" for end in ("start", "goal") for name in joint_names])
        writer.writerows([*map(repr, start.tolist()), *map(repr, goal.tolist())] for start, goal in problems)
    return path


def generate(scene: str, chain: Chain, world: CollisionWorld, planner: Planner, seed: int) -> list:
    """Return `PROBLEMS` solved problems, the hard ones first; the same ones for the same seed, robot and scene."""
    draw = _Draw(scene, chain, world, np.random.default_rng([seed, SCENES.index(scene)]))
    problems = []
    while len(problems) < PROBLEMS:
        hard = len(problems) < HARD[scene]
        start, goal = draw.pair(hard)
        try:
            planner.plan_to_joints(start, goal, PlanRequest(f"{len(problems)}", 0), world)
        except NoPathError:
            continue
        problems.append((start, goal))
    return problems


class _Draw:
    def __init__(self, scene: str, chain: Chain, world: CollisionWorld, rng: np.random.Generator):
        robot = chain.robot
        half_turn = np.inf if scene == "free" else np.pi
        self._scene, self._chain, self._world, self._rng = scene, chain, world, rng
        self._lower = np.maximum(robot.lower, -half_turn)
        self._upper = np.minimum(robot.upper, half_turn)
        self._edges = MotionValidator(world, world.levers, STEP)

    def pair(self, hard: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return a free start and goal; a hard pair goes through the window, in either direction, or is not straight."""
        if self._scene == "window" and hard:
            ends = self._free(lambda x: x < NEAR), self._free(lambda x: x > THROUGH)
            return ends if self._rng.random() < 0.5 else ends[::-1]
        while True:
            start, goal = self._free(), self._free()
            if not hard or not self._edges.free(start, goal):
                return start, goal

    def _free(self, accepts=lambda x: True) -> np.ndarray:
        while True:
            q = self._rng.uniform(self._lower, self._upper)
            if accepts(self._chain.forward(q).position[0]) and self._world.is_free(q):
                return q

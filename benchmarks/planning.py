"""Planning benchmark: 100 fixed problems in each of three scenes, for the KR 120.

    python benchmarks/planning.py --output results/bench/planning.json

Per scene: success; median and 95th percentile of the time for planning and timing together, the median time of the dense re-check
after it, and median and 95th percentile of both together (`review_ms`: from the request to a plan that can be reviewed); mean
length [rad] and duration [s] of the plans; how many of them touch something at any 1 ms, by python-fcl.
"""

from __future__ import annotations

import argparse
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import yaml
from link_world import environment, write_figures

from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.planning.ompl_search import NoPathError
from construction_twin.planning.planner import Planner, PlannerSettings, PlanRequest
from construction_twin.robot.description import read_robot_files
from construction_twin.robot.plan import Plan
from construction_twin.scene.collision_world import CollisionWorld
from construction_twin.scene.scene_yaml import load_scene
from construction_twin.scene.self_collision import read_self_collision

ROOT = Path(__file__).resolve().parents[1]
#: Fixed problems, the hard ones first: through the window, or not on a straight joint motion.
PROBLEMS, SCENES = Path(__file__).parent / "problems", ("free", "window", "cluttered")
#: Time in which a problem has to be solved [s].
BUDGET = 5.0
#: Spacing of the independent check [s].
CHECK_STEP = 0.001
PACKAGES = ("numpy", "scipy", "ompl", "toppra", "pin", "coal", "python-fcl", "py-opw-kinematics")


class Bench:
    """The robot, its planner as shipped but at the full limits, and what is measured with it."""

    def __init__(self):
        self.robot = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
        self.self_collision = read_self_collision(ROOT / "config/kr120_self_collision.yaml", self.robot)
        solver = inverse_kinematics(Chain(self.robot), IkSettings(), np.random.default_rng(0), time.monotonic)
        shipped = yaml.safe_load((ROOT / "config/planner.yaml").read_text())
        settings = {key: value for key, value in shipped.items() if key in PlannerSettings.model_fields}
        settings |= {"planning_budget": BUDGET, "speed_scale": 1.0, "seed": 1}
        #: Each of them begins with the same seed.
        self._make_planner = partial(Planner, self.robot, solver, PlannerSettings(**settings), time.perf_counter)

    def scene(self, name: str) -> tuple[dict, CollisionWorld]:
        """Return a scene as parsed, and its collision world."""
        path = PROBLEMS / f"{name}.yaml"
        description = yaml.safe_load(path.read_text())
        return description, CollisionWorld(self.robot, load_scene(description, path.parent), self.self_collision)

    def measure(self, name: str, count: int) -> dict:
        """Return the figures of a scene."""
        description, world = self.scene(name)
        problems, planner = read_problems(name)[:count], self._make_planner()
        plans = [plan for plan in (solve(planner, *problem, world) for problem in problems) if plan is not None]
        if not plans:
            sys.exit(f"{name}: none of {len(problems)} problems was solved; there is nothing to measure")
        times = [plan.planning_time * 1e3 for plan in plans]
        rechecks = [plan.report.recheck_time * 1e3 for plan in plans]
        reviews = np.add(times, rechecks)
        return {
            "problems": len(problems),
            "success": len(plans) / len(problems),
            "median_ms": rounded(np.median(times)),
            "p95_ms": rounded(np.percentile(times, 95)),
            "recheck_ms": rounded(np.median(rechecks)),
            "review_ms": {"median": rounded(np.median(reviews)), "p95": rounded(np.percentile(reviews, 95))},
            "collisions": self.collisions(plans, description),
            "length": rounded(np.mean([length(plan) for plan in plans])),
            "duration": rounded(np.mean([plan.trajectory.duration for plan in plans])),
        }

    def collisions(self, plans: list[Plan], description: dict) -> int:
        """Return how many plans touch something at any millisecond, as python-fcl sees it."""
        from fcl_checker import FclChecker  # needs python-fcl, which `bench.py` installs

        checker = FclChecker(self.robot, description, set(self.self_collision.ignored))
        touching = 0
        for plan in plans:
            duration = plan.trajectory.duration
            times = np.append(np.arange(0.0, duration, CHECK_STEP), duration)
            contacts = checker.contacts(plan.trajectory.sample_many(times)[0])
            if contacts:
                row, first, second = contacts[0]
                print(f"plan {plan.id}: {first} touches {second} at {times[row]:.3f} s", file=sys.stderr)
            touching += bool(contacts)
        return touching


def read_problems(scene: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return a scene's problems: pairs of start and goal, arrays of shape (n,) [rad]."""
    rows = np.loadtxt(PROBLEMS / f"{scene}.csv", delimiter=",", skiprows=1)
    half = rows.shape[1] // 2
    return [(row[:half], row[half:]) for row in rows]


def solve(planner: Planner, start: np.ndarray, goal: np.ndarray, world: CollisionWorld) -> Plan | None:
    """Return a plan, None if none was found in time."""
    try:
        return planner.plan_to_joints(start, goal, PlanRequest("bench", 0), world)
    except NoPathError:
        return None


def length(plan: Plan) -> float:
    """Return the length of a plan's path in joint space [rad], along its waypoints."""
    return float(np.sum(np.linalg.norm(np.diff(plan.trajectory.positions, axis=0), axis=1)))


def rounded(value: float) -> float:
    """Return a figure to four significant digits."""
    return float(f"{value:.4g}")


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Planning benchmark: time, success, quality, safety.")
    parser.add_argument("--output", type=Path, default=ROOT / "results/bench/planning.json", help="file of the figures")
    parser.add_argument("--problems", type=int, default=100, help="per scene [%(default)s]")
    options = parser.parse_args()
    if options.problems < 1:
        parser.error("expected at least one problem")
    bench = Bench()
    figures = {name: bench.measure(name, options.problems) for name in SCENES}
    write_figures(options.output, figures | {"environment": environment(PACKAGES)})


if __name__ == "__main__":
    main()

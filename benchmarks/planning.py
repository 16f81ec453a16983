"""Planning benchmark: 100 fixed problems in each of three scenes, for the KR 120.

    python benchmarks/planning.py --output results/bench/planning.json

Per scene: success; median and 95th percentile of the time for planning and timing together, the median time of the
dense re-check after it, and median and 95th percentile of both together (`review_ms`: from the request to a plan that can be
reviewed), from each problem's first run; their mean length [rad] and duration [s]; how many exceed a jerk limit at any 1 ms, and by
how much of it at most; collisions found by python-fcl at every 1 ms of these plans; the
mean ratio of their joint path length to the shortest of all runs, and of their duration to the lower bound that the
limits alone set. Every run has its own seed.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
import yaml
from link_world import environment

from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.planning.ompl_search import NoPathError
from construction_twin.planning.planner import Planner, PlannerSettings, PlanRequest
from construction_twin.planning.recheck import ROUNDING
from construction_twin.planning.time_scaling import RestToRest
from construction_twin.robot.description import RobotModel, read_robot_files
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
COLUMNS = (
    "problems", "success", "median_ms", "p95_ms", "recheck_ms", "collisions", "length", "length_ratio", "duration",
    "duration_ratio",
)  # fmt: skip


def minimum_duration(start: np.ndarray, goal: np.ndarray, robot: RobotModel) -> float:
    """Return a lower bound of the duration of any motion between two poses from rest to rest [s]: of the slowest joint alone."""
    joints = zip(np.abs(goal - start).tolist(), robot.velocity, robot.acceleration, robot.jerk)
    return max(RestToRest.fastest(*joint).duration if joint[0] > 0.0 else 0.0 for joint in joints)


class Bench:
    """The robot, and what is measured with it.

    Args:
        planner: Name of an OMPL planner.
    """

    def __init__(self, planner: str):
        self.robot = read_robot_files(ROOT / "urdf/kr120r2500.urdf.xacro", ROOT / "config/kr120.yaml")
        self.chain = Chain(self.robot)
        self.self_collision = read_self_collision(ROOT / "config/kr120_self_collision.yaml", self.robot)
        self._shipped = yaml.safe_load((ROOT / "config/planner.yaml").read_text())
        self._planner = planner
        rng = np.random.default_rng(0)
        self._solver = inverse_kinematics(self.chain, IkSettings(), rng, time.monotonic)

    def scene(self, name: str) -> tuple[dict, CollisionWorld]:
        """Return a scene as parsed, and its collision world."""
        path = PROBLEMS / f"{name}.yaml"
        description = yaml.safe_load(path.read_text())
        return description, CollisionWorld(self.robot, load_scene(description, path.parent), self.self_collision)

    def planner(self, seed: int) -> Planner:
        """Return a planner as shipped, but at the full limits; its own seeds follow from this one."""
        settings = {key: value for key, value in self._shipped.items() if key in PlannerSettings.model_fields}
        settings |= {"planner": self._planner, "planning_budget": BUDGET, "speed_scale": 1.0}
        return Planner(self.robot, self._solver, PlannerSettings(**settings | {"seed": seed}), time.perf_counter)

    def measure(self, name: str, count: int, runs: int) -> dict:
        """Return the figures of a scene."""
        description, world = self.scene(name)
        problems = read_problems(name)[:count]
        planners = [self.planner(run + 1) for run in range(runs)]
        tried = [[solve(planner, *problem, world) for planner in planners] for problem in problems]
        plans = [[plan for plan in row if plan is not None] for row in tried]
        first = [row[0] for row in tried if row[0] is not None]
        if not first:
            sys.exit(f"{name}: none of {len(problems)} problems was solved; there is nothing to measure")
        times = [plan.planning_time * 1e3 for plan in first]
        ratios = [length(row[0]) / min(map(length, found)) for row, found in zip(tried, plans) if row[0] is not None]
        reviews = [1e3 * (plan.planning_time + plan.report.recheck_time) for plan in first]
        jerks = [self.jerk_usage(plan) for plan in first]
        bounds = [minimum_duration(*plan.trajectory.positions[[0, -1]], self.robot) for plan in first]
        return {
            "problems": len(problems),
            "success": sum(map(len, plans)) / (len(problems) * runs),
            "median_ms": rounded(np.median(times)),
            "p95_ms": rounded(np.percentile(times, 95)),
            "recheck_ms": rounded(np.median([plan.report.recheck_time * 1e3 for plan in first])),
            "review_ms": {"median": rounded(np.median(reviews)), "p95": rounded(np.percentile(reviews, 95))},
            "collisions": self.collisions(first, description),
            "jerk_exceeded": sum(usage > 1.0 + ROUNDING for usage in jerks),
            "jerk_usage": rounded(max(jerks)),
            "length": rounded(np.mean([length(plan) for plan in first])),
            "duration": rounded(np.mean([plan.trajectory.duration for plan in first])),
            "length_ratio": rounded(np.mean(ratios)),
            "duration_ratio": rounded(
                np.mean([plan.trajectory.duration / bound for plan, bound in zip(first, bounds)])
            ),
        }

    def jerk_usage(self, plan: Plan) -> float:
        """Return the largest fraction of a joint's jerk limit at any millisecond."""
        return float(np.max(np.abs(plan.trajectory.sample_many(milliseconds(plan))[3]) / self.robot.jerk))

    def collisions(self, plans: list[Plan], description: dict) -> int:
        """Return how many plans touch something at any millisecond, as python-fcl sees it."""
        from fcl_checker import FclChecker  # needs python-fcl, which `bench.py` installs

        checker = FclChecker(self.robot, description, set(self.self_collision.ignored))
        touching = 0
        for plan in plans:
            times = milliseconds(plan)
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


def milliseconds(plan: Plan) -> np.ndarray:
    """Return the times at which a plan is checked independently [s]."""
    return np.append(np.arange(0.0, plan.trajectory.duration, CHECK_STEP), plan.trajectory.duration)


def length(plan: Plan) -> float:
    """Return the length of a plan's path in joint space [rad], along its waypoints."""
    return float(np.sum(np.linalg.norm(np.diff(plan.trajectory.positions, axis=0), axis=1)))


def rounded(value: float) -> float:
    """Return a figure to four significant digits."""
    return float(f"{value:.4g}")


def table_row(name: str, values: dict) -> str:
    """Return a line of the printed table."""
    return f"{name:>10}" + "".join(f"{values[column]:>16}" for column in COLUMNS)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Planning benchmark: time, success, quality, safety.")
    parser.add_argument("--output", type=Path, default=ROOT / "results/bench/planning.json", help="file of the figures")
    parser.add_argument("--problems", type=int, default=100, help="per scene [%(default)s]")
    parser.add_argument("--runs", type=int, default=10, help="per problem, each with its own seed [%(default)s]")
    parser.add_argument("--planner", default="RRTConnect", help="any of OMPL's [%(default)s]")
    options = parser.parse_args()
    if options.problems < 1 or options.runs < 1:
        parser.error("expected at least one problem and one run")
    bench = Bench(options.planner)
    print(table_row("scene", {column: column for column in COLUMNS}), flush=True)
    figures = {}
    for name in SCENES:
        figures[name] = bench.measure(name, options.problems, options.runs)
        print(table_row(name, figures[name]), flush=True)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(json.dumps(figures | {"environment": environment(PACKAGES)}, indent=2) + "\n")
    print(f"written to {options.output}")


if __name__ == "__main__":
    main()

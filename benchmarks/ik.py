"""Measures inverse kinematics: `python benchmarks/ik.py --poses 10000 --seed 1 --output results/bench/ik.json`.

Every pose is the forward kinematics of joint values drawn evenly from the ranges, so it can be reached; every seed posture is
drawn the same way. Times are of one call from Python. A solution counts as solved when KDL's forward kinematics misses the pose
by no more than 1e-6 m and 1e-6 rad, within the ranges, within 50 ms.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from ik_figures import brute_force, measure, problems, share_of_nearest
from link_world import environment, write_figures

from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.robot.description import read_robot_files

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "test/support"))
from dense_search import dense_search  # noqa: E402

ROBOTS = {
    "kr120": ("urdf/kr120r2500.urdf.xacro", "config/kr120.yaml"),
    "ur_like": ("test/data/ur_like.urdf", "test/data/ur_like.yaml"),
    "track7": ("urdf/kr120_track.urdf.xacro", "config/kr120_track.yaml"),
    "panda_like": ("test/data/panda_like.urdf", "test/data/panda_like.yaml"),
}
#: A call that takes longer has not solved its task; what the search may take of it leaves room for its last step [s].
LIMIT_S, BUDGET_S = 0.05, 0.04
#: Starting points of the brute force for each pose. An arm on a linear axis is searched densely instead, which finds more in less
#: time; what the search finds for seven revolute joints is compared with nothing.
RESTARTS = 150
PACKAGES = ("numpy", "scipy", "py-opw-kinematics", "eaik")


def run(poses: int, seed: int, checks: int) -> dict:
    """Measure all robots and return the contents of the file."""
    result = {}
    for name, (urdf, description) in ROBOTS.items():
        robot = read_robot_files(ROOT / urdf, ROOT / description)
        chain = Chain(robot)
        tasks = problems(chain, poses, seed)
        inverse = inverse_kinematics(
            chain, IkSettings(budget_s=BUDGET_S), np.random.default_rng(seed), time.perf_counter
        )
        # the first calls are slower: code and data are not in the caches yet
        measure(inverse, tasks[:20], time.perf_counter)
        found = measure(inverse, tasks, time.perf_counter, LIMIT_S)
        figures = {"kind": inverse.kind.name, "poses": len(tasks), "solved": found.solved, **_spread(found.times)}
        figures |= {"residual_m": found.residual_m, "residual_rad": found.residual_rad}
        if inverse.kind.name != "search":
            on_track = inverse.kind.name == "OPW on a linear axis"
            search = dense_search(chain) if on_track else brute_force(chain, np.random.default_rng(seed + 1), RESTARTS)
            figures["nearest"] = share_of_nearest(found.distances[:checks], tasks[:checks], search)
        result[name] = figures
        print(f"[ik] {name}: {figures}", flush=True)
    return result


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description="Measures inverse kinematics.")
    parser.add_argument("--poses", type=int, default=10_000, help="targets for each robot")
    parser.add_argument("--checks", type=int, default=500, help="of them, compared with a brute force")
    parser.add_argument("--seed", type=int, default=1, help="of the targets and of the searches")
    parser.add_argument("--output", type=Path, default=ROOT / "results" / "bench" / "ik.json")
    options = parser.parse_args()
    result = run(options.poses, options.seed, options.checks)
    write_figures(options.output, result | {"environment": environment(PACKAGES) | {"seed": options.seed}})


def _spread(times: Sequence[float]) -> dict:
    median, p99 = np.percentile(times, (50, 99)) * 1e6
    return {"median_us": float(median), "p99_us": float(p99)}


if __name__ == "__main__":
    main()

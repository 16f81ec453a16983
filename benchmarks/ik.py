"""Measures inverse kinematics: `python benchmarks/ik.py --poses 10000 --seed 1 --output results/bench/ik.json`.

Every pose is the forward kinematics of joint values drawn evenly from the ranges, so it can be reached; every seed posture is
drawn the same way. TRAC-IK gets the same poses and seeds of the KR 120, in turns with ours: a block of poses by us, the same
block by TRAC-IK, and so on, because a shared machine is quicker at one minute than at another. Times are of one call from
Python; building pose and quaternion is outside of them. A solution counts as solved when KDL's forward kinematics misses the
pose by no more than 1e-6 m and 1e-6 rad, within the ranges, within 50 ms.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import platform
import sys
import time
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import PyKDL
from ik_figures import Figures, Problem, brute_force, measure, problems, share_of_nearest
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.kinematics.solution import InverseKinematics
from construction_twin.robot.description import RobotModel, read_robot_files

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
#: TRAC-IK's error bound per component of the twist, and its time [s].
TRACIK_EPSILON, TRACIK_TIMEOUT = 1e-6, 0.05
#: Starting points of the brute force for each pose. An arm on a linear axis is searched densely instead, which finds more in less
#: time; what the search finds for seven revolute joints is compared with nothing.
RESTARTS = 150
#: Poses of a block, of which ours and TRAC-IK take turns.
BLOCK = 250
PACKAGES = ("numpy", "scipy", "py-opw-kinematics", "eaik", "pytracik")


class TracIk:
    """TRAC-IK, mode Speed, with times and its own verdicts."""

    def __init__(self, robot: RobotModel):
        import pytracik  # only the benchmark needs it

        self._package = pytracik
        self._solver = pytracik.TRAC_IK(
            robot.base_link, robot.tip_link, robot.urdf, TRACIK_TIMEOUT, TRACIK_EPSILON, pytracik.SolveType.Speed
        )
        #: Of every call [s].
        self.times: list[float] = []
        self._solved = 0

    def solve(self, tasks: Sequence[Problem]) -> None:
        """Solve tasks, one call each."""
        ik = self._package.ik
        for task in tasks:
            near, position = task.seed.tolist(), task.pose.position.tolist()
            quaternion = Rotation.from_matrix(task.pose.rotation).as_quat().tolist()
            began = time.perf_counter()
            answer = ik(self._solver, near, *position, *quaternion)
            self.times.append(time.perf_counter() - began)
            # the first number is KDL's return code: negative if there is no solution
            self._solved += int(answer[0] >= 0.0)

    @property
    def figures(self) -> dict:
        """What it solved, and how fast."""
        return {"solved": self._solved / len(self.times), **_spread(self.times)}


def in_turns(inverse: InverseKinematics, tasks: Sequence[Problem], tracik: TracIk | None) -> Figures:
    """Return our figures of all tasks; after each block of them TRAC-IK solves the same block."""
    parts = []
    for first in range(0, len(tasks), BLOCK):
        block = tasks[first : first + BLOCK]
        parts.append(measure(inverse, block, time.perf_counter, LIMIT_S))
        if tracik is not None:
            tracik.solve(block)
    return Figures(
        tuple(each for part in parts for each in part.times),
        tuple(each for part in parts for each in part.distances),
        max(part.residual_m for part in parts),
        max(part.residual_rad for part in parts),
    )


def run(poses: int, seed: int, checks: int, tracik: bool) -> dict:
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
        beside = TracIk(robot) if tracik and name == "kr120" else None
        found = in_turns(inverse, tasks, beside)
        figures = {"kind": inverse.kind.name, "poses": len(tasks), "solved": found.solved, **_spread(found.times)}
        figures |= {"residual_m": found.residual_m, "residual_rad": found.residual_rad}
        if inverse.kind.name != "search":
            on_track = inverse.kind.name == "OPW on a linear axis"
            search = dense_search(chain) if on_track else brute_force(chain, np.random.default_rng(seed + 1), RESTARTS)
            figures["nearest"] = share_of_nearest(found.distances[:checks], tasks[:checks], search)
        result[name] = figures
        if beside is not None:
            result["tracik_speed"] = beside.figures
    return result | {"environment": environment(seed, checks)}


def environment(seed: int, checks: int) -> dict:
    """Return where and how it was measured."""
    return {
        "cpu": _cpu(),
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in PACKAGES} | {"pykdl": PyKDL.__version__},
        "seed": seed,
        "nearest_checked": {"6 joints": checks, "on a linear axis": checks},
        "tracik": {"solver": "Speed", "epsilon": TRACIK_EPSILON, "timeout_s": TRACIK_TIMEOUT},
    }


def show(result: dict, console: Console) -> None:
    """Print the figures as a table."""
    table = Table(title="Inverse kinematics, one call from Python")
    for column in ("", "poses", "solved", "median", "p99", "nearest", "largest residual"):
        table.add_column(column, justify="left" if not column else "right")
    for name, figures in result.items():
        if name != "environment":
            times = (f"{figures[key]:,.0f} us" for key in ("median_us", "p99_us"))
            nearest = f"{figures['nearest']:.2%}" if "nearest" in figures else ""
            errors = (
                f"{figures['residual_m']:.1e} m, {figures['residual_rad']:.1e} rad" if "residual_m" in figures else ""
            )
            table.add_row(name, str(figures.get("poses", "")), f"{figures['solved']:.2%}", *times, nearest, errors)
    console.print(table)
    if "tracik_speed" in result:
        ratio = result["kr120"]["median_us"] / result["tracik_speed"]["median_us"]
        console.print(f"kr120 median is {ratio:.2f} of TRAC-IK Speed's")


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure, write the file, print the table."""
    parser = argparse.ArgumentParser(description="Measures inverse kinematics beside TRAC-IK.")
    parser.add_argument("--poses", type=int, default=10_000, help="targets for each robot")
    parser.add_argument("--checks", type=int, default=500, help="of them, compared with a brute force")
    parser.add_argument("--seed", type=int, default=1, help="of the targets and of the searches")
    parser.add_argument("--output", type=Path, default=ROOT / "results" / "bench" / "ik.json")
    parser.add_argument("--no-tracik", action="store_true", help="leave TRAC-IK out")
    options = parser.parse_args(arguments)
    if not options.no_tracik and importlib.util.find_spec("pytracik") is None:
        parser.error("pytracik is not installed: pip install -r setup/bench-requirements.txt, or give --no-tracik")
    result = run(options.poses, options.seed, options.checks, not options.no_tracik)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(json.dumps(result, indent=2) + "\n")
    show(result, Console())
    print(f"written to {options.output}")


def _spread(times: Sequence[float]) -> dict:
    median, p99 = np.percentile(times, (50, 99)) * 1e6
    return {"median_us": float(median), "p99_us": float(p99)}


def _version(name: str) -> str | None:
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def _cpu() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{names[0] if names else platform.processor()}, {len(names)} cores"


if __name__ == "__main__":
    main()

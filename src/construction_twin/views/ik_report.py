"""Tells how the inverse kinematics of an arm is solved, why so, and how well: ``ik_report my.urdf my.yaml``. Needs no ROS."""

from __future__ import annotations

import argparse
import math
import sys
import time
from collections.abc import Callable, Sequence

import numpy as np

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.figures import brute_force, deep_search, measure, problems, share_of_nearest
from construction_twin.kinematics.inverse import IkSettings, inverse_kinematics
from construction_twin.robot.description import RobotModel, read_robot_files

#: Poses solved, and of them compared with a brute force, by default; the seed of their random numbers.
_POSES, _COMPARED, _SEED = 1000, 20, 1
#: What the search may take for one pose; and starting points and time of the brute force for one pose [s].
_BUDGET_S, _RESTARTS, _DEEP_S = 0.04, 150, 1.0
#: What each kind means for whoever plans.
_MEANS = {
    "OPW": "every branch is computed, configurations have names (front, up, positive ...), errors name the cause",
    "closed form": "every branch is computed, errors name the cause; configurations have no names",
    "OPW on a linear axis": "every branch is computed at many places of the axis, configurations have names",
    "one redundant joint": "the free joint is chosen near the present pose and, in a plan, clear of contacts; the rest is computed",
    "search": "solutions are searched for `ik_budget`; what is not found may still be reachable",
}


def report(robot: RobotModel, poses: int, compared: int, seed: int, clock: Callable[[], float]) -> list[str]:
    """Return the lines of the report.

    Args:
        poses: Random reachable poses to solve.
        compared: How many of them are compared with a brute force, at most `poses`; takes about a second each for a redundant arm.
        seed: Of the random numbers.
        clock: Returns the present time [s], e.g. ``time.perf_counter``.
    """
    chain = Chain(robot)
    inverse = inverse_kinematics(chain, IkSettings(budget_s=_BUDGET_S), np.random.default_rng(seed), clock)
    tasks = problems(chain, poses, seed)
    measure(inverse, tasks[:20], clock)  # the first calls are slower
    figures = measure(inverse, tasks, clock)
    rng = np.random.default_rng(seed + 1)
    redundant = len(robot.joint_names) > 6
    search = deep_search(chain, rng, clock, _DEEP_S) if redundant else brute_force(chain, rng, _RESTARTS)
    nearest = share_of_nearest(figures.distances[:compared], tasks[:compared], search)
    solved = sum(math.isfinite(distance) for distance in figures.distances)
    lines = [
        f"{robot.name}: {inverse.kind.name}, because {inverse.kind.why}",
        f"means     {_MEANS[inverse.kind.name]}",
        f"solved    {solved} of {poses} reachable poses ({figures.solved:.2%})",
        f"time      median {figures.percentile_us(50):,.0f} us, p99 {figures.percentile_us(99):,.0f} us",
        f"residual  at most {figures.residual_m:.1e} m, {figures.residual_rad:.1e} rad",
    ]
    if math.isfinite(nearest):
        lines.insert(3, f"nearest   {nearest:.2%} of {min(compared, poses)} compared with a brute force")
    return lines


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the arm's files and print the report."""
    parser = argparse.ArgumentParser(
        prog="ik_report", description="Tell how the inverse kinematics of an arm is solved, why so, and how well."
    )
    parser.add_argument("urdf", help="URDF, or xacro with default arguments")
    parser.add_argument("robot", help="robot YAML, e.g. config/kr120.yaml")
    parser.add_argument("--poses", type=int, default=_POSES, help="random reachable poses to solve [%(default)s]")
    parser.add_argument(
        "--compared", type=int, default=_COMPARED, help="of them, compared with a brute force; 0: none [%(default)s]"
    )
    parser.add_argument("--seed", type=int, default=_SEED, help="seed of the random numbers [%(default)s]")
    options = parser.parse_args(arguments)
    if options.poses < 1 or options.compared < 0 or options.seed < 0:
        sys.exit(
            f"ik_report: found {options.poses} poses, {options.compared} compared, seed {options.seed}; expected 1 or more, "
            "0 or more, 0 or more"
        )
    try:
        robot = read_robot_files(options.urdf, options.robot)
        lines = report(robot, options.poses, options.compared, options.seed, time.perf_counter)
    except ConstructionTwinError as error:
        sys.exit(f"ik_report: {error}")
    print("\n".join(lines))

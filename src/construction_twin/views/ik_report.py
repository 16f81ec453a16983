"""Tells how the inverse kinematics of an arm is solved, why so, and how well: ``ik_report my.urdf my.yaml``. Needs no ROS."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence

import numpy as np

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.motion_errors import KinematicsError
from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.inverse import IkSettings, IkSolution, InverseKinematics, inverse_kinematics
from construction_twin.robot.description import RobotModel, read_robot_files

#: Poses solved, by default; the seed of their random numbers.
_POSES, _SEED = 1000, 1
#: What the search may take for one pose [s].
_BUDGET_S = 0.04
#: What each kind means for whoever plans.
_MEANS = {
    "OPW": "every branch is computed, configurations have names (front, up, positive ...), errors name the cause",
    "closed form": "every branch is computed, errors name the cause; configurations have no names",
    "OPW on a linear axis": "every branch is computed at many places of the axis, configurations have names",
    "search": "solutions are searched for `ik_budget`; what is not found may still be reachable",
}


def report(robot: RobotModel, poses: int, seed: int, clock: Callable[[], float]) -> list[str]:
    """Return the lines of the report.

    Args:
        poses: Random reachable poses to solve, each from a random seed posture.
        seed: Of the random numbers.
        clock: Returns the present time [s], e.g. ``time.perf_counter``.
    """
    chain = Chain(robot)
    inverse = inverse_kinematics(chain, IkSettings(budget_s=_BUDGET_S), np.random.default_rng(seed), clock)
    draws = np.random.default_rng(seed).uniform(robot.lower, robot.upper, (poses, 2, len(robot.lower)))
    tasks = [(chain.forward(q), near) for q, near in draws]
    for pose, near in tasks[:20]:  # the first calls are slower
        _solved(inverse, pose, near)
    times, found = [], []
    for pose, near in tasks:
        began = clock()
        solution = _solved(inverse, pose, near)
        times.append(clock() - began)
        if solution is not None:
            found.append(solution)
    median, p99 = np.percentile(times, (50, 99)) * 1e6
    worst_m = max((one.residual_m for one in found), default=0.0)
    worst_rad = max((one.residual_rad for one in found), default=0.0)
    return [
        f"{robot.name}: {inverse.kind.name}, because {inverse.kind.why}",
        f"means     {_MEANS[inverse.kind.name]}",
        f"solved    {len(found)} of {poses} reachable poses ({len(found) / poses:.2%})",
        f"time      median {median:,.0f} us, p99 {p99:,.0f} us",
        f"residual  at most {worst_m:.1e} m, {worst_rad:.1e} rad",
    ]


def _solved(inverse: InverseKinematics, pose: Pose, near: np.ndarray) -> IkSolution | None:
    try:
        return inverse.nearest(pose, near)
    except KinematicsError:
        return None


def main(arguments: Sequence[str] | None = None) -> None:
    """Read the arm's files and print the report."""
    parser = argparse.ArgumentParser(
        prog="ik_report", description="Tell how the inverse kinematics of an arm is solved, why so, and how well."
    )
    parser.add_argument("urdf", help="URDF, or xacro with default arguments")
    parser.add_argument("robot", help="robot YAML, e.g. config/kr120.yaml")
    parser.add_argument("--poses", type=int, default=_POSES, help="random reachable poses to solve [%(default)s]")
    parser.add_argument("--seed", type=int, default=_SEED, help="seed of the random numbers [%(default)s]")
    options = parser.parse_args(arguments)
    if options.poses < 1 or options.seed < 0:
        sys.exit(f"ik_report: found {options.poses} poses, seed {options.seed}; expected 1 or more, 0 or more")
    try:
        robot = read_robot_files(options.urdf, options.robot)
        lines = report(robot, options.poses, options.seed, time.perf_counter)
    except ConstructionTwinError as error:
        sys.exit(f"ik_report: {error}")
    print("\n".join(lines))

"""How well an arm's inverse kinematics works: solved, nearest and time, over random reachable poses.

Every pose is the forward kinematics of joint values drawn evenly from the ranges, so it can be reached; every seed posture is
drawn the same way. Lengths [m], angles [rad], times [s].
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import PyKDL

from construction_twin.kinematics.chain import Chain, Pose, to_frame
from construction_twin.kinematics.solution import InverseKinematics, refine, residual
from construction_twin.robot.motion_errors import KinematicsError

#: A solution counts as the nearest unless the brute force finds one nearer by more than this: KDL's solver leaves that much
#: in the joints where the wrist is almost singular [rad].
NEARER = 1e-4
#: What a solution of the brute force may miss the pose by [m], [rad].
EXACT = 1e-11


@dataclass(frozen=True, eq=False)
class Problem:
    """One target and the seed posture to solve it from."""

    pose: Pose
    seed: np.ndarray


@dataclass(frozen=True)
class Figures:
    """What was measured.

    Attributes:
        times: Of each call [s].
        distances: Of each solution from its seed; nan: not solved.
        residual_m, residual_rad: Largest of all solutions.
    """

    times: tuple[float, ...]
    distances: tuple[float, ...]
    residual_m: float
    residual_rad: float

    @property
    def solved(self) -> float:
        """Fraction of the poses that were solved."""
        return float(np.isfinite(self.distances).mean())


def problems(chain: Chain, count: int, seed: int) -> list[Problem]:
    """Return reachable targets, the same for the same seed."""
    robot = chain.robot
    draws = np.random.default_rng(seed).uniform(robot.lower, robot.upper, (count, 2, len(robot.lower)))
    return [Problem(chain.forward(q), near) for q, near in draws]


def measure(
    inverse: InverseKinematics, tasks: Sequence[Problem], clock: Callable[[], float], limit_s: float = math.inf
) -> Figures:
    """Solve all tasks by `nearest`.

    Args:
        clock: Returns the present time [s], e.g. ``time.perf_counter``.
        limit_s: A call that takes longer has not solved its task [s].

    Returns:
        A task counts as solved when KDL's forward kinematics misses the pose by no more than the settings' tolerances, within the
        ranges.

    Raises:
        JointRangeError: If a solution is out of range.
    """
    settings = inverse.settings
    times, distances = [], []
    worst_m = worst_rad = 0.0
    for task in tasks:
        began = clock()
        try:
            found = inverse.nearest(task.pose, task.seed)
        except KinematicsError:
            found = None
        times.append(clock() - began)
        distances.append(math.nan)
        if found is not None and times[-1] <= limit_s:
            inverse.chain.robot.check_range(found.q)
            error_m, error_rad = residual(inverse.chain, found.q, task.pose)
            worst_m, worst_rad = max(worst_m, error_m), max(worst_rad, error_rad)
            if error_m <= settings.tolerance_m and error_rad <= settings.tolerance_rad:
                distances[-1] = float(np.linalg.norm(found.q - task.seed))
    return Figures(tuple(times), tuple(distances), worst_m, worst_rad)


def share_of_nearest(
    distances: Sequence[float], tasks: Sequence[Problem], brute_force: Callable[[Problem], float]
) -> float:
    """Return the fraction of solved tasks for which a brute force finds nothing nearer; nan without any."""
    solved = [(distance, task) for distance, task in zip(distances, tasks) if math.isfinite(distance)]
    nearest = [distance <= brute_force(task) + NEARER for distance, task in solved]
    return float(np.mean(nearest)) if nearest else math.nan


def brute_force(chain: Chain, rng: np.random.Generator, restarts: int) -> Callable[[Problem], float]:
    """Return a search for the distance of the nearest solution: KDL's solver from many postures, with every whole turn.

    Shares with a closed form KDL's forward kinematics and Jacobian, `refine`, which takes the last Newton steps to an exact
    solution, and `residual`, which confirms it. Where solutions are, it finds out by itself. Not for redundant arms.
    """
    robot = chain.robot
    lower, upper = np.array(robot.lower), np.array(robot.upper)
    solver = PyKDL.ChainIkSolverPos_LMA(chain.kdl, 1e-10, 200, 1e-14)
    start, end = PyKDL.JntArray(len(lower)), PyKDL.JntArray(len(lower))
    turns = 2.0 * math.pi * np.arange(-3, 4)[:, None]

    def search(task: Problem) -> float:
        target, best = to_frame(task.pose), math.inf
        for posture in [task.seed, *rng.uniform(lower, upper, (restarts, len(lower)))]:
            for joint, value in enumerate(posture.tolist()):
                start[joint] = value
            solver.CartToJnt(start, target, end)
            q = np.array([end[joint] for joint in range(len(lower))])
            q = q - 2.0 * math.pi * np.rint(q / (2.0 * math.pi))
            choices = q + turns
            apart = np.abs(choices - task.seed)
            apart[(choices < lower) | (choices > upper)] = math.inf
            if np.linalg.norm(apart.min(axis=0)) < best:
                # within the tolerance of an almost singular pose there are joint values far from any exact solution
                q = refine(chain, np.take_along_axis(choices, apart.argmin(axis=0)[None], axis=0)[0], task.pose)
                if max(residual(chain, q, task.pose)) <= EXACT:
                    best = min(best, float(np.linalg.norm(q - task.seed)))
        return best

    return search

"""An independent check of `rail`: the nearest solution of an arm on a linear axis, by brute force over the carriage's positions.

Slow, and simple on purpose: nothing is known of how joints move from one position to the next.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from ik_figures import Problem

from construction_twin.kinematics.chain import Chain
from construction_twin.kinematics.closed_form import ClosedFormInverse
from construction_twin.kinematics.rail import find_rail
from construction_twin.kinematics.solution import IkSettings, residual

#: Positions along the axis, and parts into which what lies between two of them is divided, again and again, this often.
_POSITIONS, _PARTS, _DEPTH = 4001, 24, 5
#: Between two positions, the distance may be less than at both by this where it runs smoothly, for each metre between them [rad/m].
_STEEP = 30.0
#: Where it changes by more between two positions, or a branch or a range ends, it may be anything between them [rad].
_JUMP = 0.1
#: What a solution may miss the pose by [m], [rad].
_EXACT = 1e-6
_TURNS = 2.0 * math.pi * np.arange(-2, 3)[:, None, None, None]


def dense_search(chain: Chain) -> Callable[[Problem], float]:
    """Return a search for the distance of the nearest solution of an arm of the OPW kind on a linear axis.

    The arm's closed form is solved at thousands of positions, with every whole turn. Around each local minimum of each branch, and
    where a branch or a range ends or a joint jumps, what lies between two positions is divided until they are less than a nanometre
    apart.

    Raises:
        ValueError: If the chain is no such arm.
    """
    found = find_rail(chain)
    if isinstance(found, str):
        raise ValueError(f"the arm is not one of the OPW kind on a linear axis: {found}")
    carriage, model = found
    arm = ClosedFormInverse(carriage.arm, model, IkSettings())
    lower, upper = np.array(chain.robot.lower), np.array(chain.robot.upper)
    even = np.linspace(lower[0], upper[0], _POSITIONS)

    def solve(task: Problem, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return joint values, shape (m, 8, 7), and their distances from the seed, shape (m, 8); inf: none in range."""
        first, second = (arm.flange(carriage.target_from_carriage(task.pose, position)) for position in (0.0, 1.0))
        flanges = first + positions[:, None, None] * (second - first)
        q = np.concatenate(
            [np.broadcast_to(positions[:, None, None], (len(positions), 8, 1)), arm.branches(flanges).q], axis=2
        )
        choices = q[..., 1:] + _TURNS
        away = np.abs(choices - task.seed[1:])
        # a joint that is out of range by rounding is at the end of its range
        away[(choices < lower[1:] - 1e-9) | (choices > upper[1:] + 1e-9)] = math.inf
        away[np.isnan(away)] = math.inf
        chosen = away.argmin(axis=0)[None]
        q[..., 1:] = np.take_along_axis(choices, chosen, axis=0)[0]
        joints = np.take_along_axis(away, chosen, axis=0)[0]
        return q, np.sqrt((positions[:, None] - task.seed[0]) ** 2 + (joints**2).sum(axis=2))

    def search(task: Problem) -> float:
        best = math.inf

        def look(positions: np.ndarray, slots: list[int], depth: int) -> None:
            nonlocal best
            q, distances = solve(task, positions)
            for slot in slots:
                own = distances[:, slot]
                for row in own.argsort()[:3]:
                    if own[row] < best:
                        joints = np.clip(q[row, slot], lower, upper)
                        if max(residual(chain, joints, task.pose)) <= _EXACT:
                            best = float(np.linalg.norm(joints - task.seed))
                        break
            if depth == _DEPTH:
                return
            for slot in slots:
                own = distances[:, slot]
                least = np.minimum(own[1:], own[:-1])
                known = np.isfinite(least)
                wild = known & ~(
                    np.abs(np.subtract(own[1:], own[:-1], where=known, out=np.full(len(least), math.nan))) < _JUMP
                )
                joints = q[:, slot, 1:]
                wild |= known & (np.abs(np.diff(joints, axis=0)).max(axis=1) > _JUMP)
                # where a branch ends it may be in range only within the last bit
                ends = np.isnan(joints[1:, 0]) != np.isnan(joints[:-1, 0])
                wild |= ends
                least[ends] = -math.inf
                padded = np.concatenate([[math.inf], own, [math.inf]])
                lowest = (padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:]) & np.isfinite(own)
                smooth = (lowest[1:] | lowest[:-1]) & (least < best + _STEEP * (positions[1] - positions[0]))
                for row in np.flatnonzero(wild | smooth):
                    if least[row] < best + (7.0 if wild[row] else _STEEP * (positions[1] - positions[0])):
                        look(np.linspace(positions[row], positions[row + 1], _PARTS + 1), [slot], depth + 1)

        look(np.unique(np.append(even, task.seed[0])), list(range(8)), 0)
        return best

    return search

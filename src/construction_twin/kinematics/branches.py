"""From the branches of a closed form, known up to whole turns, to solutions: ranges, the nearest to a seed, confirmed by KDL."""

from __future__ import annotations

import abc
import math
from collections.abc import Sequence

import numpy as np

from construction_twin.kinematics.chain import Chain, Pose
from construction_twin.kinematics.solution import (
    TURN,
    Configuration,
    IkSettings,
    IkSolution,
    InverseKinematics,
    OrientationError,
    PoseRangeError,
    PositionRangeError,
)
from construction_twin.robot.description import JointValues

_HALF_TURN = 0.5 * TURN


class BranchInverse(InverseKinematics, abc.ABC):
    """What all inverse kinematics of revolute joints in closed form share."""

    def __init__(self, chain: Chain, settings: IkSettings):
        super().__init__(chain, settings)
        slack = settings.tolerance_rad
        ranges = [(joint, lower - slack, upper + slack) for joint, (lower, upper) in enumerate(self._ends)]
        self._narrow_first = sorted(ranges, key=lambda bounds: bounds[2] - bounds[1])

    def nearest_branch(
        self, branches: Sequence[Sequence[float]], seed: JointValues
    ) -> tuple[int, float, list[float]] | None:
        """Return index, squared distance and joint values of the in-range branch nearest to a seed; None: all are out of range."""
        least, nearest = math.inf, None
        # Plain floats in one loop, and the joint with the narrowest range first: most branches fail at the first or second joint,
        # and one further away than the nearest so far need not be known to its end.
        for number, branch in enumerate(branches):
            square, q = 0.0, list(branch)
            for joint, lower, upper in self._narrow_first:
                value, near = q[joint], seed[joint]
                away = near - value
                if not -_HALF_TURN <= away <= _HALF_TURN:
                    if away != away:  # nan
                        break
                    value += TURN * round(away / TURN)
                # the seed is in range, so besides the nearest turn only the next one towards the range can be in it
                if value > upper:
                    value -= TURN
                elif value < lower:
                    value += TURN
                if not lower <= value <= upper:
                    break
                away = value - near
                square += away * away
                if square >= least:
                    break
                q[joint] = value
            else:
                least, nearest = square, (number, square, q)
        return nearest

    def excess(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return branches, shape (m, n), turned towards the middle of the ranges, and by how much each joint is out of range."""
        lower, upper = self.ranges.lower, self.ranges.upper
        middle = 0.5 * (lower + upper)
        q = rows - TURN * np.rint((rows - middle) / TURN)
        return q, np.maximum(lower - q, q - upper)

    def range_error(self, joint: int, value: float, placed: bool) -> PoseRangeError:
        """Return the error of a joint out of range; `placed`: the position could be reached, in another orientation."""
        robot, kind = self.chain.robot, OrientationError if placed else PositionRangeError
        return kind(robot.joint_names[joint], value, robot.lower[joint], robot.upper[joint], robot.linear[joint])

    def nearest_confirmed(
        self,
        branches: Sequence[Sequence[float]],
        pose: Pose,
        seed: JointValues,
        configurations: Sequence[Configuration | None],
    ) -> IkSolution | None:
        """Return the nearest of the branches that forward kinematics confirms, or None."""
        left, kinds = list(branches), list(configurations)
        while True:
            nearest = self.nearest_branch(left, seed)
            if nearest is None:
                return None
            number, _, q = nearest
            # almost always the first one is confirmed
            solution = self.confirmed(q, pose, seed, kinds[number])
            if solution is not None:
                return solution
            del left[number], kinds[number]

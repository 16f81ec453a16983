"""The ranges of an arm's joints, and whole turns: a revolute joint reaches the same pose a turn further, where its range allows it.

Joint values [rad], or [m] for a prismatic joint, which has no turns.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import product

import numpy as np

from construction_twin.robot.description import RobotModel

#: One turn [rad].
TURN = 2.0 * math.pi


class Ranges:
    """The ranges of n joints.

    Attributes:
        lower, upper: Shape (n,). Ends of the ranges.
        turns: Shape (n,). A whole turn; 0 for a prismatic joint.
    """

    def __init__(self, robot: RobotModel):
        self.lower, self.upper = np.array(robot.lower), np.array(robot.upper)
        self.turns = np.where(robot.linear, 0.0, TURN)
        # plain floats, which a loop over the joints takes
        self._each = list(zip(robot.lower, robot.upper, self.turns.tolist()))

    def into_range(self, q: np.ndarray, seed: np.ndarray, slack: float) -> np.ndarray:
        """Return joint values, shape (..., n), with the turns nearest to a seed that are within the ranges, or else nearest to it.

        Args:
            seed: Shape (n,). Within the ranges: so besides the nearest turn only the next one towards the range can be in it.
            slack: Out of range by no more than this counts as within.
        """
        q = q - self.turns * np.rint((q - seed) * (1.0 / TURN))
        q = np.where((q > self.upper + slack) & (q - self.turns >= self.lower - slack), q - self.turns, q)
        return np.where((q < self.lower - slack) & (q + self.turns <= self.upper + slack), q + self.turns, q)

    def excesses(self, q: np.ndarray) -> np.ndarray:
        """Return by how much each joint is out of range, shape (..., n); 0 or less: it is in range."""
        return np.maximum(self.lower - q, q - self.upper)

    def turned(self, q: Sequence[float], slack: float, kept: Sequence[int] = ()) -> Iterator[tuple[float, ...]]:
        """Return joint values with every choice of whole turns within the ranges.

        Args:
            q: Length n
            kept: Joints that keep the turns they have.
        """
        choices: list[list[float]] = []
        for joint, (value, (lower, upper, turn)) in enumerate(zip(q, self._each)):
            if joint in kept or not turn:
                choices.append([value])
                continue
            first, last = math.ceil((lower - slack - value) / turn), math.floor((upper + slack - value) / turn)
            choices.append([value + turn * number for number in range(first, last + 1)])
        return product(*choices)

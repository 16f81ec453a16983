"""What finds a path: from a start, goals and what must not be touched to a polyline, behind one interface.

Timing, rounding of corners and the re-check of the finished motion are done outside, alike for every search (`planner.Planner`).
So no search need be trusted: a path of it that touches something, or that leaves the ranges, becomes no plan. The searches that
there are: `path_searches`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from construction_twin.planning.motion_validator import MotionValidator


@dataclass(frozen=True)
class PathQuery:
    """What a path is sought for. Joint vectors are in the order of `RobotModel.joint_names` [rad] or [m].

    Attributes:
        start: Shape (n,). Free, within the bounds.
        goals: Each of shape (n,). At least one, the nearest first; each free and within the bounds. The path may end at any of
            them.
        validator: Says whether a straight edge is free; its `world` whether a pose is.
        lower, upper: Shape (n,). Lowest and highest joint values that a path may have.
        seed: Of everything that a search draws by chance, 1 to 2**32 - 1: the same query, with a new validator, gives the same
            path, unless the search improves its path until the budget is over.
    """

    start: np.ndarray
    goals: Sequence[np.ndarray]
    validator: MotionValidator
    lower: np.ndarray
    upper: np.ndarray
    seed: int


class PathSearch(Protocol):
    """A planner of paths."""

    @property
    def name(self) -> str:
        """As in the planner's settings and in the plans that it made."""
        ...

    def find(self, query: PathQuery, budget: float) -> np.ndarray:
        """Find a path from the start to one of the goals.

        Args:
            budget: Time for it [s]; shortening what was found may come on top.

        Returns:
            Shape (m, n). At least two points, none like the one before; the first is the start and the last a goal, both to the
            last bit. The straight edges between them are free by the query's validator.

        Raises:
            NoPathError: If none was found within the budget.
        """
        ...

"""What the monitor must know of the plans to ask for a new one: where they go, and how fast they were approved to be.

Pure. Angles in rad, m for linear joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

#: Plans remembered besides the one that was played last.
KEPT = 20


@dataclass(frozen=True)
class ReplanGoal:
    """Goal and pace of a plan.

    Attributes
    ----------
    plan_id : str
    goal : tuple, shape (n,)
        [rad]
    speed_scale, acceleration_scale : float
        Largest share of the limits that the plan uses, at most 1; 0 for a plan that stands still.
    """

    plan_id: str
    goal: tuple[float, ...]
    speed_scale: float
    acceleration_scale: float


class ReplanGoals:
    """Goals of the newest plans, and of the one that was played last, however old."""

    def __init__(self):
        self._goals: dict[str, ReplanGoal] = {}
        self._played, self._playing = "", False

    def on_plan(
        self, plan_id: str, goal: Sequence[float], velocity_use: Sequence[float], acceleration_use: Sequence[float]
    ) -> None:
        """Take a plan that was offered; its use of the limits per joint, as measured by the planner."""
        shares = (min(1.0, max(use, default=0.0)) for use in (velocity_use, acceleration_use))
        self._goals[plan_id] = ReplanGoal(plan_id, tuple(goal), *shares)
        old = [known for known in self._goals if known not in (self._played, plan_id)]
        for known in old[: max(len(old) - KEPT, 0)]:
            del self._goals[known]

    def on_execution(self, plan_id: str, playing: bool) -> None:
        """Take what the executor does: whether it plays that plan, and nobody has told it to stop or to pause."""
        self._played, self._playing = plan_id, playing

    @property
    def interrupted(self) -> ReplanGoal | None:
        """Goal to plan to when the gate closes now.

        None when nothing plays: what a person stops or pauses is not taken up by itself, and with `auto_approve` a new plan would
        be. Nor is a plan that stands still, whose shares the planner would read as its defaults.
        """
        found = self._goals.get(self._played) if self._playing else None
        return found if found is not None and found.speed_scale > 0.0 and found.acceleration_scale > 0.0 else None

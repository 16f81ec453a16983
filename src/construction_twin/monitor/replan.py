"""What the monitor must know of the plans to ask for a new one: where they go, and how fast they were approved to be.

Pure. Angles in rad, m for prismatic joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

#: Plans remembered besides the one that was played last.
KEPT = 20


@dataclass(frozen=True)
class ReplanGoal:
    """Goal and pace of a plan.

    Attributes:
        goal: Shape (n,). [rad]
        speed_scale, acceleration_scale: Largest fraction of the limits that the plan uses, at most 1; 0 for a plan that stands
            still.
        seen: The robot's clock when the executor was last known to play it; empty: never. A plan that a person stopped later must
            not be taken up again.
    """

    plan_id: str
    goal: tuple[float, ...]
    speed_scale: float
    acceleration_scale: float
    seen: str = ""


@dataclass(frozen=True)
class Played:
    """What the executor did when it was last heard.

    Attributes:
        playing: It played that plan, and was not told to stop or to pause.
        moment: By the robot's clock.
    """

    plan_id: str = ""
    playing: bool = False
    moment: str = ""


class ReplanGoals:
    """Goals of the newest plans, and of the one that was played last, of any age."""

    def __init__(self):
        self._goals: dict[str, ReplanGoal] = {}
        # one value, stored and read at once: the executor's reports come in a thread of their own
        self._execution = Played()

    def on_plan(
        self, plan_id: str, goal: Sequence[float], velocity_use: Sequence[float], acceleration_use: Sequence[float]
    ) -> None:
        """Take a plan that was offered; its use of the limits per joint, as measured by the planner."""
        speed, acceleration = (min(1.0, max(use, default=0.0)) for use in (velocity_use, acceleration_use))
        self._goals[plan_id] = ReplanGoal(plan_id, tuple(goal), speed, acceleration)
        played = self._execution.plan_id
        old = [known for known in self._goals if known not in (played, plan_id)]
        for known in old[: max(len(old) - KEPT, 0)]:
            del self._goals[known]

    def on_execution(self, plan_id: str, playing: bool, moment: str) -> None:
        """Take what the executor did at a moment: whether it played that plan, and was not told to stop or to pause."""
        self._execution = Played(plan_id, playing, moment)

    @property
    def interrupted(self) -> ReplanGoal | None:
        """Goal to plan to when the gate closes now.

        None when nothing plays: what a person stops or pauses is not taken up by itself, and with `auto_approve` a new plan would
        be. Nor is a plan that stands still, whose fractions the planner would read as its defaults.
        """
        played = self._execution
        found = self._goals.get(played.plan_id) if played.playing else None
        if found is None or found.speed_scale <= 0.0 or found.acceleration_scale <= 0.0:
            return None
        return replace(found, seen=played.moment)

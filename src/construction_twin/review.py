"""Review: which plan lies on the desk, and what was decided about it. Pure."""

from __future__ import annotations

from dataclasses import dataclass

from construction_twin.errors import ReviewError
from construction_twin.plan import Plan


@dataclass(frozen=True)
class Verdict:
    """What was decided about a plan, by whom and why."""

    plan_id: str
    plan_hash: str
    approved: bool
    reviewer: str
    reason: str


class ReviewDesk:
    """Holds the newest plan until it is approved, rejected or replaced. An approval covers one execution of one plan."""

    def __init__(self):
        self.plan: Plan | None = None
        self._decided: set[str] = set()
        self._void_before = 0

    def offer(self, plan: Plan) -> None:
        """Put a plan on the desk in place of the one before, unless it was decided already.

        Raises
        ------
        ReviewError
            When it does not start and end at rest, or was asked for before the desk was last voided. (That a plan's hash is that
            of its content is the Plan's own matter.)
        """
        trajectory = plan.trajectory
        if any(rows[end].any() for rows in (trajectory.velocities, trajectory.accelerations) for end in (0, -1)):
            raise ReviewError(f"plan {plan.id} does not start and end at rest; plan again")
        if plan.created_ns < self._void_before:
            raise ReviewError(f"plan {plan.id} was asked for before the last stop or reset and is void; plan again")
        if plan.id not in self._decided:
            self.plan = plan

    def void(self, now: int) -> None:
        """Clear the desk, and refuse every plan that was asked for until `now` [ns] but is not here yet."""
        self.clear()
        self._void_before = now

    def clear(self) -> None:
        """Take the plan off the desk: it can no longer be approved."""
        if self.plan is not None:
            self._decided.add(self.plan.id)
        self.plan = None

    def decide(self, plan_id: str, plan_hash: str, reviewer: str) -> Plan:
        """Take the named plan off the desk to carry out a verdict on it.

        Parameters
        ----------
        plan_id : str
        plan_hash : str
            Hash of the plan that was looked at; "" when the reviewer did not compare.
        reviewer : str
            Must not be empty.

        Returns
        -------
        plan : Plan

        Raises
        ------
        ReviewError
        """
        self.check(plan_id, plan_hash, reviewer)
        plan = self.plan
        self.clear()
        return plan

    def check(self, plan_id: str, plan_hash: str, reviewer: str) -> None:
        """Raise ReviewError when a verdict on this plan by this reviewer cannot be taken."""
        if not reviewer.strip():
            raise ReviewError("a verdict needs the reviewer's name")
        if plan_id in self._decided:
            raise ReviewError(f"plan {plan_id} was decided already; an approval covers one execution, plan again")
        if self.plan is None or self.plan.id != plan_id:
            waiting = f"plan {self.plan.id} is" if self.plan else "no plan is"
            raise ReviewError(f"plan {plan_id} is not under review; {waiting}")
        if plan_hash and plan_hash != self.plan.hash:
            raise ReviewError(f"plan {plan_id} has hash {self.plan.hash}, not {plan_hash}; look at it again")

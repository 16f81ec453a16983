"""The plan that an arm follows and the plan that waits for review, from the reports of its planner and executor; no ROS."""

from __future__ import annotations

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.sentences import Sentence
from construction_twin.execution.states import ACTIVE, ExecutorState
from construction_twin.robot.plan import Plan

#: Plans kept: the one followed, the one under review, and a few that were replaced while another one ran.
_KEPT = 8


class PlanBook:
    """The plans of one arm and their states.

    Attributes:
        started: Stamp of the first setpoint of the plan that is followed [ns]; 0: it has not begun.
    """

    def __init__(self):
        self.started = 0
        self._plans: dict[str, Plan] = {}
        self._waiting = ""
        self._state: ExecutorState | None = None
        self._followed = ""

    def on_plan(self, plan: Plan) -> None:
        """Take a new plan; it replaces the one that waits."""
        self._plans[plan.id] = plan
        self._waiting = plan.id
        for name in [*self._plans][:-_KEPT]:
            if name != self._followed:
                del self._plans[name]

    def on_execution(self, state: int, plan_id: str, started: int) -> None:
        """Take the executor's state, as in `Execution.msg`; raises ValueError for an unknown state."""
        self._state = ExecutorState(state)
        self._followed, self.started = plan_id, started
        if plan_id and plan_id == self._waiting:
            self._waiting = ""

    def on_verdict(self, plan_id: str, approved: bool) -> None:
        """Take a verdict: a plan that was rejected or withdrawn waits no longer."""
        if plan_id == self._waiting and not approved:
            self._waiting = ""

    def waiting(self) -> Plan | None:
        """Return the plan that waits for review."""
        return self._plans.get(self._waiting)

    def followed(self) -> Plan | None:
        """Return the approved plan that has not ended; None for an arm that follows no plan.

        Raises:
            PlanUnknownError: If the arm's plan is not known.
        """
        if self._state is None:
            raise PlanUnknownError(Sentence("reason.neighbour.executor_silent"))
        if self._state not in ACTIVE:
            return None
        if self._followed not in self._plans:
            raise PlanUnknownError(Sentence("reason.neighbour.earlier_plan", plan=self._followed))
        return self._plans[self._followed]


class PlanUnknownError(ConstructionTwinError):
    """The path that an arm follows is not known."""

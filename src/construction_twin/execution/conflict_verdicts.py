"""What the executor knows of the watch over the other arm: its newest verdict. Stamps in ns."""

from __future__ import annotations

from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS

#: A verdict counts this long [ns]; the watch repeats it ten times a second.
VERDICT_TIMEOUT = NANOSECONDS // 2


class ConflictVerdicts:
    """The newest verdict on a plan by the watch over the robot `name`; "": there is none, and nothing is ever against a plan.

    `now` is the present moment, set by its owner in every cycle, on the clock of `on_verdict` [ns].
    """

    def __init__(self, name: str = ""):
        self.name = name
        self.now = 0
        self._plan_id, self._problem, self._at = "", "", 0

    def on_verdict(self, plan_id: str, problem: str, now: int) -> None:
        """Take a verdict: why a plan must not be played; empty: its path is free."""
        self._plan_id, self._problem, self._at = plan_id, problem, now

    def problem(self, plan_id: str) -> str:
        """Return why a plan must not start, as one sentence; empty: nothing is against it."""
        if not self.name:
            return ""
        if self._plan_id != plan_id:
            return Sentence("its path was not checked against {name} yet; does `neighbour` run?", name=self.name)
        if self.now - self._at > VERDICT_TIMEOUT:
            return Sentence("its path is not checked against {name} any more; does `neighbour` run?", name=self.name)
        return self._problem

"""What the executor knows of the watch over the other arm: the newest verdict on each of its plans. Stamps in ns."""

from __future__ import annotations

from dataclasses import dataclass

from construction_twin.core.errors import PayloadError
from construction_twin.core.sentences import Sentence
from construction_twin.core.units import NANOSECONDS

#: A verdict holds this long after the poses that it was computed from were read [ns]; the watch repeats it at its `rate`.
#: Five periods: with fewer, a busy machine that leaves a few out would stop an arm without a conflict. It is part of the
#: braking horizon.
VERDICT_TIMEOUT = NANOSECONDS // 2
#: How far a verdict's stamp may lie ahead of our clock [ns]: both nodes run on one machine, whose clock may be corrected
#: in between.
AHEAD = NANOSECONDS // 100
#: Plans that verdicts are kept of: one under review, one being played, and those just before.
_KEPT = 4


@dataclass(frozen=True)
class _Known:
    """A verdict: of when its poses are [ns], and what is against the plan; empty: nothing."""

    at: int
    problem: str


class ConflictVerdicts:
    """Keeps verdicts, and forgets those that are too old.

    Args:
        name: Of the other robot; empty: there is none, and nothing is ever against a plan.

    Attributes:
        now: The present moment, set by its owner in every cycle, on the clock of `on_verdict` [ns].
    """

    def __init__(self, name: str = ""):
        self.name = name
        self.now = 0
        self._verdicts: dict[str, _Known] = {}

    def on_verdict(self, plan_id: str, problem: str, now: int, age: int = 0) -> None:
        """Take a verdict on one of our plans.

        Args:
            problem: Why it must not start, or not go on; empty: its path is free.
            now: [ns]
            age: Of the poses that it was computed from [ns].

        Raises:
            PayloadError: If it is older than `VERDICT_TIMEOUT`, or from the future; what was known before then grows old.
        """
        if not -AHEAD <= age <= VERDICT_TIMEOUT:
            raise PayloadError(
                "conflict_age",
                Sentence(
                    "executor.refused.conflict_age",
                    plan=plan_id,
                    age=age / NANOSECONDS,
                    least=-AHEAD / NANOSECONDS,
                    most=VERDICT_TIMEOUT / NANOSECONDS,
                ),
            )
        self._verdicts.pop(plan_id, None)
        self._verdicts[plan_id] = _Known(now - max(0, age), problem)
        while len(self._verdicts) > _KEPT:
            del self._verdicts[next(iter(self._verdicts))]

    def problem(self, plan_id: str) -> str:
        """Return why a plan must not start, or not go on, as one sentence; empty: nothing is against it."""
        if not self.name:
            return ""
        known = self._verdicts.get(plan_id)
        if known is None:
            return Sentence("executor.neighbour.unchecked", name=self.name)
        age = self.now - known.at
        if age > VERDICT_TIMEOUT:
            return Sentence("executor.neighbour.old", name=self.name, age=age / NANOSECONDS)
        return known.problem

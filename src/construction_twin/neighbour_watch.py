"""What the executor knows of the watch over the other arm: the newest verdict on each of its plans. Stamps in ns."""

from __future__ import annotations

from construction_twin.units import NANOSECONDS

#: A verdict holds this long [ns]; the watch repeats it at its `rate`.
VERDICT_TIMEOUT = NANOSECONDS // 2
#: Plans that verdicts are kept of: one under review, one being played, and those just before.
_KEPT = 4


class NeighbourWatch:
    """Keeps verdicts, and forgets those that are too old.

    Parameters
    ----------
    name : str, optional
        Of the other robot; empty: there is none, and nothing is ever against a plan.

    Attributes
    ----------
    name : str
    now : int
        The present moment, set by its owner in every cycle [ns].
    """

    def __init__(self, name: str = ""):
        self.name = name
        self.now = 0
        self._verdicts: dict[str, tuple[int, str]] = {}

    def on_verdict(self, plan_id: str, problem: str, now: int) -> None:
        """Take a verdict on one of our plans.

        Parameters
        ----------
        plan_id : str
        problem : str
            Why it must not start, or not go on; empty: its way is free.
        now : int
            [ns]
        """
        self._verdicts.pop(plan_id, None)
        self._verdicts[plan_id] = now, problem
        while len(self._verdicts) > _KEPT:
            del self._verdicts[next(iter(self._verdicts))]

    def problem(self, plan_id: str) -> str:
        """Return why a plan must not start, or not go on, as one sentence; empty: nothing is against it."""
        if not self.name:
            return ""
        at, problem = self._verdicts.get(plan_id, (None, ""))
        hint = "is the node `neighbour` running?"
        if at is None:
            return f"its way was not checked against {self.name} yet; {hint}"
        age = self.now - at
        if age > VERDICT_TIMEOUT:
            return f"its way was last checked against {self.name} {age / NANOSECONDS:.1f} s ago; {hint}"
        return problem

"""How fast a plan is played: the newest fraction of its planned speed, and what it makes of the sentence why it plays. Pure."""

from __future__ import annotations

from construction_twin.core.errors import ExecutionError
from construction_twin.core.sentences import Sentence


class PlayRate:
    """The newest limit on a plan's speed.

    Attributes:
        fraction: 0 to 1; 0: it stands still until the limit is raised.
        reason: Why it is what it is, for the operator.
        standing: Whether the plan has come to rest because of it.
    """

    def __init__(self):
        self.fraction = 1.0
        self.standing = False
        self.reason = ""

    def take(self, fraction: float, reason: str) -> bool:
        """Take a limit and why it is there; return whether there is something new to say.

        Raises:
            ExecutionError: When it is no fraction; nothing has changed then.
        """
        if fraction == self.fraction and reason == self.reason:
            return False
        # written so that a nan does not pass
        if not 0.0 <= fraction <= 1.0:
            raise ExecutionError(Sentence("executor.refused.rate", fraction=fraction))
        self.fraction, self.reason = fraction, reason
        return True

    def sentence(self, cause: str) -> str:
        """Return what a playing plan does, and why: always of the present limit. `cause` is why it plays."""
        if self.standing:
            return Sentence("executor.speed.standing", reason=self.reason)
        if self.fraction < 1.0:
            return Sentence("executor.speed.slower", cause=cause, percent=100.0 * self.fraction, reason=self.reason)
        return cause

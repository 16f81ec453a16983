"""How fast a plan is played: the newest fraction of its planned speed, whether the arm keeps up, and what both make of the sentence
why it plays. Pure.
"""

from __future__ import annotations

import math

from construction_twin.core.errors import ExecutionError
from construction_twin.core.sentences import Sentence

#: An arm that trails by so much is waited for, and is no longer when it trails by less than `KEEPS_UP` [s]. The gateway ends a
#: motion of which it had to put off 2 s.
TRAILS, KEEPS_UP = 1.0, 0.5


class PlayRate:
    """The newest limit on a plan's speed, and whether the arm is waited for.

    Attributes:
        waits: For an arm that trails, because replies to it are lost, or because the gateway slows it.
        fraction: 0 to 1; 0: it stands still until the limit is raised.
        standing: Whether the plan has come to rest because of either.
    """

    def __init__(self):
        self.fraction = 1.0
        self.standing = self.waits = False
        self.reason = ""

    @property
    def rate(self) -> float:
        """What the plan is played at, as a fraction of its planned speed."""
        return 0.0 if self.waits else self.fraction

    def trail(self, lag: float) -> bool:
        """Take how long the arm trails its setpoints [s]; return whether there is something new to say.

        What is not known, or is no such time, changes nothing: an arm that was waited for has not caught up by it.
        """
        if not 0.0 <= lag < math.inf:
            return False
        waits = lag >= (KEEPS_UP if self.waits else TRAILS)
        changed = waits is not self.waits
        self.waits = waits
        return changed

    def forget(self) -> None:
        """Wait for nothing: a new session, of whose arm nothing is known yet."""
        self.waits = False

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
        if self.standing and self.fraction == 0.0:
            return Sentence("executor.speed.standing", reason=self.reason)
        if self.waits:
            return Sentence("executor.speed.waits", trails=TRAILS)
        if self.fraction < 1.0:
            return Sentence("executor.speed.slower", cause=cause, percent=100.0 * self.fraction, reason=self.reason)
        return cause

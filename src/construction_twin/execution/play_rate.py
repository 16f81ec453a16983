"""At which share of its planned speed a plan may be played now, and the words for it. Pure."""

from __future__ import annotations

from construction_twin.core.errors import ExecutionError


class PlayRate:
    """The newest limit on a plan's speed.

    Attributes
    ----------
    share : float
        0 to 1; 0: it stands still until the limit is raised.
    standing : bool
        Whether the plan has come to rest because of it.
    """

    def __init__(self):
        self.share = 1.0
        self.standing = False
        self._reason = ""

    def take(self, share: float, reason: str) -> bool:
        """Take a limit and why it is there; return whether there is something new to say.

        Raises
        ------
        ExecutionError
            When it is no share; nothing has changed then.
        """
        if share == self.share and reason == self._reason:
            return False
        # written so that a nan does not pass
        if not 0.0 <= share <= 1.0:
            raise ExecutionError(f"a rate of {share} was asked for; expected a share of the planned speed, 0 to 1")
        self.share, self._reason = share, reason
        return True

    def sentence(self, cause: str) -> str:
        """Return what a playing plan does, and why: always of the present limit. `cause` is why it plays."""
        if self.standing:
            return f"stands still on the path, goes on by itself: {self._reason}"
        if self.share < 1.0:
            return f"{cause}; at {self.share:.0%} of the planned speed: {self._reason}"
        return cause

"""Mirror mode: the arm leads, the twin follows, nothing is commanded. When it may begin and end.

Pure: time is an argument [ns].
"""

from __future__ import annotations

from construction_twin.core.errors import ReviewError
from construction_twin.core.sentences import Sentence
from construction_twin.link.observations import LinkObservations


class MirrorMode:
    """Whether the arm leads, and the session that it ended.

    Args:
        active: Whether the arm leads from the start.

    Attributes:
        ended_session: The session that commanded before; it is ended at the gateway too.
    """

    def __init__(self, inputs: LinkObservations, active: bool):
        self._inputs = inputs
        self.active = active
        self.ended_session = ""

    def begin(self, session: str, now: int) -> None:
        """Let the arm lead from now on; `session` is the one that commanded so far.

        Raises:
            ReviewError: When there is no arm to follow, or arm or command stream move or have not been seen to rest.
        """
        # a gateway that only reads is enough
        obstacle = self._inputs.obstacle(now, mirrors=True)
        if obstacle is not None:
            raise ReviewError(Sentence("link.cannot.mirror", why=obstacle[1]))
        unrest = self._inputs.why_not_at_rest(now)
        if unrest:
            raise ReviewError(Sentence("link.cannot.mirror", why=unrest))
        if self._inputs.stream_may_move(now):
            raise ReviewError(Sentence("link.cannot.mirror", why=Sentence("link.mirror.stream_moves")))
        self.active, self.ended_session = True, session

    def end(self, now: int) -> None:
        """Let the arm lead no longer.

        Raises:
            ReviewError: When the arm's pose is not known, or it moves.
        """
        obstacle = self._inputs.obstacle(now, mirrors=True)
        if obstacle is not None:
            raise ReviewError(Sentence("link.cannot.leave_mirror", why=obstacle[1]))
        unrest = self._inputs.why_not_at_rest(now)
        if unrest:
            raise ReviewError(Sentence("link.cannot.leave_mirror", why=unrest))
        self.active = False

    @property
    def sentence(self) -> str:
        """What a person reads of mirror mode, and what the gateway does meanwhile."""
        leads = Sentence("link.mirror.leads")
        if self._inputs.reads_only:
            return Sentence("link.mirror.leads_read_only", leads=leads)
        if self._inputs.fault:
            return Sentence("link.mirror.leads_stopped", leads=leads, state=self._inputs.gateway)
        return leads

    @property
    def old_session_commands(self) -> bool:
        """True while the gateway is still armed for the session before mirror mode."""
        return self._inputs.follows(self.ended_session)

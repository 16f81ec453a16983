"""When a speed limit goes on to the gateway: changes at once, repeats rarely, silence as silence. Pure, standard library only."""

from __future__ import annotations

from construction_twin.units import NANOSECONDS

#: An unchanged limit is repeated no faster than this [ns].
PERIOD = NANOSECONDS // 5


class SpeedForwarder:
    """Forwards what the source of `speed_limit` says, and nothing that it does not say.

    A message is forwarded at most once, except to a session that began after it: the deadline of who listens then runs from
    where the source's own silence began.

    Parameters
    ----------
    deadline : float
        A message older than this is not given to a new session [s]: its source has fallen silent.
    """

    def __init__(self, deadline: float):
        self._deadline = round(deadline * NANOSECONDS)
        #: The last limit heard; None before the first one.
        self.limit: float | None = None
        self._heard_at = 0
        self._unsent = False
        self._sent: tuple[float, str] | None = None
        self._sent_at = 0

    def on_limit(self, limit: float, now: int) -> bool:
        """Take a message [share, 0 to 1] that came at `now` [ns]; return whether it is one: anything else is to be refused."""
        if not 0.0 <= limit <= 1.0:
            return False
        self.limit, self._heard_at, self._unsent = limit, now, True
        return True

    def poll(self, session: str, now: int) -> float | None:
        """Return the limit to send now to the armed session `session` ("" for none), or None."""
        if not session or self.limit is None:
            return None
        is_new = self._sent is None or self._sent[1] != session
        if is_new and now - self._heard_at <= self._deadline:
            self._unsent = True
        due = is_new or self.limit != self._sent[0] or now - self._sent_at >= PERIOD
        if not (self._unsent and due):
            return None
        self._unsent, self._sent, self._sent_at = False, (self.limit, session), now
        return self.limit

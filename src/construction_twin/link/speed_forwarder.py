"""When a speed limit goes to the gateway: a change at once, an unchanged limit every 0.2 s, nothing after the source's deadline.

Pure, standard library only.
"""

from __future__ import annotations

from construction_twin.core.speed_limit import SpeedLimit
from construction_twin.core.units import NANOSECONDS

#: An unchanged limit is repeated no faster than this [ns].
PERIOD = NANOSECONDS // 5


class SpeedForwarder:
    """Forwards what the source of `speed_limit` says, and nothing that it does not say.

    A message is forwarded at most once, except to a session that began after it: the receiver's deadline then runs from
    where the source's own silence began.

    Args:
        deadline: A source that was heard this recently is the only one [s]. A message older than this is not sent any more: its
            source has fallen silent.
    """

    def __init__(self, deadline: float):
        self._source = SpeedLimit(deadline)
        #: The last limit heard; None before the first one.
        self.limit: float | None = None
        #: How many were sent: the last message's id, because the gateway takes none that is not newer than all before.
        self.number = 0
        self._unsent = False
        # what was sent last, and to which session
        self._sent_limit = 1.0
        self._sent_session = ""
        self._sent_at = 0

    def on_limit(self, limit: float, source: str, now: int) -> None:
        """Take a message [fraction, 0 to 1] that `source` sent and that came at `now` [ns].

        Raises:
            PayloadError: ``speed_limit``, or ``speed_limit_source`` while another source is heard: the executor refuses it too.
        """
        self._source.accept(limit, source, now)
        self.limit, self._unsent = limit, True

    def poll(self, session: str, now: int) -> float | None:
        """Return the limit to send now to the armed session `session` ("" for none), or None."""
        if not session or self.limit is None:
            return None
        if self._source.is_silent(now):
            # nothing is sent for a silent source, also to a session that begins meanwhile
            self._unsent = False
            return None
        is_new = self._sent_session != session
        self._unsent |= is_new
        due = is_new or self.limit != self._sent_limit or now - self._sent_at >= PERIOD
        if not (self._unsent and due):
            return None
        self._unsent, self._sent_limit, self._sent_session, self._sent_at = False, self.limit, session, now
        self.number += 1
        return self.limit

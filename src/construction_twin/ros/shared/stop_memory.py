"""Keeps on the parameter server what a node that is started again must know: the session in which the gate is STOPPED, or why the
link waits for a person.
"""

from __future__ import annotations

import http.client
import threading
import xmlrpc.client
from collections.abc import Callable

import rospy

from construction_twin.core.units import NANOSECONDS

#: In the robot's namespace, not the node's own: there every name must be a setting. The launch file clears it.
PARAMETER = "stopped_session"
#: A write that failed is tried again after this time [ns].
_AGAIN = NANOSECONDS


class StopMemory:
    """A text on the parameter server, empty when nothing is stopped: the session of a gate, or the sentence of a link.

    Args:
        session: What is on the parameter server now.
        write: Puts a text there. It may take as long as the master does, so it is called in a thread of its own.
        name: Of the parameter.

    Attributes:
        problem: Why it could not be kept; empty when it could.
    """

    def __init__(self, session: str, write: Callable[[str], object], name: str = PARAMETER):
        self.problem = ""
        self._name = name
        self._write = write
        self._written = session
        self._writer: threading.Thread | None = None
        self._tried: int | None = None

    @property
    def writing(self) -> bool:
        """Whether a session is being written now."""
        return self._writer is not None and self._writer.is_alive()

    def keep(self, session: str, now: int) -> None:
        """Keep a text, empty for none; returns at once. To be called again and again, from one thread, `now` in ns."""
        if session == self._written or self.writing:
            return
        if self._tried is not None and self.problem and now - self._tried < _AGAIN:
            return
        self._tried = now
        self._writer = threading.Thread(target=self._put, args=(session,), daemon=True)
        self._writer.start()

    def _put(self, session: str) -> None:
        try:
            # XML-RPC takes a plain text only: a sentence has its key in the console and in logs, not here
            self._write(str(session))
        except (OSError, rospy.ROSException, xmlrpc.client.Error, http.client.HTTPException) as error:
            self.problem = f"{self._name} was not written, and what it says would not outlast this node ({error})"
            return
        self._written, self.problem = session, ""

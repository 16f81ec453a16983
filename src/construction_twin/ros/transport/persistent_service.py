"""A service over a connection that stays open from the first call on: a later call asks no master and shakes no hands."""

from __future__ import annotations

import threading

import rospy
from rospy.exceptions import TransportException

#: The errors of a call whose node is not there, or goes away.
NO_ANSWER = (rospy.ServiceException, TransportException, OSError)


class PersistentService(rospy.ServiceProxy):
    """As a persistent `rospy.ServiceProxy`, for a service without arguments, and from several threads.

    A call whose connection broke is repeated once over a new one. So only a service may be called that may be called twice: of a
    broken connection it is unknown whether the request had arrived.
    """

    def __init__(self, service: str, kind: type):
        super().__init__(service, kind, persistent=True)
        self._busy = threading.Lock()

    def __call__(self):
        """Call the service; return the answer, or raise ServiceException."""
        if not self._busy.acquire(blocking=False):
            # another thread waits for its answer on the connection
            return rospy.ServiceProxy(self.resolved_name, self.service_class)()
        try:
            return self._call_twice()
        finally:
            self._busy.release()

    def _call_twice(self):
        try:
            return self.call()
        except NO_ANSWER:
            self._forget()
        try:
            return self.call()
        except NO_ANSWER as error:
            self._forget()
            raise rospy.ServiceException(f"no answer twice: {error}") from error

    def _forget(self) -> None:
        self.close()
        self.transport = None

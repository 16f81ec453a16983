"""Services of other nodes: a call whose silence is an error, and one over a connection that stays open."""

from __future__ import annotations

import contextlib
import threading

import rospy
from rospy.exceptions import TransportException
from rospy.impl.tcpros_base import TCPROSTransport

from construction_twin.core.errors import ConstructionTwinError
from construction_twin.core.sentences import Sentence

#: The errors of a call whose node is not there, or goes away.
NO_ANSWER = (rospy.ServiceException, TransportException, OSError)
#: Longest wait for a service to exist [s].
TIMEOUT = 1.0


class ServiceSilentError(ConstructionTwinError):
    """A node does not answer on one of its services."""

    def __init__(self, service: str, problem: object, program: str):
        problem = problem if isinstance(problem, Sentence) else str(problem)
        named = {"service": service, "problem": problem, "program": program}
        super().__init__(Sentence("{service} does not answer: {problem}; does {program} run?", **named))


def call(service: rospy.ServiceProxy, program: str, **request):
    """Return the answer of a service; ServiceSilentError where it does not exist within `TIMEOUT`, or its node goes away."""
    try:
        rospy.wait_for_service(service.resolved_name, TIMEOUT)
        return service(**request)
    except (rospy.ROSException, *NO_ANSWER) as error:
        raise ServiceSilentError(service.resolved_name, error, program) from error


def call_twice(service: rospy.ServiceProxy, program: str, **request):
    """As `call`, of a service that may be called twice, and over the connection that is open: first without asking the master."""
    with contextlib.suppress(rospy.ROSException, *NO_ANSWER):
        return service(**request)
    # its node may just be starting
    return call(service, program, **request)


class PersistentService(rospy.ServiceProxy):
    """As a persistent `rospy.ServiceProxy`, for several threads, and services that may be called twice, as a broken call is."""

    transport: TCPROSTransport | None

    def __init__(self, service: str, kind: type):
        super().__init__(service, kind, persistent=True)
        self._busy = threading.Lock()

    def __call__(self, **request):
        """Call the service; return the answer, or raise ServiceException."""
        if not self._busy.acquire(blocking=False):
            # another thread waits for its answer on the connection
            return rospy.ServiceProxy(self.resolved_name, self.service_class)(**request)
        try:
            return self._call_twice(request)
        finally:
            self._busy.release()

    def open(self) -> None:
        """Connect if the service is found, for a thread that may wait: the first call does not ask the master then."""
        if self.transport is not None:
            return
        with contextlib.suppress(*NO_ANSWER):
            # beside the calls, which must not wait for it
            uri = self._get_service_uri(self.request_class())
            transport = TCPROSTransport(self.protocol, self.resolved_name)
            transport.buff_size = self.buff_size
            transport.connect(*rospy.core.parse_rosrpc_uri(uri), uri)
            with self._busy:
                if self.transport is None:
                    self.transport = transport
                else:
                    transport.close()

    def _call_twice(self, request: dict[str, object]):
        try:
            return self.call(**request)
        except NO_ANSWER:
            self._forget()
        try:
            return self.call(**request)
        except NO_ANSWER as error:
            self._forget()
            raise rospy.ServiceException(f"no answer twice: {error}") from error

    def _forget(self) -> None:
        self.close()
        self.transport = None

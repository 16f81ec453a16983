"""A service whose connection is made before it is needed: a call of `stop` waits for no master and no handshake."""

from __future__ import annotations

import socket
import threading
import time

import rosgraph
import rospy
from rospy.exceptions import TransportException
from rospy.impl.tcpros_base import TCPROSTransport

#: How often it is checked that the connection is still there [s].
PERIOD = 1.0


class _Proxy(rospy.ServiceProxy):
    """A persistent proxy that can be connected without a call."""

    def __init__(self, service: str, kind: type):
        super().__init__(service, kind, persistent=True)

    def connect(self) -> bool:
        """Connect, unless it is; return whether it is then."""
        if self._alive():
            return True
        self.disconnect()
        try:
            uri = rosgraph.Master(rospy.get_name()).lookupService(self.resolved_name)
            transport = TCPROSTransport(self.protocol, self.resolved_name)
            transport.buff_size = self.buff_size
            transport.connect(*rospy.core.parse_rosrpc_uri(uri), uri)
        except (rosgraph.MasterException, OSError, TransportException, rospy.ROSException):
            # no server: a caller is told so, and it is tried again
            return False
        self.transport = transport
        return True

    def disconnect(self) -> None:
        """Forget the connection; the next call makes another one."""
        self.close()
        self.transport = None

    def _alive(self) -> bool:
        if self.transport is None or self.transport.socket is None:
            return False
        try:
            return bool(self.transport.socket.recv(1, socket.MSG_PEEK | socket.MSG_DONTWAIT))
        except BlockingIOError:
            return True
        except OSError:
            return False


class KeptService:
    """Calls a service over a connection that is kept; for use from several threads.

    A connection that broke is made again, at once by a call and otherwise within `PERIOD`. So only a service may be called that may
    be called twice: when a connection breaks it is not known whether the request had arrived.

    Parameters
    ----------
    service : str
    kind : type
        Of the service.
    """

    def __init__(self, service: str, kind: type):
        self._service, self._kind = service, kind
        self._proxy = _Proxy(service, kind)
        self._busy = threading.Lock()

    def keep(self) -> KeptService:
        """Connect, and see to it from now on that it stays so, in the background."""
        threading.Thread(target=self._keep, name=f"keeps {self._service}", daemon=True).start()
        return self

    def connect(self) -> bool:
        """Connect, if it is not; return whether it is then, or is in use."""
        if not self._busy.acquire(blocking=False):
            return True
        try:
            return self._proxy.connect()
        finally:
            self._busy.release()

    def __call__(self):
        """Call without arguments; return the answer, or raise ServiceException."""
        if not self._busy.acquire(blocking=False):
            # another thread waits for an answer on it
            return rospy.ServiceProxy(self._service, self._kind)()
        try:
            return self._call()
        finally:
            self._busy.release()

    def _call(self):
        try:
            return self._proxy()
        except (rospy.ServiceException, TransportException, OSError):
            self._proxy.disconnect()
        try:
            return self._proxy()
        except (TransportException, OSError) as error:
            self._proxy.disconnect()
            raise rospy.ServiceException(f"the connection broke twice: {error}") from error

    def _keep(self) -> None:
        while not rospy.is_shutdown():
            self.connect()
            time.sleep(PERIOD)
